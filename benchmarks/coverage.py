"""Do the intervals cover what they say? Regenerates the table of docs/statistics.md: ``python benchmarks/coverage.py``.

Every kind of interval, 1,000 times each, on problems whose answer is known. Exits with 1 where one covers less than its
nominal 95 % minus 2 %.
"""

import sys
from collections.abc import Callable
from itertools import count

import dssc_jax as dj  # isort: skip  (sets compiler flags before anything starts JAX)
import numpy as np
from page import put
from scipy import stats

from dssc_jax.global_sensitivity import saltelli, sobol_indices
from dssc_jax.rare_events import split
from dssc_jax.sampling import latin_design, sobol_points
from dssc_jax.statistics import (
    DataDriven,
    FixedCount,
    Replicated,
    compare_failures,
    compare_metrics,
    looks,
    quantile_interval,
)

REPETITIONS, NOMINAL, ALLOWED = 1000, 0.95, 0.02
REPLICATES = 8
Trial = Callable[[int], np.ndarray | bool]


def within(interval: np.ndarray | tuple[float, float], truth: float) -> bool:
    """Whether an interval holds the truth."""
    return bool(interval[0] <= truth <= interval[1])


def independent(p: float, draws: int) -> Trial:
    """Failures of independent draws."""
    return lambda seed: within(FixedCount().interval(np.random.default_rng(seed).random(draws) < p), p)


def half_space(points: np.ndarray, p: float) -> np.ndarray:
    """A failure region of probability p that involves all coordinates alike."""
    return stats.norm.ppf(points).sum(-1) / np.sqrt(points.shape[-1]) > stats.norm.isf(p)


