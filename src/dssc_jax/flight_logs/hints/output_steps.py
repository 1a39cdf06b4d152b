"""Steps of a logged output, and their cause: a wrapped angle, a wrong column with steps of a reference, or a reset."""

from collections.abc import Sequence

import numpy as np

from dssc_jax.flight_logs.hints.conversions import is_same_reference
from dssc_jax.flight_logs.hints.references import references_at
from dssc_jax.study import Study

SAME_STEP = 0.2  # share of a step of the reference: closer, a step of the output is that one or its opposite
SAME_TURN = 0.1  # share of a turn: closer, a step of an angle is one
UNDECLARED_TURN = 0.01  # the same, of an output whose unit is none of an angle
TURNS = {"rad": 2.0 * np.pi, "deg": 360.0}
"""A turn, by units of angles."""
WRAPPED = "each time by a full turn: the angle is wrapped. Unwrap it, and its reference"
RESET = "a reset of the estimator that the log does not count, or two flights in one log. Take the part before or after"


def is_reference(output: np.ndarray, reference: np.ndarray) -> bool:
    """Whether a logged output is the study's reference, which moves.

    Args:
        output: The logged output, NaN where missing, shape (samples,).
        reference: The study's reference.
    """
    is_moving = bool(np.ptp(reference) > 0.0 and np.isfinite(output).any())
    return is_moving and is_same_reference(output, reference)


def turn_of(sizes: np.ndarray, unit: str) -> float | None:
    """The full turn by which an output jumps each time, in the output's unit; None if it does not jump by turns.

    Few studies declare the unit of an angle. So an output in another unit also counts as an angle if it jumps at least
    twice, each time by a turn in rad or in deg to 1 %.

    Args:
        sizes: The jumps, in the output's unit.
        unit: Unit of the output in the study.
    """
    sizes = np.asarray(sizes)
    if not sizes.size:
        return None
    if unit in TURNS:
        return TURNS[unit] if (np.abs(np.abs(sizes) - TURNS[unit]) < SAME_TURN * TURNS[unit]).all() else None
    if len(sizes) < 2:
        return None
    for turn in TURNS.values():
        if (np.abs(np.abs(sizes) - turn) < UNDECLARED_TURN * turn).all():
            return turn
    return None


def step_cause(study: Study, index: int, times: Sequence[float], sizes: Sequence[float]) -> str:
    """The cause, in words, of steps that an output has, but not the output's rate or prediction.

    Args:
        study: The study.
        index: Position of the output's channel.
        times: Times of the first readings after the steps, from the study's beginning on [s].
        sizes: The steps, in the output's unit.
    """
    if turn_of(np.asarray(sizes), study.units[index].output) is not None:
        return WRAPPED
    sample_time = study.loop.sample_time
    ends = np.concatenate([np.asarray(times) - 1.5 * sample_time, np.asarray(times) + 0.5 * sample_time])
    before, after = np.split(references_at(study, ends)[index, 0], 2)
    steps = after - before
    for sign, words in (
        (-1.0, "minus the step of its reference: is it the error y - y_ref in place of y?"),
        (1.0, "the step of its reference: is it the reference, or the error y_ref - y, in place of y?"),
    ):
        if (np.abs(np.asarray(sizes) - sign * steps) < SAME_STEP * np.abs(steps)).all():
            return f"each time by {words}"
    return RESET
