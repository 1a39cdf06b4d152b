"""Doubts about where a fitted study begins: its output beside the log's, or a level vehicle in wind.

The first output depends on the initial state alone, so that no other number explains a difference there. A fit may
still spread the difference over other numbers, if it does not last over the flight.
"""

import math
from collections.abc import Sequence

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.refusals import Explained, signal_and_unit
from dssc_jax.flight_logs.hints.starts import begins_in_air, begins_level
from dssc_jax.flight_logs.signal_warnings import SignalWarning
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in

FIRST = 5  # readings whose median counts, so that no single one decides
LATEST = 10.0  # samples: readings after that are no longer the first
DEVIATIONS = 5.0  # standard deviations of the noise: a smaller difference of the starts is not reported
KEPT = 0.05  # share of a difference by which it may vary over the flight and stay the same
KEPT_SHARE = 0.95  # of the readings for which this holds
LEAST_SHARE = 0.02  # of the output's standard deviation: a smaller difference hardly moves an estimate


def output_start_doubts(problem: FitProblem, x: np.ndarray, results: Sequence[Explained]) -> tuple[SignalWarning, ...]:
    """The doubts about outputs that begin elsewhere than the study, by channel, with the remedy.

    Args:
        problem: The least-squares problem of the log.
        x: The coordinates of the numbers, shape (p,).
        results: How well each channel is described there.
    """
    reasons = []
    latest = LATEST * problem.study.loop.sample_time
    for place, (readings, result, columns) in enumerate(
        zip(problem.readings, results, problem.columns(x), strict=True)
    ):
        if readings.times[FIRST - 1] > latest:
            continue
        difference = float(np.median(columns[:FIRST, 0]))
        noise = max(result.noise, math.sqrt(readings.sensor))
        if abs(difference) <= max(DEVIATIONS * noise, LEAST_SHARE * result.output):
            continue
        name, unit = signal_and_unit(problem, place)
        begin = float(np.median(readings.values[:FIRST]))
        text = (
            f"{name} begins at {begin:.4g} {unit}, where the study begins at {begin - difference:.4g} {unit}, and the "
            f"noise is {noise:.2g} {unit}: give the study's initial state that value or a law, or compare `start` and "
            f"the offset of the column. {effect_text(columns[:, 0], difference, noise)}"
        )
        reasons.append(SignalWarning(name, "initial-output", text))
    return tuple(reasons)


def effect_text(residual: np.ndarray, difference: float, noise: float) -> str:
    """What a difference of the starts does to the estimates, in words.

    A plant that moves alike from any place keeps the difference to the end, and no other number explains that.

    Args:
        residual: The residual, shape (n,).
        difference: The difference of the first readings from the study's output.
        noise: Standard deviation of the noise.
    """
    if float(np.quantile(np.abs(residual - difference), KEPT_SHARE)) <= max(DEVIATIONS * noise, KEPT * abs(difference)):
        return "The difference stays the same over the flight, so that other numbers hardly take any of it"
    return "Other numbers may take some of the difference, and their estimates are wrong then"


def wind_doubts(study: Study) -> tuple[SignalWarning, ...]:
    """The doubt about a vehicle that begins in the air in wind, but without the tilt that the wind requires."""
    if not begins_in_air(study) or not begins_level(study) or kind_in(study.config, "wind") == "none":
        return ()
    text = (
        "the study begins in the air, level and without body rates, and a vehicle in wind is tilted: estimates of "
        "wind, drag and integrals may be wrong by more than their intervals. Set plant.inner_loop.start = 'settled', "
        "which is the equilibrium in the wind, or plant.roll, plant.pitch and plant.body_rate, or begin at the take-off"
    )
    return (SignalWarning("", "level-start", text),)
