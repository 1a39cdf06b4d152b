"""Warnings about parts that a study lacks: the best one, with those that explain the flight nearly as well.

A delay and a lag of the same time move the outputs alike, so delays are compared with the parts.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.fit.filtered_outputs import lies_behind_rate
from dssc_jax.flight_logs.fit.flown_course import flown
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.missing_parts import (
    ACTUATOR_LAG,
    DELAYS,
    FILTERED_ALONE,
    FILTERED_OUTPUT,
    TWIN_LAGS,
    lacking_parts,
)
from dssc_jax.flight_logs.fit.part_fits import STRONG_EVIDENCE, PartFit, fit_without_part, fitted_part
from dssc_jax.flight_logs.fit.part_texts import part_text
from dssc_jax.flight_logs.fit.prediction import declares_noise
from dssc_jax.flight_logs.fit.refits import Refit
from dssc_jax.flight_logs.fit.refusals import MOST_UNEXPLAINED, MUCH_LARGER, Explained, signal_and_unit
from dssc_jax.flight_logs.fit.settled_forces import settled
from dssc_jax.flight_logs.fit.shifts import LARGE_MOVE, SIGNIFICANCE
from dssc_jax.flight_logs.fit.sudden_parts import fitted_sudden_part, lacking_sudden_parts
from dssc_jax.flight_logs.signal_warnings import SignalWarning

EQUALLY = 2.0  # difference of twice the log likelihood, below which no cause is likelier (barely worth a mention)
LARGE_PART = 0.5  # share of a refused residual that may be left if a part explains it
SMALL_PART = 0.05  # share of a residual that is left if a part explains nearly all of it, whatever the noise
EXPLAINED = 0.7  # share of a doubtful residual that is left if a part explains it, whatever it moves
RESEMBLED = "another part may resemble this one"
PROBABLY_ANOTHER = "the cause is probably another part, which this one resembles"


class PartDoubts(NamedTuple):
    """The doubts about parts that a study lacks.

    Args:
        warnings: The warning of the best part; empty: no part matters.
        residual: Root mean square of the residual with the best part; infinite without one.
        exceeds_delays: Whether the best part explains the flight clearly better than any delay.
    """

    warnings: tuple[SignalWarning, ...] = ()
    residual: float = math.inf
    exceeds_delays: bool = False


NO_DOUBTS = PartDoubts()


class PartCauses(NamedTuple):
    """The parts that may be the cause of a residual.

    Args:
        best: The fit with the best part.
        rivals: The fits that explain the flight nearly as well or better, with a part or a delay, the best first.
        exceeds_delays: Whether the best part explains the flight clearly better than any delay.
    """

    best: PartFit
    rivals: list[PartFit]
    exceeds_delays: bool


def part_causes(
    problem: FitProblem,
    minimum: Minimum,
    starts: tuple[np.ndarray, ...],
    has_delay: bool,
    matters: Callable[[PartFit], bool],
) -> PartCauses | None:
    """The parts of a study of one channel that may be the cause of its residual; None if there are none.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
        starts: Coordinates of the numbers from which fits with a part begin, shape (p,) each.
        has_delay: Whether another warning names a delay: a part that explains far less than a delay is then no cause.
        matters: Tells of a part that certainly improves the fit whether it is worth a warning.
    """
    if len(problem.study.loop.channels) > 1 or len(problem.readings) != 1 or problem.count.is_stopped:
        return None
    flight = flown(problem, minimum)
    parts = lacking_parts(problem.study)
    sudden_parts = lacking_sudden_parts(problem.study)
    has_both_lags = all(part in parts for part in TWIN_LAGS)  # which are one cause
    single = sum(part.choices == 1 for part in parts)  # the p-values of all others count their own choices
    candidates = single + bool(sudden_parts) - has_both_lags
    without = fit_without_part(problem, minimum, candidates, starts)
    fits = [fitted_part(problem, without, flight, part) for part in parts]
    fits += [fitted_sudden_part(problem, without, flight, sudden) for sudden in sudden_parts]
    certain = [fit for fit in fits if fit is not None and fit.p_value < SIGNIFICANCE and matters(fit)]
    if not certain:
        return None
    delays = []
    for part in DELAYS:
        fit = fitted_part(problem, without, flight, part)
        if fit is not None:
            delays.append(fit)
    certain = distinguished(certain, problem.log.signals[0], flight.sample_time)
    best = settled(problem, without, flight, likeliest(certain))
    delay_gain = max((fit.gain for fit in delays), default=-math.inf)
    if has_delay and best.gain < delay_gain - STRONG_EVIDENCE:
        return None
    others = [fit for fit in (*certain, *delays) if fit.part is not best.part]
    rivals = [fit for fit in others if fit.gain > best.gain - STRONG_EVIDENCE]
    rivals.sort(key=lambda fit: -fit.gain)
    return PartCauses(best, rivals, best.gain > delay_gain + STRONG_EVIDENCE)


def likeliest(fits: list[PartFit]) -> PartFit:
    """The fit with the largest gain; of lags that explain a flight equally well, that of the actuator."""
    best = max(fits, key=lambda fit: fit.gain)
    for fit in fits:
        if best.part in TWIN_LAGS and fit.part is ACTUATOR_LAG and fit.gain > best.gain - EQUALLY:
            return fit
    return best


def distinguished(fits: list[PartFit], signals: Mapping[str, np.ndarray], sample_time: float) -> list[PartFit]:
    """The fits; if the logged derivative shows a lag of the output alone, this lag replaces both lags.

    Args:
        fits: The fits.
        signals: The logged signals of the channel at the samples, NaN where missing.
        sample_time: Time between two samples [s].
    """
    sizes = [fit.size for fit in fits if fit.part is FILTERED_OUTPUT]
    if not sizes or not lies_behind_rate(signals, sizes[0] / sample_time):
        return fits
    alone = []
    for fit in fits:
        if fit.part is FILTERED_OUTPUT:
            alone.append(fit._replace(part=FILTERED_ALONE))
        elif fit.part is not ACTUATOR_LAG:
            alone.append(fit)
    return alone


def is_plausible(fit: PartFit, result: Explained) -> bool:
    """Whether a part may be what the study lacks.

    A part with many choices can imitate another cause, so it has to leave nothing but noise.

    Args:
        fit: The fit with the part.
        result: How well the study describes the readings without the part.
    """
    return fit.part.choices == 1 or fit.residual <= MUCH_LARGER * result.limit


def part_doubts(
    problem: FitProblem, minimum: Minimum, deviations: np.ndarray, result: Explained, has_delay: bool
) -> PartDoubts:
    """The doubts about parts that the study lacks, with the remedy.

    A part matters if it moves a fitted number, or explains a doubtful residual.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
        deviations: Standard deviations of the fitted coordinates, shape (f,).
        result: How well the study describes the readings of the first channel.
        has_delay: Whether another warning names a delay.
    """

    def matters(fit: PartFit) -> bool:
        """Whether the part explains a doubtful residual or moves a number far, and does not enlarge the residual."""
        if not is_plausible(fit, result) or (fit.residual > result.residual and not declares_noise(problem.study)):
            return False
        explains = result.is_doubtful and fit.residual < EXPLAINED * result.residual
        return explains or largest_move(problem, minimum, fit, deviations) > LARGE_MOVE

    causes = part_causes(problem, minimum, (minimum.x,), has_delay, matters)
    if causes is None:
        return NO_DOUBTS
    warning = doubt_of(problem, minimum, deviations, result, causes)
    return PartDoubts((warning,), causes.best.residual, causes.exceeds_delays)


def part_doubts_of_refusal(problem: FitProblem, minimum: Minimum, result: Explained, has_delay: bool) -> PartDoubts:
    """The doubts about parts where a fit is refused, if one leaves far less of the residual.

    Gusts that the study declares may make most of the residual, whatever the part, so likelihood alone decides there.
    The minimum may be far from the flight's numbers, so fits begin at the medians of the laws, too.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
        result: How well the study describes the readings of the first channel.
        has_delay: Whether another warning names a delay.
    """
    residual = Refit(problem, minimum).residual(0)
    has_gusts = declares_noise(problem.study)

    def matters(fit: PartFit) -> bool:
        """Whether the part leaves so little that a fit with it would be accepted; with gusts, likelihood decides."""
        if not is_plausible(fit, result):
            return False
        is_small = fit.residual < LARGE_PART * residual and result.unexplained_by(fit.residual) < MOST_UNEXPLAINED
        return has_gusts or is_small

    starts = (minimum.x, np.zeros_like(minimum.x))
    causes = part_causes(problem, minimum, starts, has_delay, matters)
    if causes is None:
        return NO_DOUBTS
    warning = doubt_of_refusal(problem, result, causes)
    return PartDoubts((warning,), causes.best.residual, causes.exceeds_delays)


def doubt_of_refusal(problem: FitProblem, result: Explained, causes: PartCauses) -> SignalWarning:
    """The warning of the best part where a fit is refused: what it leaves of the residual.

    Args:
        problem: The problem.
        result: How well the study describes the readings without a part.
        causes: The parts.
    """
    signal, _ = signal_and_unit(problem, 0)
    output = problem.study.units[0].output
    best = causes.best
    text = (
        f"{part_text(problem, best)}, which the study lacks, leaves {best.residual:.3g} "
        f"{output} rms of the residual of {signal} (p = {best.p_value:.1g})"
    )
    for rival in causes.rivals:
        text += f"; {part_text(problem, rival)} leaves {rival.residual:.3g} {output}"
    if best.residual > MUCH_LARGER * result.limit:
        text += f". That is still more than noise explains: {best.part.leaves or RESEMBLED}"
    return SignalWarning(signal, best.part.code, f"{text[0].upper()}{text[1:]}. {remedy_of(causes)}")


def comparison(rival: PartFit, best: PartFit) -> str:
    """How well a rival explains the flight in comparison with the best part, in words."""
    if abs(rival.gain - best.gain) < EQUALLY:
        return "explains it equally well"
    return "explains it better" if rival.gain > best.gain else "explains it nearly as well"


def remedy_of(causes: PartCauses) -> str:
    """What to do about the best part; if the flight does not tell two lags apart, what to do about each of them."""
    remedy = causes.best.part.remedy
    others = [rival.part for rival in causes.rivals if rival.part in TWIN_LAGS]
    if causes.best.part not in TWIN_LAGS or not others:
        return remedy
    return f"This flight does not tell which of the two lags it is. {remedy}. For the other one: {others[0].remedy}"


def largest_move(problem: FitProblem, minimum: Minimum, fit: PartFit, deviations: np.ndarray) -> float:
    """The largest distance by which a part moves a fitted number, in the standard deviations of the coordinates.

    Args:
        problem: The problem.
        minimum: The minimum without the part.
        fit: The fit with the part.
        deviations: Standard deviations of the fitted coordinates, shape (f,).
    """
    return float(np.max(np.abs(fit.x - minimum.x)[problem.fitted] / deviations))


def doubt_of(
    problem: FitProblem,
    minimum: Minimum,
    deviations: np.ndarray,
    result: Explained,
    causes: PartCauses,
) -> SignalWarning:
    """The warning of the best part, with those that explain the flight nearly as well.

    Args:
        problem: The problem.
        minimum: The minimum without a part.
        deviations: Standard deviations of the fitted coordinates, shape (f,).
        result: How well the study describes the readings.
        causes: The parts.
    """
    best = causes.best
    place = problem.fitted[int(np.argmax(np.abs(best.x - minimum.x)[problem.fitted] / deviations))]
    signal, _ = signal_and_unit(problem, 0)
    output = problem.study.units[0].output
    name = problem.names[place]
    others = ""
    for rival in causes.rivals:
        words = part_text(problem, rival)
        others += f"; {words} {comparison(rival, best)}, with a {name} of {problem.values(rival.x)[place]:.4g}"
    words = part_text(problem, best)
    explains = (
        f"{words}, which the study lacks, would explain part of the residual of {signal} (p = {best.p_value:.1g})"
    )
    value, value_without = problem.values(best.x)[place], problem.values(minimum.x)[place]
    moved = f"with it, {name} is about {value:.4g} in place of {value_without:.4g}"
    remains = f"But {best.residual:.3g} {output} rms remain, where noise explains {result.noise:.3g} {output}"
    leaves_more = best.residual > max(MUCH_LARGER * result.limit, SMALL_PART * result.residual)
    if leaves_more and best.part.leaves and best.residual < LARGE_PART * result.residual:
        text = (
            f"{explains}: {moved}{others}. {remains}: {best.part.leaves}. Estimates are wrong by more than their "
            f"intervals. {remedy_of(causes)}"
        )
    elif leaves_more:
        text = (
            f"{explains}{others}. {remains}: {best.part.leaves or PROBABLY_ANOTHER}. Estimates are wrong by more than "
            "their intervals"
        )
    elif largest_move(problem, minimum, best, deviations) > LARGE_MOVE:
        text = f"{explains}: {moved}{others}. Estimates are wrong by more than their intervals. {remedy_of(causes)}"
    else:
        text = (
            f"{explains}: with it, this falls from {result.residual:.3g} to {best.residual:.3g} {output} rms, and no "
            f"estimate moves by more than its standard deviation{others}. {remedy_of(causes)}"
        )
    return SignalWarning(signal, best.part.code, text)
