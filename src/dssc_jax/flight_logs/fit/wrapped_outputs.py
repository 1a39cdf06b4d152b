"""Whether an output of a refused flight is a wrapped angle; other columns are suspected only if none is.

Jumps by full turns show a wrapped angle, even if the study does not declare the output as one. The same log with the
unwrapped output is fitted once more, and the message tells the residual that remains.
"""

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.refits import Refit
from dssc_jax.flight_logs.fit.wrong_columns import OtherColumns, best_columns, column_doubts, with_row
from dssc_jax.flight_logs.hints.output_steps import WRAPPED, turn_of
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning


def column_causes(problem: FitProblem, minimum: Minimum) -> tuple[SignalWarning, ...]:
    """The doubts about wrapped outputs; if there are none, those about columns by :func:`column_doubts`."""
    if problem.count.is_stopped:
        return ()
    return wrapped_doubts(problem, minimum) or column_doubts(problem, minimum)


def wrapped_doubts(problem: FitProblem, minimum: Minimum) -> tuple[SignalWarning, ...]:
    """The doubts about outputs that jump by turns, with the remedy.

    Args:
        problem: The least-squares problem of the log.
        minimum: Its minimum.
    """
    doubts = []
    for readings in problem.readings:
        channel = readings.channel
        output = problem.log.outputs[channel]
        turns = turns_of(output, problem.study.units[channel].output)
        if not turns.any():
            continue
        name = signal_name(problem.study.loop.channels[channel], "y")
        outputs = with_row(problem.log.outputs, channel, output - turns)
        unwrapped = OtherColumns(name, "", [channel], problem.log._replace(outputs=outputs))
        best, share = best_columns(Refit(problem, minimum), [unwrapped])
        count = np.count_nonzero(np.diff(turns))
        text = f"{name} jumps {count} times, {WRAPPED}"
        if best is not None:
            text += (
                f": with that, the study describes the flight, and the residual is {100 * share:.2g} % of the output"
            )
        doubts.append(SignalWarning(name, "output-jump", text))
    return tuple(doubts)


def turns_of(output: np.ndarray, unit: str) -> np.ndarray:
    """The turns to subtract from a wrapped angle at each sample, in its unit, shape (samples,); 0 for other outputs.

    Args:
        output: The logged output, NaN where missing, shape (samples,).
        unit: Its unit in the study.
    """
    turns = np.zeros(len(output))
    rows = np.flatnonzero(np.isfinite(output))
    changes = np.diff(output[rows])
    is_jump = np.abs(changes) > 0.5 * np.max(np.abs(changes), initial=0.0)
    if is_jump.all():
        return turns
    motion = np.interp(np.flatnonzero(is_jump), np.flatnonzero(~is_jump), changes[~is_jump])
    turn = turn_of(changes[is_jump] - motion, unit)
    if turn is None:
        return turns
    steps = np.zeros(len(output))
    steps[rows[1:]] = turn * np.round(changes / turn)
    return np.cumsum(steps)
