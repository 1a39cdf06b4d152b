"""First-order and total Sobol indices of every metric and of failure: which uncertain numbers matter.

The method (Saltelli) uses two independent samples A and B of the unit cube, and for each factor i a third, AB_i: A
with the column of i from B. The indices follow from the pairs (B, AB_i), which share only i, and (A, AB_i), which share
all but i. In-loop noise is one more factor: A's rows have their own draw indices and B's rows others. So the noise has
its own indices and does not affect those of the numbers.

The rows are independent replicates of a scrambled Sobol sequence. The intervals are Student's t over the replicates.
An output whose variance comes from only a few rows, as that of a rare failure does, is refused: no interval would hold.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from dssc_jax import plotting
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import stream
from dssc_jax.core.signals import Outcome, ProgressCallback
from dssc_jax.engine.batching import BLOCK, Arrays, Engine, evaluate, is_noisy
from dssc_jax.engine.sampling import inside, sobol_points, values_at
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import Stored
from dssc_jax.results.result import headline_measure
from dssc_jax.statistics import CONFIDENCE, replicate_interval, unseen
from dssc_jax.study import Study

NOISE = "in-loop noise"
FAILURE = "failure"
ENDS = {"": "", "_low": ", lower end of its interval", "_high": ", upper end of its interval"}
"""Suffixes of an index and of the ends of its interval in the dataset."""
SMALLEST = 256  # rows of A
REPLICATES = 8
LEAST = 20  # rows that must carry an output's variance; with fewer an interval of 95 % is of length 0.6 or more
WANTED = 30  # what a refusal plans for, so that the next run is not refused by chance
JOINT = 10  # rows that must carry two independent outputs' variances at once, for control variates: products
SINGULAR = 1e-10  # relative size of what is 0 in a matrix of control variates


class Indices(NamedTuple):
    """Indices of one output; estimate, lower and upper end, shape (factors, 3). Not clipped: below 0 means about 0."""

    first: np.ndarray
    total: np.ndarray


@dataclass(eq=False)
class Sensitivity(Analysis):
    """Sobol indices of a study.

    The dataset has along ``output`` (every metric, and ``failure``) and ``factor`` (the uncertain numbers, then the
    in-loop noise if there is any): ``first`` and ``total`` with the ends of their intervals, NaN if an output has no
    indices. Along ``output`` it has ``missing``, the number of simulations without a value.

    Args:
        rows: Number of rows of A.
        simulations: Total number of simulations.
        reasons: The reason for each output without indices.
        confidence: Confidence of the intervals.
    """

    kind = "sensitivity"
    title = "Sobol indices"
    table = ("output", "factor")

    rows: int
    simulations: int
    reasons: dict[str, str]
    confidence: float

    @property
    def factors(self) -> tuple[str, ...]:
        """Names of the factors."""
        return tuple(map(str, self.dataset["factor"].values))

    @property
    def outputs(self) -> dict[str, Indices | None]:
        """Indices of each output; None if there are none."""
        names = map(str, self.dataset["output"].values)
        return {name: None if name in self.reasons else self._indices(name) for name in names}

    def _indices(self, name: str) -> Indices:
        own = self.dataset.sel(output=name)
        return Indices(*(np.stack([own[part + end].values for end in ENDS], axis=-1) for part in Indices._fields))

    @property
    def headline(self) -> str:
        """The answer in one line."""
        name = next((one for one in shown_outputs(self.study) if one not in self.reasons), None)
        if name is None:
            return f"no indices of {FAILURE}; it {self.reasons[FAILURE]}"
        total = self.dataset["total"].sel(output=name)
        first = int(np.argmax(total.values))
        return f"{name} depends most on {self.factors[first]}: total index {float(total[first]):.3f}"

    def figure(self) -> Figure:
        """Plot the answer."""
        return plotting.sensitivity(self)

    def content(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        outputs: dict[str, Any] = {}
        for name, indices in self.outputs.items():
            outputs[name] = indices and {
                factor: {
                    "first": first[0],
                    "first_interval": first[1:],
                    "total": total[0],
                    "total_interval": total[1:],
                }
                for factor, first, total in zip(self.factors, *indices, strict=True)
            }
        return {
            "rows": self.rows,
            "simulations": self.simulations,
            "confidence": self.confidence,
            "interval_method": f"Student's t over {REPLICATES} Sobol replicates",
            "factors": self.factors,
            "headline": shown_outputs(self.study),
            "reasons": self.reasons,
            "missing": dict(zip(self.outputs, self.dataset["missing"].values.tolist(), strict=True)),
            "outputs": outputs,
        }

    def settings(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        return {name: getattr(self, name) for name in ("rows", "simulations", "reasons", "confidence")}

    @classmethod
    def restored(cls, stored: Stored) -> Self:
        """See :class:`Analysis`."""
        return cls(stored.study, stored.dataset, **stored.settings)


def indices_dataset(
    study: Study, factors: Sequence[str], outputs: Mapping[str, Indices | None], missing: Mapping[str, int]
) -> xr.Dataset:
    """Store indices in a dataset: see :class:`Sensitivity`."""
    blank = np.full((len(factors), len(ENDS)), np.nan)
    columns = {}
    for place, (part, meaning) in enumerate({"first": "first-order index", "total": "total index"}.items()):
        values = np.stack([indices[place] if indices else blank for indices in outputs.values()])
        for end, (suffix, side) in enumerate(ENDS.items()):
            about = {"units": "1", "long_name": meaning + side}
            columns[part + suffix] = (("output", "factor"), values[..., end], about)
    about = {"units": "1", "long_name": "simulations without a value"}
    columns["missing"] = (("output",), np.array(list(missing.values())), about)
    names = {"output": (list(outputs), "metric, or failure"), "factor": (list(factors), "uncertain number, or noise")}
    coords = {name: (name, np.array(values), {"long_name": text}) for name, (values, text) in names.items()}
    return xr.Dataset(columns, coords=coords, attrs={"title": study.name})


def shown_outputs(study: Study) -> list[str]:
    """The main outputs: failure, and the study's headline metric."""
    return list(dict.fromkeys((FAILURE, headline_measure(study).name)))


