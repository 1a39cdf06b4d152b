"""Whether a refused flight has an output that is a wrapped angle, which a reference may resemble more than its study.

Jumps by turns tell it, although the study declares no unit of an angle. The same log with the unwrapped output is
fitted once more, and what remains is told.
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
    """The doubts about outputs that are wrapped; without one, about columns, as :func:`column_doubts` has them."""
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
    """The turns that a wrapped angle has at each sample, in its unit; 0 for other outputs, shape (samples,).

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
