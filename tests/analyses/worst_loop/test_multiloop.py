"""The worst disk margin of all commands at once, against dense sampling and perturbed loops by NumPy.

NumPy's mu of a loop of two channels is its closed form, which no part of the package uses.
"""

import itertools

import control
import numpy as np
import pytest
from scipy.linalg import expm

from dssc_jax.analyses.worst_loop.cells import cover_box
from dssc_jax.analyses.worst_loop.joint import joint_disk_margins, joint_mu_bound, worst_joint_margin
from dssc_jax.analyses.worst_loop.readouts import joint_readout, norm_over_box
from dssc_jax.analyses.worst_loop.search import spectral_radii

T_S = 0.01
GAP = 1.05


def no_point_limit():
    return 2**62


def closed_form(matrices):
    """mu of matrices of two rows for two complex scalars, shape (...)."""
    a, b, c, d = (matrices[..., i, j] for i in (0, 1) for j in (0, 1))
    total = np.abs(a) ** 2 + np.abs(d) ** 2 + 2.0 * np.abs(b * c)
    root = np.sqrt(np.maximum(total**2 - 4.0 * np.abs(a * d - b * c) ** 2, 0.0))
    return np.sqrt(0.5 * (total + root))


def dense_alpha(matrices, angles):
    """The disk margin of all commands at once at given angles, by NumPy; shape (n,)."""
    a, b, c = matrices[:, :-2, :-2], matrices[:, :-2, -2:], matrices[:, -2:, :-2]
    alphas = np.full(len(a), np.inf)
    for theta in angles:
        response = c @ np.linalg.inv(np.exp(1j * theta) * np.eye(a.shape[-1]) - a) @ b
        alphas = np.minimum(alphas, 1.0 / closed_form(response + 0.5 * np.eye(2)))
    return alphas


def satellite(points):
    """The spinning satellite under K = [[1, -2], [0, 1]], sampled with both commands held; spin and gains uncertain."""
    result = np.zeros((len(points), 4, 4))
    for row, (spin, first, second) in zip(result, points, strict=True):
        a = 10.0 * (1.0 + 0.05 * spin)
        held = expm(T_S * np.block([[np.array([[0.0, a], [-a, 0.0]]), np.eye(2)], [np.zeros((2, 4))]]))
        b = held[:2, 2:] @ np.diag([1.0 + 0.1 * first, 1.0 + 0.1 * second])
        c = -np.array([[1.0, -2.0], [0.0, 1.0]]) @ np.array([[1.0, a], [-a, 1.0]])
        row[:2, :2] = held[:2, :2] + b @ c
        row[:2, 2:] = b
        row[2:, :2] = c
    return result


def random_family(seed, sides):
    """Loops of four states and two commands whose matrices depend on the numbers, not linearly."""
    rng = np.random.default_rng(seed)
    base = rng.normal(size=(4, 4))
    base *= 0.8 / np.abs(np.linalg.eigvals(base)).max()
    moves = 0.04 * rng.normal(size=(sides, 4, 4))
    b = rng.normal(size=(4, 2))
    c = 0.3 * rng.normal(size=(2, 4))

    def evaluate(points):
        result = np.zeros((len(points), 6, 6))
        result[:, :4, :4] = base + np.einsum("nk,kij->nij", points + 0.1 * points**2, moves)
        result[:, :4, 4:] = b * (1.0 + 0.1 * points[:, :1, None])
        result[:, 4:, :4] = c
        return result

    return evaluate


FAMILIES = {"satellite": (satellite, 3), "random 1": (random_family(1, 2), 2), "random 2": (random_family(5, 2), 2)}


