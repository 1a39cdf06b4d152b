"""Which uncertain numbers matter: first-order and total Sobol indices of every metric and of failure.

Two independent samples A and B of the unit cube, and for each factor i a third, AB_i: A with the column of i from B
(Saltelli). The indices follow from the pairs (B, AB_i), which share i only, and (A, AB_i), which share all but i.
In-loop noise is one more factor: A's rows carry their own draw indices and B's rows others, so that the indices of the
numbers are not charged with it, and it gets indices of its own.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.engine import BLOCK, Arrays, Engine, evaluate, is_noisy
from dssc_jax.errors import ConfigError
from dssc_jax.numerics import stream
from dssc_jax.sampling import inside, sobol_points, values_at
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.study import Study
from dssc_jax.types import Outcome, Progress

NOISE = "in-loop noise"
FAILURE = "failure"
SMALLEST = 256  # rows of A that a bootstrap can work with
RESAMPLES = 999
AT_ONCE = 2**24  # weights of resampled rows in memory


class Indices(NamedTuple):
    """Indices of one output; estimate, lower and upper end, shape (factors, 3). Not clipped: below 0 means about 0."""

    first: np.ndarray
    total: np.ndarray


@dataclass(frozen=True)
class Sensitivity:
    """Sobol indices of a study.

    Args:
        study: The study.
        rows: Rows of A.
        simulations: Simulations in all.
        factors: Names of the uncertain numbers, then the in-loop noise if there is any.
        outputs: Indices of each metric, and of ``failure``; None where an output has no variance, or no value on
            every draw.
        missing: For each output how many simulations have no value of it.
        confidence: Of the intervals.
    """

    study: Study
    rows: int
    simulations: int
    factors: tuple[str, ...]
    outputs: dict[str, Indices | None]
    missing: dict[str, int]
    confidence: float

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        outputs: dict[str, Any] = {}
        for name, found in self.outputs.items():
            outputs[name] = None
            if found is not None:
                outputs[name] = {
                    factor: {
                        "first": first[0],
                        "first_interval": list(first[1:]),
                        "total": total[0],
                        "total_interval": list(total[1:]),
                    }
                    for factor, first, total in zip(
                        self.factors, found.first.tolist(), found.total.tolist(), strict=True
                    )
                }
        return {
            "study": self.study.name,
            "rows": self.rows,
            "simulations": self.simulations,
            "confidence": self.confidence,
            "interval_method": f"Bayesian bootstrap, {RESAMPLES} resamples",
            "factors": list(self.factors),
            "missing": self.missing,
            "outputs": outputs,
        }


def saltelli(rows: int, factors: int, words: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """A and B, shape (rows, factors) each: the halves of a scrambled Sobol sequence's coordinates."""
    points = sobol_points(2 * factors, 0, rows, words)
    return points[:, :factors], points[:, factors:]


def sobol_indices(
    f_a: np.ndarray, f_b: np.ndarray, f_ab: np.ndarray, words: tuple[int, ...], confidence: float = CONFIDENCE
) -> Indices:
    """First-order and total indices with bootstrap intervals over rows.

    With outputs centred, S_i = E[f_B f_ABi]/V and S_Ti = E[(f_A - f_ABi)^2]/(2 V), V the variance over A and B. Terms
    of mean 0 are taken off by least squares, see :func:`controlled`.

    Args:
        f_a: Output at A, shape (rows,).
        f_b: Output at B, shape (rows,).
        f_ab: Output at AB_i, shape (factors, rows).
        words: Seeds of the bootstrap.
        confidence: Of the intervals.

    Reference:
        M. J. W. Jansen, Computer Physics Communications 117 (1999) 35-43; A. Saltelli et al., Computer Physics
        Communications 181 (2010) 259-270; D. B. Rubin, Annals of Statistics 9 (1981) 130-134, the bootstrap.
    """
    middle = 0.5 * (f_a.mean() + f_b.mean())
    f_a, f_b, f_ab = f_a - middle, f_b - middle, f_ab - middle
    variance = 0.5 * (f_a**2 + f_b**2)
    rng = np.random.default_rng(words)
    halved = rng.permutation(len(f_a)) < len(f_a) // 2
    first = [controlled(f_b * mixed, variance, f_a, f_b, mixed, halved) for mixed in f_ab]
    total = [controlled(0.5 * (f_a - mixed) ** 2, variance, f_a, f_b, mixed, halved) for mixed in f_ab]
    shares = np.stack([variance, *first, *total], axis=1)  # a row's share of every mean that the indices are made of
    means = np.concatenate([shares.mean(0, keepdims=True), resampled(shares, rng)])
    indices = means[:, 1:] / means[:, :1]
    tail = 0.5 * (1.0 - confidence)
    ends = np.quantile(indices[1:], [tail, 1.0 - tail], axis=0)
    # a bootstrap of so many rows cannot tell what no row has shown: never closer than 1/rows
    reach = np.hypot(ends - indices[0], 1.0 / len(f_a))
    table = np.stack([indices[0], indices[0] - reach[0], indices[0] + reach[1]], axis=-1)
    return Indices(table[: len(f_ab)], table[len(f_ab) :])