def sobol(p: float, draws: int) -> Trial:
    """Failures of scrambled Sobol replicates."""

    def trial(seed: int) -> bool:
        nets = [sobol_points(3, 0, draws // REPLICATES, (seed, r)) for r in range(REPLICATES)]
        failed = half_space(np.stack(nets, axis=1).reshape(draws, 3), p)
        return within(Replicated(REPLICATES, "Sobol").interval(failed), p)

    return trial


def latin(p: float, draws: int) -> Trial:
    """Failures of Latin-hypercube replicates."""

    def trial(seed: int) -> bool:
        failed = half_space(latin_design(seed, (1, 2, 3), REPLICATES, draws), p)
        return within(Replicated(REPLICATES, "Latin").interval(failed), p)

    return trial


def quantile(level: float, draws: int) -> Trial:
    """A quantile of a skewed law."""
    truth = stats.lognorm.ppf(level, 1.0)
    return lambda seed: within(quantile_interval(np.random.default_rng(seed).lognormal(size=draws), level), truth)


def paired(p_a: float, p_b: float, draws: int) -> Trial:
    """Two failure probabilities from common normal draws with correlation 0.9."""
    law = stats.multivariate_normal([0.0, 0.0], [[1.0, 0.9], [0.9, 1.0]])

    def trial(seed: int) -> bool:
        a, b = law.rvs(draws, random_state=seed).T
        found = compare_failures(a > stats.norm.isf(p_a), b > stats.norm.isf(p_b))
        return within(found.interval, p_a - p_b)

    return trial


def paired_metric(draws: int) -> Trial:
    """The median of a metric's difference, with draws that ended early."""

    def trial(seed: int) -> bool:
        rng = np.random.default_rng(seed)
        common = rng.standard_cauchy(draws)
        a = np.where(rng.random(draws) < 0.05, np.nan, common + rng.exponential(size=draws))
        b = np.where(rng.random(draws) < 0.05, np.nan, common)
        # both gone: 0; a gone: inf; b gone: -inf; else exponential, so that the median solves F(m) = 1/2
        m = -np.log1p(-(0.5 - 0.05 * 0.95 - 0.05 * 0.05) / (0.95 * 0.95))
        return within(compare_metrics(a, b).interval, m)

    return trial


def sequential(rule: dj.UntilWidth | dj.AcceptReject, p: float, most: int = 20_000) -> Trial:
    """The interval printed at a data-driven stop."""

    def trial(seed: int) -> bool:
        failed = np.random.default_rng(seed).random(most) < p
        total = np.cumsum(failed)
        for look, draws in enumerate(looks(most), 1):
            if rule.verdict(int(total[draws - 1]), draws, look):
                break
        return within(DataDriven(look).interval(failed[:draws]), p)

    return trial


def verdict(p: float, right: str) -> Trial:
    """The verdict of the sequential test at one of its two probabilities."""
    rule = dj.AcceptReject(0.02, 0.05)

    def trial(seed: int) -> bool:
        total = np.cumsum(np.random.default_rng(seed).random(50_000) < p)
        for look, draws in enumerate(looks(50_000), 1):
            found = rule.verdict(int(total[draws - 1]), draws, look)
            if found:
                return found == right
        return True  # undecided is not wrong

    return trial


def indices(function: Callable[[np.ndarray], np.ndarray], truth: np.ndarray, noisy: bool = False) -> Trial:
    """Sobol indices, first orders then totals; with ``noisy`` the last factor is random, as in-loop noise is."""

    def trial(seed: int) -> np.ndarray:
        a, b = saltelli(1024, truth.shape[1], (seed,))
        if noisy:
            a[:, -1], b[:, -1] = np.random.default_rng(seed).random((2, 1024))
        mixed = np.stack([np.where(np.arange(truth.shape[1]) == i, b, a) for i in range(truth.shape[1])])
        found = np.stack(sobol_indices(function(a), function(b), function(mixed), (seed,)))
        return (found[..., 1] <= truth) & (truth <= found[..., 2])

    return trial


def ishigami(points: np.ndarray) -> np.ndarray:
    x, y, z = np.moveaxis(np.pi * (2.0 * points - 1.0), -1, 0)
    return np.sin(x) + 7.0 * np.sin(y) ** 2 + 0.1 * z**4 * np.sin(x)


def corner(points: np.ndarray) -> np.ndarray:
    """A failure of probability 0.1: x > 0.8 and y > 0.5, whatever z."""
    return ((points[..., 0] > 0.8) & (points[..., 1] > 0.5)).astype(float)


def noise(points: np.ndarray) -> np.ndarray:
    """Two factors and noise, added up."""
    return stats.norm.ppf(points) @ np.array([2.0, 1.0, 2.0])


ISHIGAMI = np.array([[0.313905, 0.442411, 0.0], [0.557589, 0.442411, 0.243684]])
CORNER = np.array([[4.0, 1.0, 0.0], [8.0, 5.0, 0.0]]) / 9.0
NOISE = np.array([[4.0, 1.0, 4.0], [4.0, 1.0, 4.0]]) / 9.0


def four_branch(seed: int) -> bool:
    """The interval over repeats of the splitting estimator."""

    def margin(z: np.ndarray, _: np.ndarray) -> np.ndarray:
        x, y = z.T / np.sqrt(2.0)
        bow = 3.0 + 0.2 * (x - y) ** 2
        side = 7.0 / np.sqrt(2.0)
        skew = np.sqrt(2.0) * (x - y)
        return np.min([bow - x - y, bow + x + y, side + skew, side - skew], axis=0)

    return within(split(margin, 2, (seed,)).interval(), 2.222795066e-3)


CASES: dict[str, tuple[str, Trial]] = {
    "Clopper-Pearson, p = 0.003, n = 500": ("failure probability", independent(0.003, 500)),
    "Clopper-Pearson, p = 0.1, n = 200": ("failure probability", independent(0.1, 200)),
    "Sobol replicates, p = 0.1, n = 1024": ("failure probability", sobol(0.1, 1024)),
    "Sobol replicates, p = 0.004, n = 1024": ("failure probability", sobol(0.004, 1024)),
    "Latin-hypercube replicates, p = 0.1, n = 1000": ("failure probability", latin(0.1, 1000)),
    "Latin-hypercube replicates, p = 0.004, n = 1000": ("failure probability", latin(0.004, 1000)),
    "median, lognormal, n = 100": ("quantile", quantile(0.5, 100)),
    "95 % quantile, lognormal, n = 200": ("quantile", quantile(0.95, 200)),
    "0.06 against 0.04, n = 500": ("paired difference", paired(0.06, 0.04, 500)),
    "0.01 against 0.01, n = 1000": ("paired difference", paired(0.01, 0.01, 1000)),
    "median of a metric's difference, n = 100": ("paired difference", paired_metric(100)),
    "until width 0.02, p = 0.01": ("sequential stop", sequential(dj.UntilWidth(0.02), 0.01)),
    "until width 0.05, p = 0.2": ("sequential stop", sequential(dj.UntilWidth(0.05), 0.2)),
    "interval after accept/reject, p = 0.03": ("sequential stop", sequential(dj.AcceptReject(0.02, 0.05), 0.03)),
    "verdict of accept 0.02, reject 0.05 at p = 0.02": ("sequential stop", verdict(0.02, "accepted")),
    "verdict of accept 0.02, reject 0.05 at p = 0.05": ("sequential stop", verdict(0.05, "rejected")),
    "Ishigami, 1024 rows, the least of six": ("Sobol index", indices(ishigami, ISHIGAMI)),
    "indicator of a corner, 1024 rows, the least of six": ("Sobol index", indices(corner, CORNER + 0.0)),
    "two factors and in-loop noise, 1024 rows, the least of six": ("Sobol index", indices(noise, NOISE, noisy=True)),
    "four branches, p = 0.0022": ("rare event", four_branch),
}


def main() -> int:
    rows = ["| statement | problem | covered |", "|---|---|---|"]
    lowest = 1.0
    for (name, (kind, trial)), first in zip(CASES.items(), count(0, REPETITIONS), strict=False):
        covered = np.mean([trial(first + i) for i in range(REPETITIONS)], axis=0)
        least = float(np.min(covered))
        lowest = min(lowest, least)
        rows.append(f"| {kind} | {name} | {100 * least:.1f} % |")
        print(rows[-1], flush=True)
    put("coverage", "\n".join(rows))
    return 0 if lowest >= NOMINAL - ALLOWED else 1


if __name__ == "__main__":
    sys.exit(main())
