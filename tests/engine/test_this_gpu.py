"""Studies on this machine's GPU, if it has one: the bits of strict arithmetic on the processor."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.engine import kernels
from tests.engine.test_gpu import SENSOR, loop
from tests.engine.test_kernels import batch
from tests.lanes.gpu_here import needs_gpu

pytestmark = needs_gpu


@pytest.mark.parametrize(
    "study",
    [
        lambda: loop("axis", **{"loop.precision": 32}),
        lambda: loop("axis"),
        lambda: loop("uav"),
        lambda: loop("uav", sensor=SENSOR),
        lambda: loop("uav", **{"loop.precision": 32, "loop.integrator": "euler"}),
    ],
    ids=["axis, float32", "axis", "vehicle", "noisy vehicle", "Euler, float32"],
)
def test_a_thread_has_the_bits_of_strict_arithmetic(study):
    study = study()
    kernel, strict = batch(study, "gpu-strict"), batch(study, "strict")
    assert set(kernel) == set(strict)
    for name, column in strict.items():
        np.testing.assert_array_equal(kernel[name], column, err_msg=name)


def test_a_run_has_the_results_of_the_processor(monkeypatch):
    """In blocks, by ``run``, with fast arithmetic."""
    study = loop("axis").override({"draws": 3000, "loop.duration": 5.0})
    processor = dj.run(study).dataset
    monkeypatch.setenv(kernels.KERNEL_VARIABLE, "gpu")
    result = dj.run(study, block=1000)
    assert any(setting.startswith("gpu ") for setting in result.manifest["compiler"])
    for name in ("error_rms", "command_tv"):
        np.testing.assert_allclose(result.dataset[name], processor[name], rtol=1e-9)