@pytest.mark.parametrize("name", FAMILIES)
def test_the_bound_holds_on_a_dense_sample_and_is_near_the_worst_found(name):
    evaluate, sides = FAMILIES[name]
    worst = worst_joint_margin(evaluate, sides, 2, T_S, no_point_limit)
    covered = joint_mu_bound(evaluate, sides, 2, GAP / worst.value, 20_000, no_point_limit)
    assert covered.stable
    bounded = 1.0 / covered.gains[0]
    points = np.array(list(itertools.product(np.linspace(-1.0, 1.0, 9), repeat=sides)))
    sampled = dense_alpha(evaluate(points), np.geomspace(1e-4, np.pi, 600))
    assert bounded <= sampled.min()
    assert worst.value <= sampled.min() * (1.0 + 1e-3)
    assert worst.value / GAP * (1.0 - 1e-9) <= bounded <= worst.value
    assert worst.value == pytest.approx(
        dense_alpha(evaluate(worst.point[None]), np.geomspace(1e-4, np.pi, 4000))[0], rel=1e-3
    )


def test_the_factors_found_make_the_worst_loop_oscillate():
    worst = worst_joint_margin(satellite, 3, 2, T_S, lambda: 30)
    matrices = satellite(worst.point[None])
    found = joint_disk_margins(matrices, 2, T_S)
    a, b, c = matrices[0, :2, :2], matrices[0, :2, 2:], matrices[0, 2:, :2]
    perturbed = a + b @ np.diag(found.factors[0] - 1.0) @ c
    assert np.abs(np.linalg.eigvals(perturbed) - np.exp(1j * found.frequency[0] * T_S)).min() < 1e-6
    disk = 2.0 * (found.factors[0] - 1.0) / (found.factors[0] + 1.0)
    np.testing.assert_allclose(np.abs(disk), worst.value, rtol=1e-9)


def test_the_satellite_without_uncertainty_has_its_published_margin():
    """At T_s = 1e-4 s the sampled loop is nearly the continuous one, whose margin is a closed form."""
    period = 1e-4

    def evaluate(points):
        held = expm(period * np.block([[np.array([[0.0, 10.0], [-10.0, 0.0]]), np.eye(2)], [np.zeros((2, 4))]]))
        b = held[:2, 2:]
        c = -np.array([[1.0, -2.0], [0.0, 1.0]]) @ np.array([[1.0, 10.0], [-10.0, 1.0]])
        result = np.zeros((len(points), 4, 4))
        result[:, :2, :2] = held[:2, :2] + b @ c
        result[:, :2, 2:] = b
        result[:, 2:, :2] = c
        return result

    found = joint_disk_margins(evaluate(np.zeros((1, 1))), 2, period).attained[0]
    covered = joint_mu_bound(evaluate, 1, 2, 1.001 / found, 20_000, no_point_limit)
    s = 1j * np.geomspace(1e-3, 1e3, 2000)[:, None, None]
    loop = np.array([[1.0, -2.0], [0.0, 1.0]]) @ np.array([[1.0, 10.0], [-10.0, 1.0]])
    loop = loop @ np.linalg.inv(s * np.eye(2) - np.array([[0.0, 10.0], [-10.0, 0.0]]))
    continuous = 1.0 / closed_form(np.linalg.inv(np.eye(2) + loop) - 0.5 * np.eye(2)).max()
    assert found == pytest.approx(continuous, rel=1e-3)
    assert 0.998 * found <= 1.0 / covered.gains[0] <= found * (1.0 + 1e-9)


def test_the_satellites_margin_is_near_python_controls():
    pytest.importorskip("slycot")
    plant = control.ss([[0.0, 10.0], [-10.0, 0.0]], np.eye(2), [[1.0, 10.0], [-10.0, 1.0]], np.zeros((2, 2)))
    gains = control.ss([], [], [], [[1.0, -2.0], [0.0, 1.0]])
    published = control.disk_margins(gains * plant, np.geomspace(0.1, 1000.0, 500))[0]  # broken at the commands
    assert published == pytest.approx(joint_disk_margins(satellite(np.zeros((1, 3))), 2, T_S).attained[0], rel=0.05)


