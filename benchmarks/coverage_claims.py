"""Problems of ``coverage.py`` on tolerance limits, regions, Shapley effects and Morris, with known answers."""

import numpy as np
from coverage_designs import Trial, side
from scipy import special, stats

from dssc_jax.analyses.region.safe_region import PASSING, thresholds
from dssc_jax.analyses.sensitivity.morris import elementary_effects, screening, trajectories
from dssc_jax.analyses.sensitivity.shapley import chained_scores, random_orders, shapley_effects
from dssc_jax.analyses.sensitivity.sobol import saltelli_samples
from dssc_jax.engine.sampling import inside_cube
from dssc_jax.statistics import CONFIDENCE, tolerance_limits

WEIGHTS = np.array([2.0, 1.0, 0.0])
"""Of a sum of three numbers."""


def tolerance(draws: int, content: float) -> Trial:
    """A lower tolerance limit of a skewed law: at least this share of the law lies above it."""
    bound = stats.lognorm.ppf(1.0 - content, 1.0)

    def trial(seed: int) -> np.ndarray:
        values = np.random.default_rng(seed).lognormal(size=draws)
        low, _ = tolerance_limits(values, content, CONFIDENCE, side="lower")
        return side((low, np.inf), bound)

    return trial


def pairs(points: int, draws: int) -> Trial:
    """All verdicts of a region: none of a lattice's points is said to meet or to fail against the truth.

    Failure probabilities go from 0.01 to 0.1 along the lattice, with many near the 5 % that decide; draws are common.
    """
    truth = np.concatenate([np.linspace(0.01, 0.1, points // 2), np.linspace(0.049, 0.051, points - points // 2)])
    shifts = 0.3 * np.random.default_rng(7).random((points, 1))
    meets, fails = thresholds(draws, points)

    def trial(seed: int) -> np.ndarray:
        common = np.random.default_rng(seed).random(draws)
        failures = np.count_nonzero((common + shifts) % 1.0 < truth[:, None], axis=1)
        wrongly_meets = (failures <= meets) & (truth > 1.0 - PASSING)
        wrongly_fails = (failures >= fails) & (truth < 1.0 - PASSING)
        return np.asarray(int(np.any(wrongly_fails)) - int(np.any(wrongly_meets)))

    return trial


def shapley(rows: int, correlation: float) -> Trial:
    """Shapley effects of a sum of three normal numbers, of which the first two are correlated."""
    matrix = np.eye(3)
    matrix[0, 1] = matrix[1, 0] = correlation
    a, b = WEIGHTS[:2]
    shared = 0.5 * correlation**2 * (a**2 - b**2)
    parts = np.array([a**2 + a * b * correlation - shared, b**2 + a * b * correlation + shared, 0.0])
    truth = parts / parts.sum()

    def trial(seed: int) -> np.ndarray:
        order = random_orders(rows, 3, (seed,))
        first, second = (special.ndtri(inside_cube(points)) for points in saltelli_samples(rows, 3, (seed,)))
        values = chained_scores(matrix, first, second, order) @ WEIGHTS
        return side(shapley_effects(values, order)[:, 1:], truth)

    return trial


def morris(count: int) -> Trial:
    """mu* of a function whose elementary effects are known: x^2 + 2 x y + 0 z on the levels of the grid."""
    start = np.array([0.125, 0.375])  # the lower levels, from which a move goes up by a half
    x = (start + 0.5) ** 2 - start**2
    everywhere = np.array([0.125, 0.375, 0.625, 0.875])
    truth = np.array([np.mean(x[:, None] + everywhere), np.mean(everywhere), 0.0])

    def trial(seed: int) -> np.ndarray:
        levels, order = trajectories(count, 3, (seed,))
        values = levels[..., 0] ** 2 + 2.0 * levels[..., 0] * levels[..., 1]
        sizes, _ = screening(elementary_effects(values, levels, order), CONFIDENCE)
        return side(sizes[:, 1:], truth)

    return trial


CLAIM_CASES: dict[str, tuple[str, Trial]] = {
    "lower limit of 95 %, lognormal, n = 59": ("tolerance limit", tolerance(59, 0.95)),
    "lower limit of 95 %, lognormal, n = 200": ("tolerance limit", tolerance(200, 0.95)),
    "all verdicts of 1,089 points near 95 %, n = 240": ("safe region", pairs(1089, 240)),
    "all verdicts of 289 points near 95 %, n = 1000": ("safe region", pairs(289, 1000)),
    "sum of normal numbers, 1,024 rows, the least of 3": ("Shapley effect", shapley(1024, 0.0)),
    "correlation 0.6, 1,024 rows, the least of 3": ("Shapley effect", shapley(1024, 0.6)),
    "quadratic function, 20 trajectories, the least of 3": ("Morris mu*", morris(20)),
    "quadratic function, 100 trajectories, the least of 3": ("Morris mu*", morris(100)),
}
