"""Studies on a GPU, which the processor stands in for: the same bits as strict arithmetic, and clear refusals."""

import ctypes
from pathlib import Path

import numpy as np
import pytest

import dssc_jax as dj
from benchmarks.speed import workloads
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine import kernels
from dssc_jax.engine.batching import Engine, computing
from dssc_jax.lanes.gpu.driver import driver
from tests.conftest import UNCERTAIN
from tests.engine.test_kernels import batch
from tests.lanes.gpu_on_cpu import emulated
from tests.lanes.test_translation import sorts

LANES = 11
SENSOR = {"kind": "noisy", "position_std": 0.01, "velocity_std": 0.01}


def loop(name, **changes):
    """A short flight of a loop of the benchmarks."""
    event = {"uav": "wind.at", "axis": "disturbance.at"}[name]
    study = dj.Study.load(Path(workloads.__file__).parent / f"{name}.toml")
    return study.override({"draws": LANES, "loop.duration": 0.2, event: 0.1, **changes})


@pytest.mark.parametrize(
    "study",
    [lambda: loop("axis", **{"loop.precision": 32}), lambda: loop("uav", sensor=SENSOR)],
    ids=["axis, float32", "noisy vehicle"],
)
def test_a_thread_has_the_bits_of_strict_arithmetic(study, monkeypatch):
    study = study()
    with emulated(monkeypatch) as library:
        kernel = batch(study, "gpu-strict")
        assert library.calls.count("cuLaunchKernel") == 1
    strict = batch(study, "strict")
    assert set(kernel) == set(strict)
    for name, column in strict.items():
        np.testing.assert_array_equal(kernel[name], column, err_msg=name)


def test_the_manifest_names_the_gpu(monkeypatch):
    monkeypatch.setenv(kernels.KERNEL_VARIABLE, "gpu")
    with emulated(monkeypatch):
        settings = computing()["compiler"]
    assert "gpu Emulated GPU" in settings
    assert f"{kernels.KERNEL_VARIABLE}=gpu" in settings


@pytest.mark.parametrize(("form", "remedy"), [("gpu", "lanes"), ("gpu-strict", "strict")])
def test_a_machine_without_a_driver_says_so(form, remedy, monkeypatch):
    def missing(name):
        raise OSError(name)

    driver.cache_clear()
    monkeypatch.setattr(ctypes, "CDLL", missing)
    with pytest.raises(
        ConfigError, match=f"'{form}' needs an NVIDIA GPU: this machine has no driver.*'{remedy}' runs on"
    ):
        Engine(dj.Study.from_table(UNCERTAIN), 8, kernel=form)


def test_what_a_kernel_cannot_express_is_refused(monkeypatch):
    with emulated(monkeypatch), pytest.raises(ConfigError, match="a kernel cannot express 'sort' in sorts"):
        kernels.compile_batches("gpu", sorts, ["a"], LANES, None, None)


def test_a_batch_for_which_the_gpu_has_no_memory_is_refused(monkeypatch):
    study = loop("axis")
    with (
        emulated(monkeypatch, memory=500),
        pytest.raises(ConfigError, match=r"kernel: cuMemAlloc_v2 .*OUT_OF_MEMORY; run smaller blocks"),
    ):
        batch(study, "gpu")