def test_three_channels_are_bounded_below_dense_perturbations():
    """Random loops of three commands: no factor within the bound makes any loop of the box unstable."""
    rng = np.random.default_rng(3)
    base = rng.normal(size=(4, 4))
    base *= 0.7 / np.abs(np.linalg.eigvals(base)).max()
    b = rng.normal(size=(4, 3))
    c = 0.2 * rng.normal(size=(3, 4))

    def evaluate(points):
        result = np.zeros((len(points), 7, 7))
        result[:, :4, :4] = base * (1.0 + 0.1 * points[:, :1, None])
        result[:, :4, 4:] = b
        result[:, 4:, :4] = c
        return result

    worst = worst_joint_margin(evaluate, 1, 3, T_S, no_point_limit)
    covered = joint_mu_bound(evaluate, 1, 3, GAP / worst.value, 20_000, no_point_limit)
    bounded = 1.0 / covered.gains[0]
    assert worst.value / GAP * (1.0 - 1e-9) <= bounded <= worst.value
    for _ in range(2000):
        matrix = evaluate(rng.uniform(-1.0, 1.0, (1, 1)))[0]
        delta = 0.999 * bounded * np.exp(2j * np.pi * rng.random(3))
        factors = (1.0 + 0.5 * delta) / (1.0 - 0.5 * delta)
        perturbed = matrix[:4, :4] + matrix[:4, 4:] @ np.diag(factors - 1.0) @ matrix[4:, :4]
        assert np.abs(np.linalg.eigvals(perturbed)).max() < 1.0


def test_a_coupling_in_one_direction_does_not_spoil_the_bound():
    """mu of a triangular matrix is that of its diagonal, which no finite D attains."""

    def evaluate(points):
        result = np.zeros((len(points), 4, 4))
        result[:, 0, 0] = 0.5 + 0.1 * points[:, 0]
        result[:, 1, 1] = 0.4
        result[:, 1, 2] = 50.0
        result[:, 0, 2] = result[:, 1, 3] = 0.5
        result[:, 2, 0] = result[:, 3, 1] = -0.5
        return result

    worst = worst_joint_margin(evaluate, 1, 2, T_S, no_point_limit)
    sampled = dense_alpha(evaluate(np.linspace(-1.0, 1.0, 41)[:, None]), np.linspace(1e-4, np.pi, 800)).min()
    covered = joint_mu_bound(evaluate, 1, 2, GAP / worst.value, 20_000, no_point_limit)
    assert worst.value == pytest.approx(sampled, rel=1e-3)
    assert worst.value / GAP <= 1.0 / covered.gains[0] <= sampled


def test_an_unstable_loop_in_the_box_leaves_no_bound():
    def evaluate(points):
        return satellite(np.array([0.0, 1.0, 1.0]) * points[:, :1] * 200.0)

    assert spectral_radii(evaluate(np.array([[1.0]])), 2)[0] > 1.0
    assert worst_joint_margin(evaluate, 1, 2, T_S, no_point_limit).value == 0.0
    ends = (-np.ones(1), np.ones(1))
    assert not cover_box(evaluate, ends, np.array([1e300]), 2000, no_point_limit, joint_readout(2)).stable


def test_a_norm_over_a_box_bounds_every_point_of_it():
    rng = np.random.default_rng(0)
    centre = rng.normal(size=(1, 3, 3)) + 1j * rng.normal(size=(1, 3, 3))
    parts = 0.2 * (rng.normal(size=(1, 6, 3, 3)) + 1j * rng.normal(size=(1, 6, 3, 3)))
    bound = norm_over_box(centre, parts)[0]
    points = rng.choice([-1.0, 1.0], (500, 6))
    sampled = np.linalg.norm(centre + np.einsum("nk,kij->nij", points, parts[0]), 2, axis=(1, 2)).max()
    assert sampled <= bound <= 1.5 * sampled
    assert norm_over_box(centre, parts[:, :4])[0] == pytest.approx(
        max(
            np.linalg.norm(centre[0] + np.einsum("k,kij->ij", s, parts[0, :4]), 2)
            for s in itertools.product((-1, 1), repeat=4)
        )
    )
