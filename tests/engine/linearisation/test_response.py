"""Margins of random loops: against eigenvalues, a dense frequency response, and python-control."""

import warnings

import control
import numpy as np
import pytest

from dssc_jax.engine.linearisation.response import (
    classical_margins,
    common_grid,
    grid_with_poles,
    named_margins,
    response_of,
)

SAMPLE_TIME, LOOPS = 0.05, 100


def random_loops(rng):
    """Stable loops under unit feedback; their own open loops may be unstable."""
    loops = []
    while len(loops) < LOOPS:
        order = int(rng.integers(1, 6))
        poles = np.where(rng.random(order) < 0.2, 1.02, 0.98) * np.exp(-0.2 * rng.exponential(size=order))
        turn = np.linalg.qr(rng.normal(size=(order, order)))[0]
        a = turn @ (np.diag(poles) + np.triu(rng.normal(size=(order, order)), 1) * 0.1) @ turn.T
        b, c = rng.normal(size=order), rng.normal(size=order) * 10.0 ** rng.uniform(-2.0, 0.0)
        if np.max(np.abs(np.linalg.eigvals(a - np.outer(b, c)))) < 0.999:
            loops.append((a, b, c))
    return loops


@pytest.fixture(scope="module")
def loops():
    return random_loops(np.random.default_rng(1))


def margins_of(a, b, c):
    """Of L = c (z - a)^-1 b: the added signal w gives u = -c x, x+ = (a - b c) x + b w."""
    closed = a - np.outer(b, c)
    poles = np.linalg.eigvals(closed)[None]
    grid = grid_with_poles(common_grid(poles), np.concatenate([poles, np.linalg.eigvals(a)[None]], axis=1))
    found = classical_margins(response_of(closed[None], b[None], -c[None]), grid, SAMPLE_TIME)
    return type(found)(*(float(value[0]) for value in found))


def is_stable(a, b, c, gain):
    return np.max(np.abs(np.linalg.eigvals(a - gain * np.outer(b, c)))) < 1.0


def test_gain_margins_are_where_eigenvalues_cross_the_unit_circle(loops):
    finite = 0
    for a, b, c in loops:
        found = margins_of(a, b, c)
        for gain, side in ((found.gain_upper, 1.0), (found.gain_lower, -1.0)):
            end = np.clip(gain, 1e-5, 1e5)
            assert all(is_stable(a, b, c, k) for k in np.geomspace(1.0, end * (1.0 - side * 1e-6), 40))
            if end == gain:
                assert not is_stable(a, b, c, gain * (1.0 + side * 1e-6))
                finite += 1
    assert finite > LOOPS


def test_the_rest_is_that_of_a_dense_frequency_response(loops):
    angles = np.concatenate([[1e-9], np.geomspace(1e-5, np.pi, 20000)])
    for a, b, c in loops:
        found = margins_of(a, b, c)
        matrix = np.exp(1j * angles)[:, None, None] * np.eye(len(a)) - a
        loop = np.linalg.solve(matrix, np.broadcast_to(b[:, None], (len(angles), len(a), 1)))[..., 0] @ c
        s = 1.0 / (1.0 + loop)
        assert found.sensitivity_peak == pytest.approx(np.abs(s).max(), rel=1e-4)
        assert found.complementary_peak == pytest.approx(np.abs(1.0 - s).max(), rel=1e-4)
        assert found.disk == pytest.approx(1.0 / np.abs(s - 0.5).max(), rel=1e-4)
        crossings = np.flatnonzero(np.diff(np.abs(loop) > 1.0))
        left = np.angle(-loop[crossings])
        assert found.phase == pytest.approx(np.abs(left).min(initial=np.inf), abs=2e-3)
        delays = np.mod(left, 2.0 * np.pi) / angles[crossings] * SAMPLE_TIME
        assert found.delay == pytest.approx(delays.min(initial=np.inf), rel=1e-2)


def test_python_control_finds_the_same(loops):
    """Of 100 loops; it misses crossings at z = -1, and finds phase crossings by roots of polynomials."""
    agreed = 0
    for a, b, c in loops:
        found = margins_of(a, b, c)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            system = control.ss(a, b[:, None], c[None], 0.0, SAMPLE_TIME)
            gains, phases, *_ = control.stability_margins(system, returnall=True)
        gains = np.append(np.asarray(gains), 1.0 / (margins_at_the_ends(a, b, c)))
        upper = gains[gains > 1.0].min(initial=np.inf)
        same_gain = found.gain_upper == pytest.approx(upper, rel=1e-4)
        same_phase = np.degrees(found.phase) == pytest.approx(np.abs(phases).min(initial=np.inf), rel=1e-4)
        agreed += same_gain and same_phase
    assert agreed >= 0.9 * LOOPS


def margins_at_the_ends(a, b, c):
    """-L at z = 1 and z = -1, where it is real."""
    return np.array([-c @ np.linalg.solve(z * np.eye(len(a)) - a, b) for z in (1.0, -1.0)])


def test_loops_with_different_numbers_of_crossings_have_finite_phases():
    """L = 0.5/(z - 1), with G = -1 at z = 1 and one crossover, and a resonance, with two."""
    damping, turn, gain = 0.95, 1.0, 0.15  # of L = -gain/(z^2 - 2 damping cos(turn) z + damping^2)
    resonance = [[2.0 * damping * np.cos(turn), gain - damping**2], [1.0, 0.0]]
    a = np.array([[[0.5, 0.0], [0.0, 0.0]], resonance])
    b, c = np.array([[1.0, 0.0], [1.0, 0.0]]), np.array([[-0.5, 0.0], [0.0, gain]])
    poles = np.linalg.eigvals(a)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        both = classical_margins(response_of(a, b, c), grid_with_poles(common_grid(poles), poles), SAMPLE_TIME)
    np.testing.assert_allclose(both.phase[0], 0.5 * np.pi - np.arcsin(0.25), rtol=1e-9)
    assert np.isfinite(both.delay).all()


def test_the_response_is_that_of_a_solve_at_each_angle():
    """Of delays, whose poles have no basis of eigenvectors, and of states whose units differ by 1e9."""
    rng = np.random.default_rng(3)
    a = 0.3 * rng.standard_normal((3, 7, 7))
    a[1] = np.diag(np.ones(6), -1)
    scale = 10.0 ** np.linspace(-4.0, 5.0, 7)
    a[2] *= scale[:, None] / scale
    b, c = rng.standard_normal((2, 3, 7))
    b[2] *= scale
    c[2] /= scale
    angles = np.sort(rng.uniform(0.0, np.pi, (3, 50)), axis=1)
    found = response_of(a, b, c)(angles)
    for i in range(3):
        for theta, value in zip(angles[i], found[i], strict=True):
            exact = c[i] @ np.linalg.solve(np.exp(1j * theta) * np.eye(7) - a[i], b[i])
            assert value == pytest.approx(exact, rel=1e-10)


def test_named_margins_are_those_of_all():
    rng = np.random.default_rng(5)
    a = 0.2 * rng.standard_normal((4, 3, 3))
    b, c = rng.standard_normal((2, 4, 3))
    poles = np.linalg.eigvals(a)
    arguments = response_of(a, b, c), grid_with_poles(common_grid(poles), poles), SAMPLE_TIME
    every = classical_margins(*arguments)
    for name in (*every._fields, "modulus"):
        np.testing.assert_array_equal(named_margins(*arguments, [name])[name], getattr(every, name))
