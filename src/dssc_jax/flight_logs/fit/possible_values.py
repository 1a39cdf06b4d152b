"""Whether the numbers of a fit can be those of the vehicle: a number far outside its law has a cause in the log."""

import math

import numpy as np

from dssc_jax.flight_logs.fit.estimates import WITHOUT_SCALE
from dssc_jax.flight_logs.fit.least_squares import FAR_OUTSIDE, LAW_ENDS, FitProblem
from dssc_jax.flight_logs.fit.refusals import MOST_UNEXPLAINED, Explained, NotIdentifiable, Unexplained
from dssc_jax.flight_logs.hints.conversions import factor_text
from dssc_jax.study import Law

ABSURD = 20.0  # standard deviations of a law beyond its ends, and
ABSURD_RATIO = 2.5  # ratio to the median of a law: a value beyond both limits is no number of this vehicle
EXPLAINS_NOTHING = 0.9  # least share of an output's standard deviation that is left as residual
UNIT_RATIO = 3.0  # of a value to the nearest end of its law: a larger one, or its inverse, may be that of a unit


def require_plausible(problem: FitProblem, x: np.ndarray, results: list[Explained]) -> None:
    """Require that no number is far outside its law where the simulated output explains nothing of the logged one.

    A controller that holds a place gives commands against a gust. The vehicle hardly moves, so that the best gain of
    the commands is 0.

    Args:
        problem: The problem.
        x: Coordinates of the minimum, shape (p,).
        results: How well the study describes each channel there.

    Raises:
        NotIdentifiable: A number is; the message names the one that is farthest outside.
    """
    beyond = np.where(problem.is_kept, 0.0, problem.beyond_laws(x))
    farthest = int(np.argmax(beyond))
    explains_nothing = all(result.residual > EXPLAINS_NOTHING * result.output for result in results)
    if beyond[farthest] > FAR_OUTSIDE and explains_nothing:
        name = problem.names[farthest]
        raise NotIdentifiable(
            f"the flight does not identify {name}: its best value, {problem.values(x)[farthest]:.4g}, is far outside "
            "its law, and the simulated output explains nothing of the logged one. Fly steps that show the number",
            name,
        )


def require_possible(problem: FitProblem, x: np.ndarray, results: list[Explained]) -> None:
    """Require that no number is absurdly far outside its law, as where an output is logged in another unit.

    A number also counts as such if it is several times as large or as small as all values of its law, and one of two
    conditions holds. Either the factor of a known unit brings it into the law; or the residual is doubtful and leaves
    more unexplained than a fit accepts, although not with the confidence that a refusal for the residual needs.

    Args:
        problem: The problem.
        x: Coordinates of the minimum, shape (p,).
        results: How well the study describes each channel there.

    Raises:
        Unexplained: A number is; the message has the value, and the factor of a unit that would bring it into the law.
    """
    is_poor = any(result.is_doubtful and result.unexplained > MOST_UNEXPLAINED for result in results)
    units = [unit for channel in problem.study.units for unit in (channel.output, channel.of("u"))]
    beyond = np.where(problem.is_kept, 0.0, problem.beyond_laws(x))
    for name, law, value, distance in zip(problem.names, problem.laws, problem.values(x), beyond, strict=True):
        ratio = value / law.median if law.median != 0.0 else math.nan
        factor = factor_text(law.quantile(LAW_ENDS) / value, units) if distance > 0.0 and value != 0.0 else ""
        is_absurd = distance > ABSURD and (ratio > ABSURD_RATIO or ratio < 1.0 / ABSURD_RATIO)
        is_of_another_unit = bool(factor) and has_scale(problem, name) and is_beyond_by_ratio(law, value)
        is_contradicted = is_poor and distance > 0.0 and value != 0.0 and is_beyond_by_ratio(law, value)
        if not is_absurd and not is_of_another_unit and not is_contradicted:
            continue
        hint = f"; {factor} it lies within its law" if factor else ""
        raise Unexplained(
            f"the study does not describe this flight: its best value of {name} is {value:.4g}, {ratio:.3g} times the "
            f"median of the law {law}{hint}. Compare the units and columns of outputs and commands with the study, or "
            "give the number a law that holds such a value"
        )


def has_scale(problem: FitProblem, name: str) -> bool:
    """Whether a number would have another value if an output or a command were logged in another unit."""
    return problem.study.numbers[name].quantity.unit not in WITHOUT_SCALE


def is_beyond_by_ratio(law: Law, value: float) -> bool:
    """Whether a value has the sign of its law, and is several times as large or as small as all values of the law.

    Args:
        law: The law of the number.
        value: The value; not 0.
    """
    ratios = law.quantile(LAW_ENDS) / value
    is_small = ratios.min() > UNIT_RATIO
    is_large = ratios.min() > 0.0 and ratios.max() < 1.0 / UNIT_RATIO
    return bool(is_small or is_large)
