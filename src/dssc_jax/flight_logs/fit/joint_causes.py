"""A steady wind beside a delay or a lag, where a fit is refused: neither alone explains the flight, but both may.

A constant disturbance joins the numbers of the fit, and each delay and each lag is tried beside it.
"""

from typing import NamedTuple

from dssc_jax.flight_logs.fit.flown_course import flown
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum, reweighted_minimum
from dssc_jax.flight_logs.fit.missing_parts import (
    ABSENT,
    DELAYS,
    STEADY_WIND,
    TWIN_LAGS,
    Part,
    lacking_parts,
)
from dssc_jax.flight_logs.fit.part_fits import STRONG_EVIDENCE, PartFit, fit_without_part, fitted_part
from dssc_jax.flight_logs.fit.part_texts import part_text
from dssc_jax.flight_logs.fit.prediction import prediction
from dssc_jax.flight_logs.fit.refits import Refit, refit
from dssc_jax.flight_logs.fit.refusals import MOST_UNEXPLAINED, MUCH_LARGER, Explained, signal_and_unit
from dssc_jax.flight_logs.fit.search_limits import SearchCount
from dssc_jax.flight_logs.fit.shifts import SIGNIFICANCE
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.hints.starts import fixed_integrals
from dssc_jax.flight_logs.signal_warnings import SignalWarning

FORCE = "disturbance.value"
FAR_LESS = 0.4  # share of the residual that each of two causes leaves alone; both together have to leave less


class JointCause(NamedTuple):
    """The fit with a steady wind and another cause.

    Args:
        problem: The problem with the wind among its numbers.
        best: The fit with the likeliest delay or lag beside the wind.
        rivals: Fits with other delays or lags beside the wind that explain the flight nearly as well.
    """

    problem: FitProblem
    best: PartFit
    rivals: list[PartFit]


def joint_doubts(problem: FitProblem, minimum: Minimum, result: Explained, told: float) -> tuple[SignalWarning, ...]:
    """The doubt about a steady wind and a delay or a lag together, where they leave far less than each cause alone.

    Args:
        problem: The problem of a refused fit, with the noise of the minimum.
        minimum: The minimum.
        result: How well the study describes the readings of the first channel.
        told: Root mean square of the residual with the part that a warning names; infinite without such a part.
    """
    if told <= MUCH_LARGER * result.limit:
        return ()
    cause = joint_cause(problem, minimum)
    if cause is None:
        return ()
    best = cause.best
    alone = residual_alone(problem, minimum, best.part)
    is_far_less = best.residual < FAR_LESS * min(told, alone, result.residual)
    if not is_far_less or result.unexplained_by(best.residual) > MOST_UNEXPLAINED:
        return ()
    signal, output = signal_and_unit(problem, 0)
    size = cause.problem.named_values(best.x)[FORCE]
    words = " or ".join(part_text(cause.problem, fit) for fit in (best, *cause.rivals))
    force = STEADY_WIND.words.format(size=size, command=problem.study.units[0].command)
    text = (
        f"{force[0].upper()}{force[1:]} and, at the same time, {words}, which the study lacks, together leave "
        f"{best.residual:.3g} {output} rms of the residual of {signal} (p = {best.p_value:.1g}); neither does alone. "
        f"{STEADY_WIND.remedy}, and a delay or lag with a law ([unmodelled], [[actuator]] or [sensor]), or log the "
        "times of measurement and command"
    )
    return (SignalWarning(signal, "missing-force", text),)


def residual_alone(problem: FitProblem, minimum: Minimum, part: Part) -> float:
    """The root mean square of the residual with one part alone, or without any part if this one explains nothing.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum without the part.
        part: The part.
    """
    without = fit_without_part(problem, minimum, 1, (minimum.x, 0.0 * minimum.x))
    fit = fitted_part(problem, without, flown(problem, minimum), part)
    return Refit(problem, minimum).residual(0) if fit is None else fit.residual


def joint_cause(problem: FitProblem, minimum: Minimum) -> JointCause | None:
    """The fit with a steady wind and the likeliest delay or lag.

    Returns:
        None if the study has a disturbance or several channels, or neither a delay nor a lag explains enough.
    """
    is_usable = len(problem.study.loop.channels) == 1 and len(problem.readings) == 1 and not problem.count.is_stopped
    if not is_usable or problem.study.config.disturbance != ABSENT:
        return None
    pushed = with_force(problem)
    end = refit(pushed, Minimum(pushed.medians * 0.0, minimum.equations, 1), pushed.log)
    end = Refit(end.problem, reweighted_minimum(end.problem, end.minimum))
    lags = [part for part in lacking_parts(problem.study) if part in TWIN_LAGS]
    parts = (*lags, *DELAYS)
    without = fit_without_part(end.problem, end.minimum, len(parts), (end.minimum.x, 0.0 * end.minimum.x))
    flight = flown(end.problem, end.minimum)
    fits = [fitted_part(end.problem, without, flight, part) for part in parts]
    certain = [fit for fit in fits if fit is not None and fit.p_value < SIGNIFICANCE]
    if not certain:
        return None
    certain.sort(key=lambda fit: -fit.gain)
    best, *others = certain
    if not best.residual < FAR_LESS * end.residual(0):
        return None
    return JointCause(end.problem, best, [fit for fit in others if fit.gain > best.gain - STRONG_EVIDENCE])


def with_force(problem: FitProblem) -> FitProblem:
    """The problem of one channel with a constant disturbance among its numbers; its simulations are not counted."""
    spread = rms(problem.log.commands[0]) or 1.0
    study = problem.study.override({"disturbance": {"kind": "constant", "value": {"normal": [0.0, spread]}}})
    names = (*problem.names, FORCE)
    samples = problem.log.outputs.shape[1]
    predict = prediction(study, names, samples, fixed_integrals(study))
    return FitProblem(study, names, predict, problem.log, SearchCount(), problem.kept)
