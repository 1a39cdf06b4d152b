"""First-order and total Sobol indices of every metric and of failure.

The method (Saltelli) uses two independent samples A and B of the unit cube, and for each factor i a third, AB_i: A
with the column of i from B. The indices follow from the pairs (B, AB_i), which share only i, and (A, AB_i), which share
all but i. In-loop noise is one more factor: A's rows have their own draw indices and B's rows others.

The rows are independent replicates of a scrambled Sobol sequence. The intervals are Student's t over the replicates.
An output whose variance comes from only a few rows, such as a rare failure, is refused: no interval would hold.
"""

from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.sensitivity.chaos import Chaos, ChaosPrediction
from dssc_jax.analyses.sensitivity.outputs import (
    REPLICATES,
    RowDesign,
    RowSample,
    effective_row_count,
    refusal_reason,
    require_uncorrelated,
    row_count,
)
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import inside_cube, sobol_points
from dssc_jax.statistics import CONFIDENCE, replicate_interval, unseen
from dssc_jax.study import Study

JOINT = 10  # rows that must carry the variances of two independent outputs at once, for products as control variates
SINGULAR = 1e-10  # relative size of a singular value that counts as 0 in the equations of control variates


class SobolIndices(NamedTuple):
    """Sobol indices of an output, each with estimate, lower and upper end; an index of about 0 may be negative.

    Args:
        first: First-order indices, shape (factors, 3).
        total: Total indices, shape (factors, 3).
    """

    first: np.ndarray
    total: np.ndarray


