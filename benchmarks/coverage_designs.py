"""Problems of ``coverage.py`` on failure probabilities by designs and strata, with known answers."""

from collections.abc import Callable

import numpy as np
from scipy import special, stats

from dssc_jax.analyses.probability.strata import stratified_probability
from dssc_jax.analyses.slacks import SlackFunction
from dssc_jax.engine.sampling import latin_design, sobol_points
from dssc_jax.runs.design_choice import LEAST_CASES, PILOT, PILOT_NETS, nets_of
from dssc_jax.statistics import FixedCount, Replicated
from dssc_jax.statistics.stratified import allocate_draws, stratified_interval

REPLICATES = 8
Trial = Callable[[int], np.ndarray | str]
"""Of a seed: where the interval lies, -1 below the truth, 0 around it, 1 above it; or why there is none."""


def side(intervals: np.ndarray | tuple[float, float], truth: np.ndarray | float) -> np.ndarray:
    """Where intervals, shape (..., 2), lie by the truth."""
    low, high = np.moveaxis(np.asarray(intervals), -1, 0)
    return np.where(high < truth, -1, np.where(low > truth, 1, 0))


def half_space(points: np.ndarray, p: float) -> np.ndarray:
    """A failure region of probability p that involves all coordinates alike."""
    return stats.norm.ppf(points).sum(-1) / np.sqrt(points.shape[-1]) > stats.norm.isf(p)


def sobol(p: float, draws: int) -> Trial:
    """Failures of scrambled Sobol replicates."""
    return nets(p, lambda points: half_space(points, p), REPLICATES, draws // REPLICATES)


def nets(p: float, fails: Callable[[np.ndarray], np.ndarray], replicates: int, size: int) -> Trial:
    """Failures in three numbers by independently scrambled Sobol nets."""

    def trial(seed: int) -> np.ndarray:
        points = [sobol_points(3, 0, size, (seed, r)) for r in range(replicates)]
        failed = fails(np.stack(points, axis=1).reshape(replicates * size, 3))
        return side(Replicated(replicates, "Sobol").interval(failed), p)

    return trial


def two_modes(points: np.ndarray, p: float) -> np.ndarray:
    """Failures at both ends of the first number."""
    return np.abs(points[..., 0] - 0.5) > 0.5 * (1.0 - p)


def behind_bend(points: np.ndarray, p: float) -> np.ndarray:
    """Failures outside a sphere around the median."""
    return np.sum(special.ndtri(points) ** 2, axis=-1) > stats.chi2(3).isf(p)


def automatic(p: float, fails: Callable[[np.ndarray, float], np.ndarray], draws: int) -> Trial:
    """A run of ``sampling = "auto"``: the pilot's choice, then the run."""
    replicates, size = nets_of(draws)

    def trial(seed: int) -> np.ndarray:
        points = [sobol_points(3, 0, PILOT // PILOT_NETS, (seed, 1, r)) for r in range(PILOT_NETS)]
        expected = (np.count_nonzero(fails(np.concatenate(points), p)) + 0.5) / (PILOT + 1) * draws
        if min(expected, draws - expected) >= LEAST_CASES:
            return nets(p, lambda cube: fails(cube, p), replicates, size)(seed)
        return side(FixedCount().interval(fails(np.random.default_rng(seed).random((draws, 3)), p)), p)

    return trial


def latin(p: float, draws: int) -> Trial:
    """Failures of Latin-hypercube replicates."""

    def trial(seed: int) -> np.ndarray:
        failed = half_space(latin_design(seed, (1, 2, 3), REPLICATES, draws), p)
        return side(Replicated(REPLICATES, "Latin").interval(failed), p)

    return trial


def strata(p: float, width: float, slack: SlackFunction, dimension: int) -> Trial:
    """The interval from strata along a predicted border."""
    return lambda seed: side(stratified_probability(slack, dimension, (seed,), width, 10**6).interval(), p)


def in_cube(fails: Callable[[np.ndarray, float], np.ndarray], p: float) -> SlackFunction:
    """A slack without a slope, of points of the unit cube: nothing but the sign predicts."""
    return lambda points, _: np.where(fails(points, p), -1.0, 1.0)


def smooth_slack(name: str, p: float) -> SlackFunction:
    """A slack of points of the unit cube in three dimensions, whose failures have the probability p."""
    if name == "half space":
        return lambda points, _: stats.norm.isf(p) - special.ndtri(points).sum(-1) / np.sqrt(3.0)
    if name == "two modes":
        return lambda points, _: 0.5 * (1.0 - p) - np.abs(points[:, 0] - 0.5)
    return lambda points, _: stats.chi2(3).isf(p) - np.sum(special.ndtri(points) ** 2, axis=-1)


def counts(true: tuple[float, ...], expected: tuple[float, ...], width: float) -> Trial:
    """The interval from strata whose shares of failures are known; the draws are planned for expected shares."""
    weights = np.array(WEIGHTS)
    shares = np.array(true)
    draws = allocate_draws(weights, np.array(expected), width, 10**6)

    def trial(seed: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        by_net = rng.multinomial(4096, weights, size=16) / 4096
        return side(stratified_interval(by_net, rng.binomial(draws, shares), draws), float(weights @ shares))

    return trial


WEIGHTS = (0.036, 0.025, 0.01, 0.01, 0.025, 0.062, 0.152, 0.68)
"""Probabilities of the strata of an axis."""

SHARP = (0.999, 0.98, 0.7, 0.2, 0.02, 0.001, 1e-5, 1e-6)
BLURRED = (0.7, 0.55, 0.45, 0.4, 0.3, 0.2, 0.1, 0.02)
EQUAL = (0.05,) * 8
SEVERAL = (0.004, 0.002, 0.003, 0.002, 0.004, 0.001, 5e-4, 1e-5)
FAR = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.5e-4)
COUNTS = {
    "a sharp border": (SHARP, SHARP),
    "a blurred border": (BLURRED, BLURRED),
    "a border that is blurred and expected to be sharp": (BLURRED, SHARP),
    "no border, expected to be sharp": (EQUAL, SHARP),
    "rare failures in all strata": (SEVERAL, SHARP),
    "failures of 1e-4 where none is expected": (FAR, SHARP),
}
"""Shares of failures in the strata, true and expected."""

STRATA = ((0.2, 0.05), (0.05, 0.02), (0.05, 0.008), (0.01, 0.01), (1e-4, 1e-3))
"""Probabilities, and widths of the interval."""

DESIGN_CASES: dict[str, tuple[str, Trial]] = {
    **{
        f"chosen design, {name}, p = {p:g}, n = {draws:,}": ("failure probability", automatic(p, fails, draws))
        for name, fails in (("half space", half_space), ("two modes", two_modes), ("curved border", behind_bend))
        for p, draws in ((0.2, 1000), (0.05, 1000), (0.05, 4096), (0.01, 10_000), (1e-4, 20_000))
    },
    **{
        f"strata, {name}, p = {p:g}, width {width:g}": (
            "failure probability",
            strata(p, width, smooth_slack(name, p), 3),
        )
        for name in ("half space", "two modes", "curved border")
        for p, width in STRATA
    },
    **{
        f"given strata, {name}, planned for a width of {width:g}": ("failure probability", counts(*shares, width))
        for name, shares in COUNTS.items()
        for width in (0.02, 0.004)
    },
    "strata, two modes that no slack predicts, p = 0.05, width 0.05": (
        "failure probability",
        strata(0.05, 0.05, in_cube(two_modes, 0.05), 3),
    ),
}