def controlled(
    share: np.ndarray, variance: np.ndarray, f_a: np.ndarray, f_b: np.ndarray, f_ab: np.ndarray, halved: np.ndarray
) -> np.ndarray:
    """A numerator's rows less that combination of control variates which leaves the least variance to its index.

    The controls f_A f_B, (f_AB^2 - f_A^2)/2 and (f_A^2 - f_B^2)/2 have mean 0. The first alone makes of f_B f_AB
    Saltelli's estimator of a first-order index, the second alone Jansen's; neither is the better one for every index.
    They compete with fitted coefficients, those of a random half of the rows from the other half, so that the scatter
    that the bootstrap sees is not fitted away. (Even and odd rows would not do: Sobol points alternate between halves
    of an axis.)
    """
    controls = np.stack([f_a * f_b, 0.5 * (f_ab**2 - f_a**2), 0.5 * (f_a**2 - f_b**2)], axis=1)
    known = variance * (share.mean() / variance.mean())
    fitted = share.copy()
    for mine, others in ((halved, ~halved), (~halved, halved)):
        fitted[mine] -= controls[mine] @ np.linalg.lstsq(controls[others], (share - known)[others], rcond=None)[0]
    return min((fitted, share - controls[:, 0], share - controls[:, 1], share), key=lambda rows: np.var(rows - known))


def resampled(shares: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Means over rows with random weights, shape (resamples, columns): the Bayesian bootstrap."""
    rows = len(shares)
    batch = max(1, AT_ONCE // rows)
    found = []
    for done in range(0, RESAMPLES, batch):
        weights = rng.standard_exponential((min(batch, RESAMPLES - done), rows))
        found.append(weights @ shares / weights.sum(-1, keepdims=True))
    return np.concatenate(found)


def sensitivity(study: Study, confidence: float = CONFIDENCE, progress: Progress | None = None) -> Sensitivity:
    """Sobol indices of every metric and of failure, at the study's own values.

    Args:
        study: The study; its number of draws, rounded down to a power of two, is that of A's rows. A sweep is left
            aside.
        confidence: Of the intervals.
        progress: Told of the simulations done and of all.

    Raises:
        ConfigError: inputs are correlated, nothing is uncertain, or the draws are too few.
    """
    study = study.without_sweep()
    require_independent(study)
    rows = 2 ** int(math.log2(study.config.draws))
    if rows < SMALLEST:
        raise ConfigError(study.source, f"sensitivity needs draws >= {SMALLEST}, got {study.config.draws}")
    engine = Engine(study, min(BLOCK, rows))
    names = list(study.laws)
    noisy = is_noisy(engine)
    seed = study.config.seed
    a, b = saltelli(rows, len(names), (seed, stream("saltelli")))
    own, others = np.arange(rows), np.arange(rows, 2 * rows)
    samples = [(a, own), (b, others)]
    for column in range(len(names)):
        mixed = a.copy()
        mixed[:, column] = b[:, column]
        samples.append((mixed, own))
    if noisy:
        samples.append((a, others))
    found: list[Arrays] = []
    for points, indices in samples:
        found.append(evaluate(engine, values_at(study, inside(points)), indices))
        if progress:
            progress(len(found) * rows, len(samples) * rows)
    outputs, missing = {}, {}
    for name in [measure.name for measure in study.measures] + [FAILURE]:
        columns = np.stack([output(results, name) for results in found])
        missing[name] = int(np.count_nonzero(~np.isfinite(columns)))
        usable = missing[name] == 0 and np.ptp(columns[:2]) > 0.0
        words = (seed, stream("bootstrap"))
        outputs[name] = sobol_indices(columns[0], columns[1], columns[2:], words, confidence) if usable else None
    factors = (*names, NOISE) if noisy else tuple(names)
    return Sensitivity(study, rows, len(samples) * rows, factors, outputs, missing, confidence)


def output(results: Arrays, name: str) -> np.ndarray:
    """A metric, or 1 where the draw failed."""
    if name == FAILURE:
        return (results["outcome"] != Outcome.OK).astype(float)
    return results[name].astype(float)


def require_independent(study: Study) -> None:
    """Require uncertain numbers, all independent.

    Raises:
        ConfigError: otherwise.
    """
    if not study.laws:
        raise ConfigError(study.source, "nothing is uncertain; give at least one number a law")
    if study.correlated:
        raise ConfigError(
            study.source,
            f"Sobol indices divide up the variance of independent inputs, but {', '.join(study.correlated)} are "
            "correlated: leave them fixed, or make them independent with --set correlation={}",
        )
