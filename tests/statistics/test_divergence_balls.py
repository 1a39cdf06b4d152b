"""The worst case over laws within a divergence, against closed forms, random laws and a search over whole laws."""

import math

import numpy as np
import pytest
from scipy import optimize, special

from dssc_jax.statistics.divergence_balls import BALLS, ChiSquare, KullbackLeibler, TotalVariation

PAIRS = 10_000


def divergences(q, p):
    """The three divergences of laws on finitely many values, by their definitions, shape (n,)."""
    return {
        "total_variation": 0.5 * np.abs(q - p).sum(-1),
        "kl": special.rel_entr(q, p).sum(-1),
        "chi_square": (np.square(q - p) / p).sum(-1),
    }


@pytest.fixture(scope="module")
def pairs():
    """Random pairs of laws on six values, from nearly equal to very different, and the failing values of each."""
    rng = np.random.default_rng(5)
    concentration = np.exp(rng.uniform(-1.5, 3.0, PAIRS))[:, None]
    p = rng.standard_gamma(np.broadcast_to(concentration, (PAIRS, 6))) + 1e-12
    q = rng.standard_gamma(np.broadcast_to(concentration, (PAIRS, 6))) + 1e-12
    share = rng.uniform(0.0, 1.0, PAIRS)[:, None]
    p /= p.sum(-1, keepdims=True)
    q /= q.sum(-1, keepdims=True)
    failing = rng.random((PAIRS, 6)) < 0.4
    return p, (1.0 - share) * p + share * q, failing


@pytest.mark.parametrize("name", BALLS)
def test_no_law_within_the_ball_is_worse(pairs, name):
    p, q, failing = pairs
    assumed, true = (np.sum(law * failing, axis=-1).clip(0.0, 1.0) for law in (p, q))
    ball = BALLS[name]
    radii = divergences(q, p)[name]
    assert radii.min() < 1e-3
    assert radii.max() > 0.5
    for probability, changed, radius in zip(assumed, true, radii, strict=True):
        assert ball.best(probability, radius) - 1e-12 <= changed <= ball.worst(probability, radius) + 1e-12
        if probability < changed < 1.0:
            assert ball.largest_radius(probability, changed) <= radius * (1.0 + 1e-9) + 1e-12


@pytest.mark.parametrize("name", BALLS)
@pytest.mark.parametrize("p", [0.001, 0.05, 0.3])
@pytest.mark.parametrize("radius", [0.0, 0.003, 0.1, 0.6])
def test_a_binary_law_attains_the_bound(name, p, radius):
    """A density that is constant on the failing values and on the others."""
    ball = BALLS[name]
    worst = ball.worst(p, radius)
    law = np.array([0.3 * p, 0.7 * p, 0.6 * (1.0 - p), 0.4 * (1.0 - p)])
    tilted = law * np.array([worst / p, worst / p, (1.0 - worst) / (1.0 - p), (1.0 - worst) / (1.0 - p)])
    assert divergences(tilted, law)[name] <= radius * (1.0 + 1e-9) + 1e-15
    assert worst == 1.0 or divergences(tilted, law)[name] == pytest.approx(radius, rel=1e-9, abs=1e-12)
    if p < worst < 1.0:
        assert ball.largest_radius(p, worst) == pytest.approx(radius, rel=1e-9)


def test_kullback_leibler_against_exponential_tilting():
    """The worst law of a KL ball tilts the failing values by e^theta: p e^theta / (1 - p + p e^theta)."""
    p = 0.02
    for theta in (0.1, 1.0, 3.0, 6.0):
        q = p * math.exp(theta) / (1.0 - p + p * math.exp(theta))
        radius = q * theta - math.log(1.0 - p + p * math.exp(theta))
        assert abs(KullbackLeibler().worst(p, radius) - q) < 1e-12


@pytest.mark.parametrize("name", BALLS)
def test_a_search_over_whole_laws_finds_nothing_worse(name):
    """By SLSQP over all laws on five values."""
    p = np.array([0.02, 0.05, 0.33, 0.4, 0.2])
    radius = 0.05
    found = optimize.minimize(
        lambda q: -(q[0] + q[1]),
        p * np.array([1.1, 1.1, 0.99, 0.98, 0.98]) / (p @ np.array([1.1, 1.1, 0.99, 0.98, 0.98])),
        bounds=[(1e-9, 1.0)] * 5,
        constraints=[
            {"type": "eq", "fun": lambda q: q.sum() - 1.0},
            {"type": "ineq", "fun": lambda q: radius - divergences(q, p)[name]},
        ],
        method="SLSQP",
        options={"ftol": 1e-12, "maxiter": 500},
    )
    assert -found.fun == pytest.approx(BALLS[name].worst(0.07, radius), abs=1e-6)


def test_pinned_values():
    assert TotalVariation().worst(0.01, 0.02) == pytest.approx(0.03)
    assert ChiSquare().worst(0.1, 0.25) == pytest.approx(0.25)
    assert KullbackLeibler().largest_radius(0.01, 0.05) == pytest.approx(0.05 * math.log(5) + 0.95 * math.log(95 / 99))


@pytest.mark.parametrize("name", BALLS)
def test_the_ends(name):
    ball = BALLS[name]
    assert ball.largest_radius(0.05, 0.05) == ball.largest_radius(0.2, 0.05) == 0.0
    assert ball.worst(0.3, 50.0) == 1.0
    assert ball.best(0.3, 50.0) == 0.0
    assert ball.worst(1.0, 0.1) == 1.0
    assert ball.worst(0.0, 0.1) == (0.1 if name == "total_variation" else 0.0)
    assert ball.largest_radius(0.0, 0.05) == (0.05 if name == "total_variation" else math.inf)
    low, high = ball.interval((0.01, 0.04), 0.01)
    assert low == ball.best(0.01, 0.01) < 0.01
    assert high == ball.worst(0.04, 0.01) > 0.04


@pytest.mark.parametrize("name", BALLS)
def test_bad_arguments_are_refused(name):
    for arguments in ((-0.1, 0.1), (1.1, 0.1), (math.nan, 0.1), (0.1, -0.1), (0.1, math.nan)):
        with pytest.raises(ValueError, match="must"):
            BALLS[name].worst(*arguments)
    for limit in (0.0, 1.0, math.nan):
        with pytest.raises(ValueError, match="limit must lie"):
            BALLS[name].largest_radius(0.1, limit)
