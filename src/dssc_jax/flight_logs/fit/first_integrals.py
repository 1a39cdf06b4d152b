"""Whether a logged flight began with the integrals of the study, as its outputs show.

Other integrals at the first sample change the output in a way that other numbers can hardly imitate. One step of Gauss
and Newton over the fitted numbers and the integrals tells both how large the integrals were and how far the estimates
would move.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.refusals import FitRefused
from dssc_jax.flight_logs.hints.starts import fixed_integrals, start_remedy
from dssc_jax.statistics.correlated_noise import weighted_products
from dssc_jax.study import Study

SIGNIFICANCE = 1e-4  # p-value below which integrals differ from those of the study
LARGE_MOVE = 1.0  # least move of an estimate by free integrals that matters, in its standard deviations
ROUNDING = 1e-9  # share of the information along each coordinate that is added, against rounding


class StartsElsewhere(FitRefused):
    """The flight's integrals at the first sample are not those of the study; the message has the numbers."""


class FreeIntegrals(NamedTuple):
    """The integrals at the first sample, estimated together with the numbers of a fit.

    Args:
        names: Names of the integrals.
        values: Value of each integral that the flight shows, to first order.
        deviations: Standard deviations of these values.
        p_value: Probability of as large a reduction of the sum of squares if the study's integrals were right.
        moves: How far the estimates would move, by number, in their standard deviations.
    """

    names: tuple[str, ...]
    values: np.ndarray
    deviations: np.ndarray
    p_value: float
    moves: dict[str, float]

    @property
    def differ_and_matter(self) -> bool:
        """Whether the flight's integrals differ from the study's, and the estimates depend on it."""
        return self.p_value < SIGNIFICANCE and max(map(abs, self.moves.values())) > LARGE_MOVE


def free_integrals(problem: FitProblem, minimum: Minimum) -> FreeIntegrals | None:
    """Estimate the first integrals from the residual at a minimum, by one Gauss-Newton step.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.

    Returns:
        None if the study has no plain numbers for them.
    """
    fixed_values = fixed_integrals(problem.study)
    if not fixed_values:
        return None
    study_integrals = np.array(list(fixed_values.values()))
    p = len(problem.names)
    _, slopes = problem.predict(np.concatenate([problem.values(minimum.x), study_integrals]), problem.log.commands)
    products = np.zeros((1 + p + len(fixed_values),) * 2)
    rows = zip(problem.readings, problem.noises, problem.variances, problem.columns(minimum.x), strict=True)
    for readings, noise, variance, columns in rows:
        extended = np.column_stack([columns, readings.interpolate(slopes[p:, readings.channel]).T])
        products += weighted_products(noise, readings.times, extended)[0] / variance
    products[1 : 1 + p, 0] -= problem.prior * minimum.x
    products[1 : 1 + p, 1 : 1 + p] += np.diag(problem.prior)
    step = gauss_newton_step(tuple(fixed_values), problem.names, study_integrals, products)
    return step._replace(moves={name: step.moves[name] for name in problem.fitted_names})


def gauss_newton_step(
    names: tuple[str, ...], numbers: Sequence[str], study_integrals: np.ndarray, products: np.ndarray
) -> FreeIntegrals:
    """The step to the minimum over numbers and integrals, from the products of residual and slopes.

    Args:
        names: Names of the q integrals.
        numbers: Names of the p numbers.
        study_integrals: The integrals of the study, shape (q,).
        products: Weighted products of the columns, shape (1 + p + q, 1 + p + q). The columns are the residual, its
            slopes by the numbers, and its slopes by the integrals.
    """
    p = len(numbers)
    scale = np.sqrt(np.maximum(np.diag(products)[1:], TINY))
    information = products[1:, 1:] / np.outer(scale, scale) + ROUNDING * np.eye(len(scale))
    gradient = products[1:, 0] / scale
    number_information = information[:p, :p]
    inverse = np.linalg.inv(information)
    step = inverse @ gradient
    # how much more of the weighted sum of squares the free integrals take away
    reduction = float(gradient @ step - gradient[:p] @ np.linalg.solve(number_information, gradient[:p]))
    # in standard deviations of the numbers while the integrals are those of the study
    moves = (step[:p] / np.sqrt(np.diag(np.linalg.inv(number_information)))).tolist()
    values = study_integrals + (step / scale)[p:]
    deviations = (np.sqrt(np.diag(inverse)) / scale)[p:]
    return FreeIntegrals(
        names=names,
        values=values,
        deviations=deviations,
        p_value=float(stats.chi2.sf(reduction, len(names))),
        moves=dict(zip(numbers, moves, strict=True)),
    )


def require_first_integrals(study: Study, integrals: FreeIntegrals | None) -> None:
    """Require that a flight's first integrals are those of the study, or that the estimates do not depend on them.

    Args:
        study: The study.
        integrals: The integrals that the flight shows; None: the study has no plain numbers for them.

    Raises:
        StartsElsewhere: They are others.
    """
    if integrals is None or not integrals.differ_and_matter:
        return
    rows = zip(integrals.names, integrals.values, integrals.deviations, strict=True)
    values_text = ", ".join(f"{name} = {value:.3g} ± {deviation:.2g}" for name, value, deviation in rows)
    number, move = max(integrals.moves.items(), key=lambda pair: abs(pair[1]))
    raise StartsElsewhere(
        f"the flight did not begin with the study's integrals: its outputs show {values_text} "
        f"(p = {integrals.p_value:.1g}), and {number} would be {abs(move):.3g} of its standard deviations off. "
        f"{start_remedy(study, integrals.names[-1])}"
    )
