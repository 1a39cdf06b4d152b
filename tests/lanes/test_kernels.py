"""A lane program as one GPU kernel: the same numbers by XLA, taken by Triton's front end, refused where it must be."""

import importlib
import re
import subprocess
import sys
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.batching import Engine, computing, drawn
from dssc_jax.lanes import forms, kernels
from dssc_jax.lanes.kernels import in_registers
from dssc_jax.lanes.unsupported import Unfit
from dssc_jax.study.library import find
from tests.conftest import UNCERTAIN
from tests.tolerances import ROUNDING, SINGLE

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"
LANES = 40  # not a whole number of warps
QUIET = {"draws": LANES, "disturbance": {"kind": "none"}, "requirement": [], "sweep": {}, "loop.duration": 0.5}
FLIGHT = {
    "draws": LANES,
    "loop.duration": 0.25,
    "requirement": [],
    "metrics.names": ["position_error_rms", "command_tv", "tilt_max"],
    "plant.position": [{"uniform": [39.0, 41.0]}, 10.0, 10.0],
    "wind.x": {"uniform": [6.0, 10.0]},
    "wind.at": 0.1,
}


def axis(**changes):
    """One degree of freedom, 50 samples."""
    return dj.Study.from_table(UNCERTAIN).override({**QUIET, **changes})


def flight(**changes):
    """The full UAV, 50 samples."""
    return dj.Study.load(find("paper_case1")).override({**FLIGHT, **changes})


def batch(study, **engine):
    draws = study.config.draws
    return Engine(study, draws, **engine)(drawn(study, slice(0, draws)), np.arange(draws))()


