"""The compiler of lanes stands alone: its front door, and its tests with every other package deleted."""

import shutil
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax import lanes

SOURCES = Path(lanes.__file__).parent
TESTS = Path(__file__).parent
MEMBERS = 101


def van_der_pol(damping, state):
    """Ten seconds of Van der Pol's oscillator, by the midpoint rule."""

    def slope(x, v):
        return v, damping * (1.0 - x * x) * v - x

    def step(_, state):
        x, v = state
        dx, dv = slope(x, v)
        dx, dv = slope(x + 0.005 * dx, v + 0.005 * dv)
        return x + 0.01 * dx, v + 0.01 * dv

    return dict(zip(("x", "v"), jax.lax.fori_loop(0, 1000, step, state), strict=True))


@pytest.mark.parametrize("wide", [True, False])
def test_it_computes_what_jit_of_vmap_does(wide):
    with jax.enable_x64(wide):
        batch = lanes.compile(van_der_pol, 1.0, (1.0, 0.0))
        real = jnp.result_type(float)
        damping = np.linspace(0.1, 3.0, MEMBERS).astype(real)
        start = (np.linspace(-1.0, 2.0, MEMBERS).astype(real), np.zeros(MEMBERS, real))
        results = batch(damping, start)
        expected = jax.jit(jax.vmap(van_der_pol))(damping, start)
    tolerance = 1e-8 if wide else 1e-2
    for name in ("x", "v"):
        assert results[name].dtype == real
        np.testing.assert_allclose(results[name], expected[name], rtol=tolerance, atol=0.1 * tolerance)


def test_what_it_cannot_take_is_refused():
    with pytest.raises(lanes.Unsupported, match="'sort'"):
        lanes.compile(lambda x: jnp.sort(jnp.stack([x, 0.0]))[0], 1.0)
    with pytest.raises(TypeError, match=r"scalars, got an array of shape \(2,\)"):
        lanes.compile(jnp.sum, np.zeros(2))
    add = lanes.compile(jnp.add, 1.0, 1.0)
    with pytest.raises(ValueError, match=r"one shape \(n,\)"):
        add(np.zeros(2), np.zeros(3))
    with pytest.raises(TypeError, match="must have the structure"):
        add(np.zeros(2))


def test_it_passes_its_tests_with_everything_else_deleted(tmp_path):
    """A sample of them; the whole folder is run in place."""
    package = tmp_path / "dssc_jax"
    shutil.copytree(SOURCES, package / "lanes", ignore=shutil.ignore_patterns("__pycache__"))
    (package / "__init__.py").write_text("")
    shutil.copytree(TESTS, tmp_path / "tests" / "lanes", ignore=shutil.ignore_patterns("__pycache__", "test_alone.py"))
    (tmp_path / "tests" / "__init__.py").write_text("")
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "tests/lanes/test_regrouping.py"]
    done = subprocess.run([*command, "--collect-only", "tests/lanes"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