def saltelli(rows: int, factors: int, words: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The samples A and B, shape (rows, factors) each: the halves of a scrambled Sobol sequence's coordinates.

    Row i belongs to replicate i mod R. Each replicate is scrambled independently.
    """
    nets = [sobol_points(2 * factors, 0, rows // REPLICATES, (*words, r)) for r in range(REPLICATES)]
    points = np.stack(nets, axis=1).reshape(rows, 2 * factors)
    return points[:, :factors], points[:, factors:]


def carrying(f_a: np.ndarray, f_b: np.ndarray) -> float:
    """The effective number of rows that carry the variance of a varying output, from its kurtosis.

    For an indicator it is about the number of rows in the rarer class: n p (1-p)/(1 - 3 p (1-p)).

    Args:
        f_a: Output at A, shape (rows,).
        f_b: Output at B, shape (rows,).
    """
    deviations = np.stack([f_a, f_b]) - 0.5 * (f_a.mean() + f_b.mean())
    squares = np.square(deviations / np.abs(deviations).max())
    return float(len(f_a) * squares.mean() ** 2 / np.mean(squares**2))


def refusal(f_a: np.ndarray, f_b: np.ndarray) -> str | None:
    """The reason why an output gets no indices, in words; None if it gets them.

    Args:
        f_a: Output at A, shape (rows,).
        f_b: Output at B, shape (rows,).
    """
    if np.ptp([f_a, f_b]) == 0.0:
        return "does not vary"
    rows, carried = len(f_a), carrying(f_a, f_b)
    if carried < LEAST:
        enough = 2 ** math.ceil(math.log2(rows * WANTED / carried))
        return f"needs {enough:,} rows: about {carried:.2g} of {rows:,} rows carry its variance, {LEAST} have to"
    return None


def sobol_indices(f_a: np.ndarray, f_b: np.ndarray, f_ab: np.ndarray, confidence: float = CONFIDENCE) -> Indices:
    """First-order and total indices with their intervals.

    With centred outputs, S_i = E[f_B f_ABi]/V and S_Ti = E[(f_A - f_ABi)^2]/(2 V), with V the variance over A and B.
    The ratio is linearised. The half length of the interval adds two parts as squares: Student's t interval over the
    replicates, and what this number of carrying rows may have missed. (If a factor changes no row the former is 0.)

    Args:
        f_a: Output at A, shape (rows,); row i belongs to replicate i mod R, see :func:`saltelli`.
        f_b: Output at B, shape (rows,).
        f_ab: Output at AB_i, shape (factors, rows).
        confidence: Confidence of the intervals.

    Reference:
        M. J. W. Jansen, Computer Physics Communications 117 (1999) 35-43; A. Saltelli et al., Computer Physics
        Communications 181 (2010) 259-270; A. B. Owen, Monte Carlo theory, methods and examples, section 17.2, on
        replicates.
    """
    carried = carrying(f_a, f_b)
    middle = 0.5 * (f_a.mean() + f_b.mean())
    f_a, f_b, f_ab = f_a - middle, f_b - middle, f_ab - middle
    variance = 0.5 * (f_a**2 + f_b**2)
    shares = np.concatenate([f_b * f_ab, 0.5 * (f_a - f_ab) ** 2])  # a row's share of each numerator
    if carried**2 / len(f_a) >= JOINT:
        pairs = zip(shares, [*f_ab, *f_ab], strict=True)
        shares = np.stack([controlled(share, variance, f_a, f_b, mixed) for share, mixed in pairs])
    indices = shares.mean(1, keepdims=True) / variance.mean()
    low, high = replicate_interval((shares - indices * variance) / variance.mean(), REPLICATES, confidence).T
    half = np.hypot(0.5 * (high - low), unseen(carried, confidence))[:, None]
    table = np.concatenate([indices, indices - half, indices + half], axis=1)
    return Indices(table[: len(f_ab)], table[len(f_ab) :])


def controlled(
    share: np.ndarray, variance: np.ndarray, f_a: np.ndarray, f_b: np.ndarray, f_ab: np.ndarray
) -> np.ndarray:
    """Subtract from a numerator's rows the combination of control variates that minimises the variance of its index.

    The controls f_A f_B, (f_AB^2 - f_A^2)/2 and (f_A^2 - f_B^2)/2 have mean 0. The first alone turns f_B f_AB into
    Saltelli's estimator of a first-order index, the second alone into Jansen's; neither is better for every index.
    Coefficients are fitted by least squares. Those of a replicate come from all other replicates, so the index stays
    unbiased and the scatter between replicates is not fitted away.
    """
    controls = np.stack([f_a * f_b, 0.5 * (f_ab**2 - f_a**2), 0.5 * (f_a**2 - f_b**2)], axis=1)
    target = share - variance * (share.mean() / variance.mean())
    of = controls.reshape(-1, REPLICATES, 3)
    squares = np.einsum("nri,nrj->rij", of, of)
    products = np.einsum("nri,nr->ri", of, target.reshape(-1, REPLICATES))
    inverse = np.linalg.pinv(squares.sum(0) - squares, rcond=SINGULAR, hermitian=True)
    coefficients = np.einsum("rij,rj->ri", inverse, products.sum(0) - products)
    return share - np.einsum("nri,ri->nr", of, coefficients).reshape(-1)


def sensitivity(study: Study, confidence: float = CONFIDENCE, progress: ProgressCallback | None = None) -> Sensitivity:
    """Compute Sobol indices of every metric and of failure, at the study's own values.

    Args:
        study: The study; its number of draws, rounded down to a power of two, is the number of A's rows. Its sweep is
            ignored.
        confidence: Confidence of the intervals.
        progress: Called with the simulations done and their total.

    Raises:
        ConfigError: inputs are correlated, nothing is uncertain, or there are too few draws.
    """
    study = study.without_sweep()
    require_independent_inputs(study)
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
    results: list[Arrays] = []
    for points, indices in samples:
        results.append(evaluate(engine, values_at(study, inside(points)), indices))
        if progress:
            progress(len(results) * rows, len(samples) * rows)
    outputs: dict[str, Indices | None] = {}
    reasons, missing = {}, {}
    for name in [measure.name for measure in study.measures] + [FAILURE]:
        columns = np.stack([output_of(each, name) for each in results])
        missing[name] = int(np.count_nonzero(~np.isfinite(columns)))
        lacking = f"has no value on {missing[name]:,} simulations" if missing[name] else None
        reason = lacking or refusal(columns[0], columns[1])
        outputs[name] = None if reason else sobol_indices(columns[0], columns[1], columns[2:], confidence)
        if reason:
            reasons[name] = reason
    factors = (*names, NOISE) if noisy else tuple(names)
    dataset = indices_dataset(study, factors, outputs, missing)
    return Sensitivity(study, dataset, rows, len(samples) * rows, reasons, confidence)


def output_of(results: Arrays, name: str) -> np.ndarray:
    """The values of a metric, or 1 if the draw failed."""
    if name == FAILURE:
        return (results["outcome"] != Outcome.OK).astype(float)
    return results[name].astype(float)


def require_independent_inputs(study: Study) -> None:
    """Require uncertain numbers that are all independent.

    Raises:
        ConfigError: there are none, or they are correlated.
    """
    if not study.laws:
        raise ConfigError(study.source, "nothing is uncertain; give at least one number a law")
    if study.correlated:
        raise ConfigError(
            study.source,
            f"Sobol indices divide up the variance of independent inputs, but {', '.join(study.correlated)} are "
            "correlated: leave them fixed, or make them independent with --set correlation={}",
        )
