"""A logged command that is rounded coarsely, where the analysed controller's is not."""

from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.signal_warnings import Hint

COARSE = 0.02  # share of a command's deviation: a finer rounding hardly matters
LEAST_LEVELS = 5  # values that occur: fewer are those of a command that switches
LEAST_VALUES = 50
NEAR = 0.02  # share of a step: closer to a multiple of it, a value is one
MOSTLY = 0.9  # least share of the values that are multiples
BY_CHANCE = 0.5  # largest share of the analysed controller's that are
HALF = 0.55  # steps: closer, a value is that of the analysed controller, rounded
AGREES = 0.8  # least share of such values of a log that rounds the analysed controller's command


class Rounding(NamedTuple):
    """How a logged command is rounded.

    Args:
        step: The distance of two neighbouring values [u].
        is_analysed: Whether the logged command is the analysed controller's, rounded.
    """

    step: float
    is_analysed: bool


def command_rounding(logged: np.ndarray, replayed: np.ndarray) -> Rounding | None:
    """The coarse rounding of a logged command that the replayed one does not have; None if there is none.

    Args:
        logged: The logged command, NaN where missing, shape (samples,).
        replayed: The command of the analysed controller, shape (samples,).
    """
    is_finite = np.isfinite(logged) & np.isfinite(replayed)
    if np.count_nonzero(is_finite) < LEAST_VALUES:
        return None
    values = logged[is_finite]
    levels = np.unique(values)
    step = rounding_step(levels)
    if step <= COARSE * rms(values - np.median(values)) or len(levels) < LEAST_LEVELS:
        return None
    is_within = (values > levels[0]) & (values < levels[-1])  # the ends may be limits, which are no multiples
    commands = replayed[is_finite]
    if not is_within.any() or multiple_share(values[is_within], step, levels[1]) < MOSTLY:
        return None
    is_moving = (commands > commands.min()) & (commands < commands.max())
    if not is_moving.any() or multiple_share(commands[is_moving], step, levels[1]) > BY_CHANCE:
        return None
    return Rounding(step, bool(np.mean(np.abs(values - commands) < HALF * step) >= AGREES))


def rounding_step(levels: np.ndarray) -> float:
    """The median distance of neighbouring values; 0 with hardly any value.

    The end values are left out, because they may be limits.

    Args:
        levels: The distinct values that occur, in ascending order.
    """
    distances = np.diff(levels[1:-1])
    return float(np.median(distances)) if distances.size else 0.0


def multiple_share(values: np.ndarray, step: float, origin: float) -> float:
    """The share of values that lie a multiple of a step away from an origin.

    Args:
        values: The values, shape (n,).
        step: The step.
        origin: A value that is a multiple, from which the others count.
    """
    places = (values - origin) / step
    return float(np.mean(np.abs(places - np.round(places)) < NEAR))


def rounded_hint(rounding: Rounding, unit: str) -> Hint:
    """The hint about a coarse rounding of a command, with the remedy.

    Args:
        rounding: The rounding.
        unit: Unit of the command.
    """
    text = f"is rounded to {rounding.step:.3g} {unit}, and the analysed controller's is not: "
    if rounding.is_analysed:
        text += (
            "if only the log rounds it, leave its column out, and a fit takes the analysed controller's command. If "
            "the actuator gets the rounded one, keep it"
        )
    else:
        text += "if only the log rounds it, the vehicle got others. Log it with more digits"
    return Hint("rounded-command", text)