def saltelli_samples(rows: int, factors: int, seeds: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The samples A and B, shape (rows, factors) each: two independent points of the unit cube for each row.

    A and B are the two halves of the coordinates of a scrambled Sobol sequence. Row i belongs to replicate i mod R, and
    each of the R replicates is scrambled independently.

    Args:
        rows: Number of rows, a multiple of R.
        factors: Number of coordinates of A and of B.
        seeds: Seeds of the scrambling; the index of the replicate is appended as a further seed.
    """
    nets = [sobol_points(2 * factors, 0, rows // REPLICATES, (*seeds, r)) for r in range(REPLICATES)]
    points = np.stack(nets, axis=1).reshape(rows, 2 * factors)
    return points[:, :factors], points[:, factors:]


def sobol_indices(
    f_a: np.ndarray,
    f_b: np.ndarray,
    f_ab: np.ndarray,
    confidence: float = CONFIDENCE,
    chaos: Chaos | None = None,
) -> SobolIndices:
    """First-order index S_i and total index S_Ti of an output for each factor i, with their intervals.

    S_i is the share of the variance that the factor explains alone, S_Ti its share with all interactions. With centred
    outputs f, S_i = E[f_B f_ABi]/V and S_Ti = E[(f_A - f_ABi)^2]/(2 V), where V is the variance over A and B.

    The interval of such a ratio is linearised. Its half length is the root of the sum of two squares: the half length
    of Student's t interval over the replicates, which is 0 if a factor changes no row, and an allowance for rare rows
    that a sample of this size may have missed.

    Args:
        f_a: Output at A, shape (rows,); row i belongs to replicate i mod R, see :func:`saltelli_samples`.
        f_b: Output at B, shape (rows,).
        f_ab: Output at AB_i, shape (factors, rows).
        confidence: Confidence of the intervals.
        chaos: Predicts the output from the points of the rows; None: there is no prediction.

    Reference:
        M. J. W. Jansen, Computer Physics Communications 117 (1999) 35-43; A. Saltelli et al., Computer Physics
        Communications 181 (2010) 259-270; A. B. Owen, Monte Carlo theory, methods and examples, section 17.2, on
        replicates.
    """
    effective_rows = effective_row_count(f_a, f_b)
    middle = 0.5 * (f_a.mean() + f_b.mean())
    f_a = f_a - middle
    f_b = f_b - middle
    f_ab = f_ab - middle
    variance_terms = 0.5 * (f_a**2 + f_b**2)  # their mean over the rows is V
    numerators = np.concatenate([f_b * f_ab, 0.5 * (f_a - f_ab) ** 2])  # of all S_i, then of all S_Ti, for each row
    predicted = None if chaos is None else chaos.predict(np.stack([f_a, f_b, *f_ab]))
    if predicted is not None:
        numerators, variance_terms = correct_terms(numerators, variance_terms, predicted)
    if effective_rows**2 / len(f_a) >= JOINT:
        for place, numerator in enumerate(numerators):  # both indices of a factor belong to the same AB_i
            controls = control_variates(f_a, f_b, f_ab[place % len(f_ab)])
            numerators[place] = subtract_controls(numerator, variance_terms, controls)
    indices = numerators.mean(1, keepdims=True) / variance_terms.mean()
    deviations = (numerators - indices * variance_terms) / variance_terms.mean()
    low, high = replicate_interval(deviations, REPLICATES, confidence).T
    half = np.hypot(0.5 * (high - low), unseen(effective_rows, confidence))[:, None]
    table = np.concatenate([indices, indices - half, indices + half], axis=1)
    return SobolIndices(first=table[: len(f_ab)], total=table[len(f_ab) :])


def correct_terms(
    numerators: np.ndarray, variance_terms: np.ndarray, predicted: ChaosPrediction
) -> tuple[np.ndarray, np.ndarray]:
    """Correct the terms of numerators and variance by a prediction, which lowers their scatter.

    From each term, the term of the prediction g is subtracted, and its exact mean is added.

    Args:
        numerators: Each row's term of the numerators of all first-order, then all total indices,
            shape (2 factors, rows).
        variance_terms: Each row's term of the variance, shape (rows,).
        predicted: The prediction g of the output.

    Returns:
        The corrected terms of numerators and variance, of the same shapes.
    """
    g_a, g_b = predicted.values[:2]
    g_ab = predicted.values[2:]
    replicate = np.arange(len(variance_terms)) % REPLICATES
    noise_factors = len(g_ab) - predicted.alone.shape[1]  # 1 or 0: the prediction does not depend on in-loop noise
    zeros = np.zeros((REPLICATES, noise_factors))
    exact_means = np.concatenate([predicted.alone, zeros, predicted.total, zeros], axis=1)
    predicted_numerators = np.concatenate([g_b * g_ab, 0.5 * (g_a - g_ab) ** 2])
    predicted_terms = 0.5 * (g_a**2 + g_b**2)
    corrected_numerators = numerators - (predicted_numerators - exact_means[replicate].T)
    return corrected_numerators, variance_terms - (predicted_terms - predicted.variance[replicate])


def control_variates(f_a: np.ndarray, f_b: np.ndarray, f_ab: np.ndarray) -> np.ndarray:
    """Products of the centred outputs whose mean is known to be 0, shape (rows, 3).

    The numerator f_B f_AB of a first-order index minus the first product gives Saltelli's estimator, and minus the
    second product Jansen's. Neither is better for every index, so :func:`subtract_controls` combines all three.

    Args:
        f_a: Centred output at A, shape (rows,).
        f_b: Centred output at B, shape (rows,).
        f_ab: Centred output at the AB_i of an index, shape (rows,).
    """
    return np.stack([f_a * f_b, 0.5 * (f_ab**2 - f_a**2), 0.5 * (f_a**2 - f_b**2)], axis=1)


def subtract_controls(numerator: np.ndarray, variance_terms: np.ndarray, controls: np.ndarray) -> np.ndarray:
    """Subtract from a numerator the combination of control variates that minimises the variance of its index.

    The coefficients of the combination are fitted by least squares. Those for a replicate are fitted to the rows of all
    other replicates. So the index stays unbiased, and the fit does not reduce the scatter between replicates from which
    the interval follows.

    Args:
        numerator: Each row's term of the numerator, shape (rows,).
        variance_terms: Each row's term of the variance, shape (rows,).
        controls: Control variates of each row, shape (rows, 3).

    Returns:
        Each row's term of the numerator, with less scatter, shape (rows,).
    """
    index = numerator.mean() / variance_terms.mean()
    targets = (numerator - index * variance_terms).reshape(-1, REPLICATES)  # (rows of a replicate, replicates)
    regressors = controls.reshape(-1, REPLICATES, controls.shape[1])
    # normal equations of each replicate's rows; n: row, r: replicate, i and j: controls
    matrices = np.einsum("nri,nrj->rij", regressors, regressors)
    right_sides = np.einsum("nri,nr->ri", regressors, targets)
    leave_one_out_matrices = matrices.sum(0) - matrices
    leave_one_out_sides = right_sides.sum(0) - right_sides
    inverses = np.linalg.pinv(leave_one_out_matrices, rcond=SINGULAR, hermitian=True)
    coefficients = np.einsum("rij,rj->ri", inverses, leave_one_out_sides)
    return numerator - np.einsum("nri,ri->nr", regressors, coefficients).reshape(-1)


def sobol_rows(study: Study) -> int:
    """The number of rows of sample A, if Sobol indices of the study can be computed.

    Raises:
        ConfigError: Inputs are correlated, or there are too few draws.
    """
    require_uncorrelated(study, claim="Sobol indices divide up the variance of")
    return row_count(study)


def sobol_design(study: Study, noisy: bool, confidence: float) -> RowDesign:
    """The design of Sobol indices: A, B, and AB_i for each factor.

    Args:
        study: The study; its number of draws, rounded down to a power of two, is the number of rows of A.
        noisy: Whether in-loop noise is a factor.
        confidence: Confidence of the intervals.

    Raises:
        ConfigError: Inputs are correlated, or there are too few draws.
    """
    rows = sobol_rows(study)
    laws = len(study.laws)
    a, b = saltelli_samples(rows, laws, (study.config.seed, stream("saltelli")))
    a = inside_cube(a)
    b = inside_cube(b)
    indices_a = np.arange(rows)
    indices_b = np.arange(rows, 2 * rows)
    samples = [RowSample(a, indices_a), RowSample(b, indices_b)]
    for column in range(laws):
        mixed = a.copy()
        mixed[:, column] = b[:, column]
        samples.append(RowSample(mixed, indices_a))
    if noisy:  # AB_i of the in-loop noise
        samples.append(RowSample(a, indices_b))
    chaos = Chaos(np.stack([sample.levels for sample in samples]), REPLICATES)
    return RowDesign(
        rows,
        samples,
        refusal=lambda values: refusal_reason(values[0], values[1]),
        quantities=lambda values: sobol_indices(values[0], values[1], values[2:], confidence, chaos),
    )
