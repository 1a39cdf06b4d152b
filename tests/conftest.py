"""Shared fixtures; float64 whatever the machine."""

import gc
import os

# Plain programs compile for longer than they run here. JAX reads these when it starts, in the processes of tests, too.
os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "true"
os.environ["JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS"] = "0.05"
os.environ["JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES"] = "-1"

import jax
import pytest

import dssc_jax

os.environ["DSSC_JAX_VERIFY"] = "1"  # each program of lanes, after each pass
jax.config.update("jax_enable_x64", True)
gc.freeze()  # compiled programs are many long-lived objects, and a full collection visits all of them
gc.set_threshold(50_000, 20, 50)


def pytest_collection_modifyitems(items):
    """The tests marked as long come first, so that no process is left alone with one at the end."""
    items.sort(key=lambda item: item.get_closest_marker("long") is None)


@pytest.fixture(scope="session", autouse=True)
def compiled_by_xla(tmp_path_factory):
    """Plain programs that several tests compile are compiled once, for all processes of a session."""
    session = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        session = session.parent
    os.environ["JAX_COMPILATION_CACHE_DIR"] = str(session / "xla")
    jax.config.update("jax_compilation_cache_dir", os.environ["JAX_COMPILATION_CACHE_DIR"])


CASE_2 = {
    "name": "case-2-x",
    "draws": 1,
    "loop": {"duration": 80.0, "sample_time": 0.005},
    "plant": {"kind": "normal_form", "initial": [40.0, 0.0]},
    "reference": {"kind": "mission", "axis": "x"},
    "controller": {
        "kind": "dssc",
        "l0": 0.2,
        "rho": 1.5,
        "functions": {
            "kind": "square_root",
            "kappa_o": 110.651,
            "kappa_m": 4.0166,
            "delta_o": 1.0,
            "delta_m": 1.0,
            "tau_av": 0.03,
        },
        "nominal": {"a": 1.0, "k": 1.0},
        "discretisation": "implicit",
        "predictor_start": "zero",
    },
    "disturbance": {"kind": "step", "value": -0.8, "at": 20.0},
    "requirement": [{"metric": "error_rms", "after": 40.0, "max": 5.0}],
}

UNCERTAIN = {
    "name": "uncertain",
    "seed": 3,
    "draws": 24,
    "loop": {"duration": 4.0, "sample_time": 0.01},
    "plant": {
        "kind": "normal_form",
        "k_p": {"uniform": [0.8, 1.2]},
        "a_p": {"normal": [1.0, 0.1]},
        "zero_dynamics": {"a": [2.0, {"uniform": [1.0, 2.0]}], "c": [0.2, 0.1]},
        "initial": [1.0, 0.0],
    },
    "reference": {"kind": "sine", "amplitude": 1.0, "period": 4.0},
    "controller": {
        "kind": "dssc",
        "l0": 1.0,
        "rho": {"uniform": [3.0, 5.0]},
        "functions": {"kind": "approx_sta_2", "kappa1": 1.0, "kappa2": 1.0, "delta": 0.5, "tau_av": 0.05},
        "predictor_start": "zero",
    },
    "unmodelled": {"kind": "lag", "order": 2, "mu": {"loguniform": [1e-3, 0.1]}},
    "disturbance": {"kind": "filtered_noise", "std": 0.2, "correlation_time": 0.5},
    "requirement": [{"metric": "error_max", "after": 2.0, "max": 1.6}],
    "sweep": {"controller.functions.tau_av": [0.02, 0.05, 0.1], "controller.l0": [0.5, 1.0]},
}


@pytest.fixture
def case_2() -> "dssc_jax.Study":
    """Section V-B, Case 2, x axis."""
    return dssc_jax.Study.from_table(CASE_2)


@pytest.fixture
def uncertain() -> "dssc_jax.Study":
    """A small study that uses a bit of everything."""
    return dssc_jax.Study.from_table(UNCERTAIN)
