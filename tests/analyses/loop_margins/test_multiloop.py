"""Disk margins of all loops at once: against closed forms, brute force, eigenvalues and a published example."""

import control
import numpy as np
import pytest

from dssc_jax.analyses.loop_margins.multiloop import JointLoops, multiloop_margins, peak_bound
from dssc_jax.analyses.loop_margins.structured import lower_bounds, upper_bounds
from dssc_jax.closed_loop.break_points import place_names
from dssc_jax.engine.linearisation.matrices import Operating, StateMatrices
from dssc_jax.engine.linearisation.response import grid_with_poles, loop_grids

T_S = 0.05


def random_matrices(channels, count=40):
    rng = np.random.default_rng(channels)
    size = (count, channels, channels)
    return (rng.normal(size=size) + 1j * rng.normal(size=size)) * np.exp(rng.normal(size=(count, channels, 1)))


@pytest.mark.parametrize("channels", [2, 3, 4])
def test_the_bounds_enclose_mu_and_meet_up_to_three_channels(channels):
    matrices = random_matrices(channels)
    upper = upper_bounds(matrices)
    lower, diagonals = lower_bounds(matrices)
    assert np.all(lower <= upper * (1.0 + 1e-12))
    np.testing.assert_allclose(lower, upper, rtol=1e-7 if channels < 4 else 0.02)
    np.testing.assert_allclose(np.abs(diagonals) * lower[:, None], 1.0, rtol=1e-12)
    singular = np.linalg.svd(np.eye(channels) - matrices * diagonals[:, None, :], compute_uv=False)
    assert np.max(singular[:, -1]) < 1e-12  # I - M Delta, for the perturbation that was found


def test_two_channels_have_the_closed_form_and_the_brute_force():
    matrices = random_matrices(2)
    phases = np.exp(1j * np.linspace(0.0, 2.0 * np.pi, 4001))
    for matrix, bound in zip(matrices, upper_bounds(matrices), strict=True):
        a, b, c, d = matrix.ravel()
        total = abs(a) ** 2 + abs(d) ** 2 + 2.0 * abs(b * c)
        closed = np.sqrt(0.5 * (total + np.sqrt(total**2 - 4.0 * abs(a * d - b * c) ** 2)))
        assert bound == pytest.approx(closed, rel=1e-9)
        turned = matrix[None] * np.stack([np.ones_like(phases), phases], axis=1)[:, None, :]
        assert np.abs(np.linalg.eigvals(turned)).max() == pytest.approx(bound, rel=1e-5)


def test_the_example_of_python_control():
    """The spinning satellite: its tests expect 0.3754 at the lowest frequency, by a bound that is not tight."""
    plant = control.ss([[0.0, 10.0], [-10.0, 0.0]], np.eye(2), [[1.0, 10.0], [-10.0, 1.0]], np.zeros((2, 2)))
    gains = np.array([[1.0, -2.0], [0.0, 1.0]])
    omega = np.geomspace(0.1, 1000.0, 4000)
    loop = np.moveaxis(plant(1j * omega), -1, 0) @ gains
    balanced_sensitivity = np.linalg.inv(np.eye(2) + loop) - 0.5 * np.eye(2)
    margins = 1.0 / upper_bounds(balanced_sensitivity)
    assert np.argmin(margins) == 0
    assert 0.3754 <= margins[0] <= 1.005 * 0.3754
    assert margins[0] == pytest.approx(1.0 / lower_bounds(balanced_sensitivity[:1])[0][0], rel=1e-9)


def random_loops(channels, count=4, states=5):
    """Stable closed loops as arrays A, B, C."""
    rng = np.random.default_rng(10 + channels)
    a = rng.normal(size=(count, states, states))
    a *= (rng.uniform(0.6, 0.97, count) / np.abs(np.linalg.eigvals(a)).max(axis=1))[:, None, None]
    return a, rng.normal(size=(count, states, channels)), 0.5 * rng.normal(size=(count, channels, states))


@pytest.mark.parametrize("channels", [2, 3])
def test_loops_oscillate_at_the_margin_and_are_stable_within_it(channels):
    a, b, c = random_loops(channels)
    names = place_names([f"c{i}" for i in range(channels)])
    columns = [i for i, name in enumerate(names) if name.endswith("input")]
    full_b = np.zeros((len(a), a.shape[1], len(names)))
    full_c = np.zeros((len(a), len(names), a.shape[1]))
    full_b[:, :, columns] = b
    full_c[:, columns] = c
    operating = Operating(StateMatrices(a[:, 0], a, full_b, full_c), np.ones(len(a), bool), np.zeros(len(a), bool), ())
    found = multiloop_margins([f"c{i}" for i in range(channels)], operating, T_S)
    np.testing.assert_allclose(found.attained, found.guaranteed, rtol=1e-6)
    rng = np.random.default_rng(0)
    for i in range(len(a)):
        perturbed = a[i] + b[i] @ np.diag(found.factors[i] - 1.0) @ c[i]
        critical = np.exp(1j * found.frequency[i] * T_S)
        assert np.abs(np.linalg.eigvals(perturbed) - critical).min() < 1e-6
        disk = 2.0 * (found.factors[i] - 1.0) / (found.factors[i] + 1.0)
        np.testing.assert_allclose(np.abs(disk), found.attained[i], rtol=1e-9)
        for _ in range(200):
            delta = 0.999 * found.guaranteed[i] * np.exp(2j * np.pi * rng.random(channels))
            within = a[i] + b[i] @ np.diag((1.0 + 0.5 * delta) / (1.0 - 0.5 * delta) - 1.0) @ c[i]
            assert np.abs(np.linalg.eigvals(within)).max() < 1.0


def test_the_peak_is_that_of_a_dense_grid():
    loops = JointLoops(*random_loops(2))
    poles = np.linalg.eigvals(loops.a)
    _, largest = peak_bound(loops, grid_with_poles(loop_grids(poles), poles))
    dense = loops.at(np.broadcast_to(np.linspace(1e-6, np.pi, 4000), (len(poles), 4000)))
    bounds = upper_bounds(dense.reshape(-1, 2, 2)).reshape(len(poles), -1)
    assert np.all(largest >= bounds.max(axis=1) * (1.0 - 1e-9))
    np.testing.assert_allclose(largest, bounds.max(axis=1), rtol=1e-3)