@pytest.fixture
def gpu(monkeypatch):
    """The benchmark."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    return importlib.import_module("gpu")


def traced(function, *arguments):
    """A function of numbers, as a kernel has it."""
    program = jax.make_jaxpr(function)(*arguments)
    return lambda *x: kernels.translated(program, x)[0]


@pytest.mark.parametrize("study", [axis, flight])
def test_a_kernel_finds_what_the_scan_finds(study):
    """In tiles that are no whole number of warps."""
    study = study(**{"loop.integrator": "euler"})  # half the time to compile; the fourth order's is lowered below
    scan, kernel = batch(study, kernel="scan"), batch(study, kernel="pallas", tile=16)
    assert scan.keys() == kernel.keys()
    assert np.std(scan[study.measures[0].name]) > 0.0
    for name, values in scan.items():
        assert kernel[name].dtype == values.dtype
        np.testing.assert_allclose(kernel[name], values, rtol=ROUNDING, err_msg=name)


def test_a_diverged_draw_ends_alike():
    """Gains far beyond what the explicit scheme bears, for some of the draws."""
    study = axis(**{"controller.discretisation": "explicit", "controller.rho": {"loguniform": [1.0, 1e300]}})
    scan, kernel = batch(study, kernel="scan"), batch(study, kernel="pallas")
    assert 0 < np.sum(scan["outcome"] == Outcome.NON_FINITE) < LANES
    np.testing.assert_array_equal(kernel["outcome"], scan["outcome"])
    np.testing.assert_array_equal(kernel["failed_at"], scan["failed_at"])


LOWERS = pytest.mark.skipif(
    jax.__version_info__ >= (0, 11), reason="since 0.11, JAX lowers a kernel for Triton only on a machine with a GPU"
)


@LOWERS
@pytest.mark.parametrize("precision", [64, 32])
@pytest.mark.parametrize("study", [axis, flight])
def test_triton_takes_the_program(study, precision, gpu):
    """As far as this goes without a GPU: JAX lowers every primitive to Triton's language, in the study's precision."""
    text = gpu.lowered(study(**{"loop.precision": precision})).as_text()
    assert text.count("stablehlo.custom_call @__gpu$xla.gpu.triton") == 1
    assert ("__nv_sqrtf" in text) == ("__nv_sinf" in text) == (precision == 32)
    assert "__nv_sin" in text


def test_a_number_without_a_type_is_not_rounded_to_single():
    function = traced(lambda x: x + jnp.sin(jnp.asarray(1, jnp.int32) * 0.5), 1.0)
    assert "f64[]{weak_type=True}" not in str(jax.make_jaxpr(function)(np.float64(1.0)))
    assert function(np.float64(1.0)) == 1.0 + np.sin(0.5)


@pytest.mark.parametrize(
    "function",
    [
        lambda x, y: jax.lax.fori_loop(0, 3, lambda i, at: at * y + i, x),
        lambda x, y: jax.lax.while_loop(lambda at: at < y, lambda at: at * 1.5 + x, x),
    ],
)
def test_loops_tell_constants_from_what_they_carry(function):
    """By programs and shapes alone, since the names that JAX gives the numbers differ between its versions."""
    assert traced(function, 1.0, 1.0)(1.25, 7.5) == function(1.25, 7.5)


@LOWERS
def test_a_kernel_is_not_told_of_what_becomes_of_triton(gpu):
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always")
        gpu.lowered(axis())
    assert told == []


@pytest.mark.parametrize(("function", "plain"), [(jnp.maximum, "max"), (jnp.minimum, "min")])
def test_extremes_keep_a_nan(function, plain):
    again = traced(function, 1.0, 1.0)
    assert f" {plain} " not in str(jax.make_jaxpr(again)(1.0, 1.0))
    for x, y in [(1.0, 2.0), (2.0, 1.0), (np.nan, 1.0), (1.0, np.nan), (-np.inf, np.inf)]:
        np.testing.assert_array_equal(again(x, y), function(x, y))


def test_a_noisy_study_is_refused():
    study = axis(disturbance=UNCERTAIN["disturbance"])
    with pytest.raises(ConfigError, match=r"kernel: the loop draws random numbers .*take 'scan'"):
        batch(study, kernel="pallas")


def noisy(values, i):
    return values["a"] + jax.random.normal(jax.random.key(i))


def on_an_old_gpu(batch):
    raise RuntimeError("No supported GPU devices found")


@pytest.mark.parametrize(
    ("kernel", "reason"), [(in_registers, "the loop draws random numbers"), (on_an_old_gpu, "No supported GPU")]
)
def test_what_does_not_fit_falls_back_to_the_scan(kernel, reason, monkeypatch):
    """The program, or the device."""
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    monkeypatch.setattr("dssc_jax.lanes.kernels.in_registers", kernel)
    with pytest.warns(forms.KernelWarning, match=reason):
        start = forms.compiled("auto", noisy, ["a"], 8, None, None)
    values, index = {"a": np.arange(8.0)}, np.arange(8)
    np.testing.assert_allclose(start(values, index)()[0], jax.vmap(noisy)(values, index), rtol=ROUNDING)


@pytest.mark.parametrize(
    ("program", "rule"),
    [
        (lambda values, i: jnp.linspace(0.0, 1.0, 4)[values["a"].astype(int)], "does not act on each lane|arrays"),
        (lambda values, i: jnp.sum(jnp.ones(3) * values["a"]), "computes with arrays"),
        (lambda values, i: jnp.asarray(np.arange(3.0)) @ jnp.ones(3) + values["a"], "array"),
        (lambda values, i: jax.lax.scan(lambda x, _: (x, x), values["a"], length=3)[1][0], "keeps its samples"),
        (lambda values, i: jax.random.normal(jax.random.key(i)), "random"),
    ],
)
def test_what_a_kernel_cannot_do_is_told(program, rule):
    with pytest.raises(Unfit, match=rule):
        jax.jit(in_registers(jax.vmap(program)))({"a": jnp.ones(8)}, jnp.arange(8, dtype=jnp.uint32))


def test_a_program_without_numbers_of_its_own_uses_the_index():
    batch = in_registers(jax.vmap(lambda values, i: {"twice": 2.0 * i, "one": 1}))
    found = jax.jit(batch)({}, jnp.arange(70, dtype=jnp.uint32))
    np.testing.assert_array_equal(found["twice"], 2.0 * np.arange(70))
    np.testing.assert_array_equal(found["one"], np.ones(70, int))


def test_the_form_is_chosen_by_argument_or_environment(monkeypatch):
    monkeypatch.delenv(forms.KERNEL_VARIABLE, raising=False)
    assert forms.requested() == "lanes"
    assert not any(forms.KERNEL_VARIABLE in flag for flag in computing()["compiler"])
    monkeypatch.setenv(forms.KERNEL_VARIABLE, "pallas")
    assert Engine(axis(), 8).kernel == "pallas"
    assert Engine(axis(), 8, kernel="scan").kernel == "scan"
    assert f"{forms.KERNEL_VARIABLE}=pallas" in computing()["compiler"]
    with pytest.raises(
        ConfigError, match=r"kernel: must be lanes, strict, scan, pallas or auto, got 'palas'; did you mean 'pallas'\?"
    ):
        Engine(axis(), 8, kernel="palas")


def test_a_gpu_advances_sample_by_sample_unless_asked(monkeypatch):
    monkeypatch.delenv(forms.KERNEL_VARIABLE, raising=False)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert forms.requested() == "scan"


def test_the_benchmark_says_that_there_is_no_gpu():
    page = BENCHMARKS.parent / "docs" / "gpu.md"
    before = page.read_text()
    done = subprocess.run([sys.executable, BENCHMARKS / "gpu.py"], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == "benchmarks/gpu.py: needs a GPU, and JAX finds none, only 'cpu'\n"
    assert page.read_text() == before


def test_the_benchmark_is_ready_to_run(gpu, monkeypatch):
    """All of it but the machine code, on what there is: the shipped study with one degree of freedom, in float32."""
    monkeypatch.setattr(gpu, "PRECISIONS", (32,))
    table = gpu.table({"axis": gpu.axis().override({"loop.duration": 0.25})}, (64,), 32, copied=2**16, repeats=1)
    row = next(line for line in table.splitlines() if line.startswith("| axis | float32 | 64 |"))
    assert min(float(cell) for cell in row.split("|")[4:8]) > 0.0
    largest = re.search(r"axis, float32: largest difference (\S+); 0 end otherwise", table)
    assert float(largest[1]) < SINGLE


def test_the_benchmarks_state_is_what_a_lane_carries(gpu):
    """Position and speed of the plant, one law, and accumulators, against the loop that is compiled."""
    study = gpu.axis()
    program = jax.make_jaxpr(gpu.lanes_of(study))(
        {name: jnp.ones(LANES) for name in study.laws}, jnp.arange(LANES, dtype=jnp.uint32)
    )
    loop = next(equation for equation in program.eqns if equation.primitive.name == "while")
    carried = [x.aval for x in loop.outvars if x.aval.shape and x.aval.dtype == jnp.float64]
    assert gpu.state_numbers(study) == len(carried)
