"""What a delay leaves of a residual: if this is more than noise, there is another cause beside the delay."""

import math
from collections.abc import Sequence

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.prediction import declares_noise
from dssc_jax.flight_logs.fit.refusals import MOST_UNEXPLAINED, MUCH_LARGER, Explained, signal_and_unit
from dssc_jax.flight_logs.fit.shifts import Delay
from dssc_jax.flight_logs.hints.conversions import rms

MOST_LEFT = 0.4  # share of a refused residual: a delay that leaves more is not named


def leaves_most(problem: FitProblem, delay: Delay, results: Sequence[Explained]) -> bool:
    """Whether a fit is refused, and a delay leaves most of each residual: such a delay is not named as a cause.

    Gusts that the study declares may make most of the residual, whatever the delay.

    Args:
        problem: The problem.
        delay: The delay.
        results: How well the study describes each channel without the delay.
    """
    is_refused = any(result.least_unexplained > MOST_UNEXPLAINED for result in results)
    pairs = zip(delay.unshifted, delay.shifted, strict=True)
    return (
        is_refused and not declares_noise(problem.study) and all(after > MOST_LEFT * before for before, after in pairs)
    )


def certain_delay(problem: FitProblem, delay: Delay | None, results: Sequence[Explained]) -> Delay | None:
    """A delay, if it certainly explains the residual or a large part of it; else None.

    Args:
        problem: The problem.
        delay: The delay; None: there is none.
        results: How well the study describes each channel without it.
    """
    if delay is None or not delay.matters(problem.study.loop.sample_time) or not delay.explains:
        return None
    return None if leaves_most(problem, delay, results) else delay


def remaining_text(problem: FitProblem, minimum: Minimum, delay: Delay, results: Sequence[Explained]) -> str:
    """A sentence about what a delay leaves of the residual of each channel that is shifted; empty if it is noise.

    Shifts are whole samples. The fraction of a sample that a delay has beside them leaves the change of the output in
    that time, which counts as noise.

    Args:
        problem: The problem.
        minimum: The minimum without the delay.
        delay: The delay.
        results: How well the study describes each channel without the delay.
    """
    predicted, _ = problem.predict(problem.values(minimum.x), problem.log.commands)
    samples = delay.time / problem.study.loop.sample_time
    sentences = []
    shifted = dict(zip(delay.channels, zip(delay.unshifted, delay.shifted, strict=True), strict=True))
    for place, (readings, result) in enumerate(zip(problem.readings, results, strict=True)):
        if readings.channel not in shifted or not result.is_doubtful:
            continue
        before, after = shifted[readings.channel]
        by_rounding = abs(samples - round(samples)) * rms(np.diff(predicted[readings.channel]))
        if not after > math.hypot(MUCH_LARGER * result.limit, by_rounding):
            continue
        name, unit = signal_and_unit(problem, place)
        sentences.append(
            f". But {100.0 * after / before:.2g} % of the residual of {name} remain with it, {after:.3g} {unit} rms, "
            f"where noise explains {result.noise:.3g} {unit}: the delay is at most a part of the cause, and another "
            "one is likely, which it may only resemble"
        )
    return "".join(sentences)
