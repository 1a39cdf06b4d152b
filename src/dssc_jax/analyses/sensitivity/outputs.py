"""A design of simulations for a sensitivity analysis, and a check that an output's samples suffice.

In-loop noise is one more factor: rows with different draw indices differ in it. So the noise has a part of the variance
to itself, and its effect is not charged to the uncertain numbers.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study

NOISE = "in-loop noise"  # name of the factor
FAILURE = "failure"  # name of the output
REPLICATES = 8  # independent randomisations of a design, whose scatter gives the intervals
SMALLEST = 256  # least number of rows
FEWEST_ROWS = 20  # rows that must carry an output's variance; with fewer an interval of 95 % is of length 0.6 or more
PLANNED_ROWS = 30  # carrying rows that a refusal plans for, so that the next run is not refused by chance


class RowSample(NamedTuple):
    """Points to simulate, a point for each row of a design.

    Args:
        levels: Quantile levels of the laws, correlations included, shape (rows, laws).
        indices: Draw indices, which decide the in-loop noise, shape (rows,).
    """

    levels: np.ndarray
    indices: np.ndarray


class RowDesign(NamedTuple):
    """The simulations of a method of sensitivity analysis, and what it computes from them.

    Args:
        rows: Number of rows of each sample.
        samples: The samples to simulate.
        refusal: (values of an output, shape (samples, rows)) -> why no quantities are computed for this output; None if
            they are.
        quantities: (values of an output, shape (samples, rows)) -> the quantities of the method, shape (factors, 3)
            each; the columns are estimate, lower and upper end.
    """

    rows: int
    samples: list[RowSample]
    refusal: Callable[[np.ndarray], str | None]
    quantities: Callable[[np.ndarray], tuple[np.ndarray, ...]]


def effective_row_count(f_a: np.ndarray, f_b: np.ndarray) -> float:
    """The effective number of rows that carry the variance of an output, from the output's kurtosis.

    A small number tells that a few extreme rows decide the variance. For an indicator with the mean p, such as failure,
    the number is n p (1 - p)/(1 - 3 p (1 - p)) of n rows, about the number of rows in the rarer class.

    Args:
        f_a: A varying output at the rows of sample A, shape (rows,).
        f_b: The same output at sample B, shape (rows,).
    """
    deviations = np.stack([f_a, f_b]) - 0.5 * (f_a.mean() + f_b.mean())
    squares = np.square(deviations / np.abs(deviations).max())
    return float(len(f_a) * squares.mean() ** 2 / np.mean(squares**2))


def refusal_reason(f_a: np.ndarray, f_b: np.ndarray) -> str | None:
    """Say in words why the samples of an output do not suffice for indices; None if they suffice.

    Args:
        f_a: Output at the rows of sample A, shape (rows,).
        f_b: Output at sample B, shape (rows,).
    """
    if np.ptp([f_a, f_b]) == 0.0:
        return "does not vary"
    rows = len(f_a)
    effective_rows = effective_row_count(f_a, f_b)
    if effective_rows < FEWEST_ROWS:
        sufficient_rows = 2 ** math.ceil(math.log2(rows * PLANNED_ROWS / effective_rows))
        carriers = f"about {effective_rows:.2g} of {rows:,} rows carry its variance, {FEWEST_ROWS} have to"
        return f"needs {sufficient_rows:,} rows: {carriers}"
    return None


def output_values(results: Arrays, name: str) -> np.ndarray:
    """The values of an output, shape (n,): those of a metric, or for ``failure`` 1 if a draw failed and 0 if not.

    Args:
        results: Results of the simulations by name, shape (n,) each.
        name: Name of the metric, or ``failure``.
    """
    if name == FAILURE:
        return (results["outcome"] != Outcome.OK).astype(float)
    return results[name].astype(float)


def row_count(study: Study) -> int:
    """The number of rows of a design: the study's number of draws, rounded down to a power of two.

    Raises:
        ConfigError: There are too few draws.
    """
    rows = 2 ** int(math.log2(study.config.draws))
    if rows < SMALLEST:
        raise ConfigError(study.source, f"sensitivity needs draws >= {SMALLEST}, got {study.config.draws}")
    return rows


def require_uncorrelated(study: Study, claim: str) -> None:
    """Refuse a study whose uncertain numbers are correlated.

    Args:
        study: The study.
        claim: Beginning of the error message, which continues with "independent inputs, but ...".

    Raises:
        ConfigError: Some numbers are correlated.
    """
    if study.correlated:
        raise ConfigError(
            study.source,
            f"{claim} independent inputs, but {', '.join(study.correlated)} are correlated: use the method "
            "'shapley', leave them fixed, or make them independent: correlation = {}",
        )
