"""The form in which lanes run is chosen by argument or environment; each has the same numbers."""

import jax
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Outcome
from dssc_jax.engine import kernels
from dssc_jax.engine.batching import Engine, computing, values_of_draws
from tests.conftest import UNCERTAIN
from tests.lanes.test_exactness import REFUSED
from tests.lanes.test_translation import sorts

LANES = 40
QUIET = {"draws": LANES, "disturbance": {"kind": "none"}, "requirement": [], "sweep": {}, "loop.duration": 0.5}


def axis(**changes):
    """One degree of freedom, 50 samples."""
    return dj.Study.from_table(UNCERTAIN).override({**QUIET, **changes})


def batch(study, kernel):
    draws = study.config.draws
    return Engine(study, draws, kernel=kernel)(values_of_draws(study, slice(0, draws)), np.arange(draws))()


def test_a_diverged_draw_ends_alike():
    """Gains far beyond what the explicit scheme bears, for some of the draws."""
    study = axis(**{"controller.discretisation": "explicit", "controller.rho": {"loguniform": [1.0, 1e300]}})
    scan, lanes = batch(study, "scan"), batch(study, "strict")
    assert 0 < np.sum(scan["outcome"] == Outcome.NON_FINITE) < LANES
    np.testing.assert_array_equal(lanes["outcome"], scan["outcome"])
    np.testing.assert_array_equal(lanes["failed_at"], scan["failed_at"])


def test_the_form_is_chosen_by_argument_or_environment(monkeypatch):
    monkeypatch.delenv(kernels.KERNEL_VARIABLE, raising=False)
    assert kernels.requested_form() == "lanes"
    assert not any(kernels.KERNEL_VARIABLE in flag for flag in computing()["compiler"])
    monkeypatch.setenv(kernels.KERNEL_VARIABLE, "strict")
    assert Engine(axis(), 8).kernel == "strict"
    assert Engine(axis(), 8, kernel="scan").kernel == "scan"
    assert f"{kernels.KERNEL_VARIABLE}=strict" in computing()["compiler"]
    with pytest.raises(
        ConfigError, match=r"kernel: must be lanes, strict, scan, gpu or gpu-strict, got 'scam'; did you mean 'scan'\?"
    ):
        Engine(axis(), 8, kernel="scam")


def test_a_gpu_advances_sample_by_sample(monkeypatch):
    monkeypatch.delenv(kernels.KERNEL_VARIABLE, raising=False)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert kernels.requested_form() == "scan"


@pytest.mark.parametrize("name", [name for name in REFUSED if name != "algorithm"])  # XLA refuses that here, too
def test_what_is_not_exact_runs_as_plain_xla(name):
    lane, reason = REFUSED[name]
    x = np.linspace(-2.0, 2.0, 21)
    with pytest.warns(kernels.KernelWarning, match=f"no machine code for .*{reason}"):
        start = kernels.compile_batches("lanes", lane, ["a"], len(x), None, None)
    results = start({"a": x}, np.arange(len(x)))()[0]
    expected = jax.vmap(lambda a: lane({"a": a}, 0))(x)
    for key in expected:
        np.testing.assert_array_equal(results[key], expected[key])


def test_what_has_no_translation_runs_as_plain_xla():
    x = np.linspace(-2.0, 2.0, LANES)
    with pytest.warns(kernels.KernelWarning, match="no machine code for 'sort' in sorts"):
        start = kernels.compile_batches("lanes", sorts, ["a"], LANES, None, None)
    np.testing.assert_array_equal(start({"a": x}, np.arange(LANES))()[0]["largest"], np.maximum(x, 1.0))
