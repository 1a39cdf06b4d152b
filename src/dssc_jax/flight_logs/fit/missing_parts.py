"""The table of parts that a study of one channel may lack, each of one number: forces, parts of an actuator, gains.

Each part changes the commands that the study's plant gets, or acts as a force behind its actuator. The size 0 of the
number, or its absence, is the study.

References:
    L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), section 16.4: comparison of model structures.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dssc_jax.core.contracts import Unmodelled
from dssc_jax.flight_logs.fit.actuated_commands import actuated_commands
from dssc_jax.flight_logs.fit.filtered_outputs import filtered, has_sensor_lag
from dssc_jax.flight_logs.fit.flown_course import Flight
from dssc_jax.flight_logs.fit.least_squares import TINY
from dssc_jax.flight_logs.fit.prediction import declares_noise
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.signal_warnings import WarningCode
from dssc_jax.models.actuators.dead_zone import DEAD_ZONE
from dssc_jax.models.actuators.lag import Order, lag
from dssc_jax.models.actuators.quantisation import QUANTISATION
from dssc_jax.models.actuators.rate_limit import RATE_LIMIT
from dssc_jax.models.actuators.saturation import SATURATION
from dssc_jax.study import Study
from dssc_jax.study.actuators import acting_elements

ABSENT = {"kind": "none"}  # table of a disturbance that a study does not have
REST = 1e-2  # share of the largest speed below which friction passes through 0
PROBE = 1e-2  # size of a force at first, as a share of the command
LAGS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # samples: the first time constants
LEVELS = (0.95, 0.85, 0.75, 0.65, 0.55, 0.45, 0.35)  # of the largest command: the first limits
WIDTHS = (0.02, 0.05, 0.1, 0.2)  # of the largest command: the first dead zones
RATES = (0.8, 0.4, 0.2, 0.1, 0.05)  # of the largest change in a sample: the first limits of the rate
STEPS = tuple(0.03 * 1.04**i for i in range(100))  # of the command's root mean square: the first steps of a rounding
SHORT = tuple(i / 10.0 for i in range(10, 100))  # numbers of two digits, as steps often are
MOST_STEPS = 260  # of both kinds
MOST_CHANGE = 0.9  # largest share by which a gain falls or rises


class Part(NamedTuple):
    """A part that a study may lack.

    Args:
        code: Code of its warning.
        words: What it is, with ``{size}``, ``{percent}``, ``{deviation}``, ``{acceleration}``, ``{verb}``, ``{output}``
            and ``{command}`` to be filled in.
        remedy: What to do.
        actuator: Its model, if it is one of an actuator.
        commands: (Flight, size) -> commands that a plant with the part gets, before the study's actuator, shape (n,).
        sizes: Flight -> sizes that are tried first.
        is_positive: Whether only positive sizes are possible, whose logarithms are fitted.
        is_possible: (Flight, size) -> whether the size means something on this flight.
        choices: Number of such parts of which it is the likeliest.
        forces: (Flight, size) -> forces that act on a plant with the part beside the actuator's output, shape (n,);
            None: it is no force.
        has_speed: Whether its forces depend on the speed of the flight.
        outputs: (Series, samples) -> what the log has of a predicted output for a size in samples, shape (..., n);
            None: the output itself.
        leaves: Why a part that is the cause may leave more than noise; empty: no reason is known.
    """

    code: WarningCode
    words: str
    remedy: str
    actuator: Unmodelled | None
    commands: Callable[[Flight, float], np.ndarray]
    sizes: Callable[[Flight], tuple[float, ...]]
    is_positive: bool
    is_possible: Callable[[Flight, float], bool]
    choices: int = 1
    forces: Callable[[Flight, float], np.ndarray] | None = None
    has_speed: bool = False
    outputs: Callable[[np.ndarray, float], np.ndarray] | None = None
    leaves: str = ""

    def forces_on(self, flight: Flight, size: float) -> np.ndarray | None:
        """The forces on a plant with the part, shape (n,) [u]; None: it is no force."""
        return None if self.forces is None else self.forces(flight, size)


def quadratic_drag(speed: np.ndarray) -> np.ndarray:
    """Drag of the size 1: a force that grows with the square of the speed, and acts against it; shape (n,)."""
    return -speed * np.abs(speed)


def friction(speed: np.ndarray) -> np.ndarray:
    """Friction of the size 1: a constant force against the speed, which passes through 0 at rest; shape (n,)."""
    return -speed / np.hypot(speed, REST * float(np.abs(speed).max()) + TINY)


def drag_forces(flight: Flight, size: float) -> np.ndarray:
    """Forces of quadratic drag, shape (n,) [u]; the size is the drag at a speed of 1."""
    return size * quadratic_drag(flight.speed)


def friction_forces(flight: Flight, size: float) -> np.ndarray:
    """Forces of friction of the given size, shape (n,) [u]."""
    return size * friction(flight.speed)


def constant_forces(flight: Flight, size: float) -> np.ndarray:
    """A constant force of the given size at all samples, shape (n,) [u]."""
    return np.full(len(flight.commands), size)


def behind(model: Unmodelled) -> Callable[[Flight, float], np.ndarray]:
    """The commands behind an actuator whose first parameter is the size: (flight, size) -> means over each sample."""
    return lambda flight, size: actuated_commands(model, model.params(size), flight.commands, flight.sample_time)


def fading(flight: Flight, size: float) -> np.ndarray:
    """Commands whose gain changes linearly in time, from 1 at the first sample to 1 - size at the last one."""
    return flight.commands * np.linspace(1.0, 1.0 - size, len(flight.commands))


def late(flight: Flight, size: float) -> np.ndarray:
    """Commands that act later by the size [s]; until then the first command acts."""
    return delayed(flight.commands, size / flight.sample_time)


def on_time(flight: Flight, size: float) -> np.ndarray:
    """The commands as they are, of a part that is a force or changes the outputs; the size does not matter."""
    return flight.commands


def delayed(series: np.ndarray, samples: float) -> np.ndarray:
    """A series delayed by a number of samples, interpolated linearly between whole ones; shape (..., n)."""
    positions = np.maximum(np.arange(series.shape[-1]) - samples, 0.0)
    first = np.floor(positions).astype(int)
    share = positions - first
    following = np.minimum(first + 1, series.shape[-1] - 1)
    return (1.0 - share) * series[..., first] + share * series[..., following]


def drag_sizes(flight: Flight) -> tuple[float, ...]:
    """The size of drag that is tried first: its forces are small beside the commands."""
    return (force_sizes(flight)[0] / max(rms(quadratic_drag(flight.speed)), TINY),)


def force_sizes(flight: Flight) -> tuple[float, ...]:
    """The size of a force [u] that is tried first: a share of the commands' rms, or of 1 if all commands are 0."""
    return (PROBE * (rms(flight.commands) or 1.0),)


def lag_sizes(flight: Flight) -> tuple[float, ...]:
    """Time constants of a lag [s] that are tried first: from half a sample on, and short beside the flight."""
    return tuple(flight.sample_time * samples for samples in LAGS if 10.0 * samples < len(flight.commands))


def limit_sizes(flight: Flight) -> tuple[float, ...]:
    """Limits of the command [u] that are tried first, all below the largest command."""
    largest = float(np.abs(flight.commands).max())
    return tuple(largest * level for level in LEVELS)


def dead_zone_sizes(flight: Flight) -> tuple[float, ...]:
    """Half widths of a dead zone [u] that are tried first, all small beside the largest command."""
    largest = float(np.abs(flight.commands).max())
    return tuple(largest * width for width in WIDTHS)


def rate_sizes(flight: Flight) -> tuple[float, ...]:
    """Limits of the rate [u/s] that are tried first, all below the largest rate of the commands."""
    return tuple(largest_rate(flight) * share for share in RATES)


def step_sizes(flight: Flight) -> tuple[float, ...]:
    """Steps of a rounded command [u] that are tried first: numbers of two digits, then a fine geometric series."""
    size = rms(flight.commands)
    if size == 0.0:
        return (1.0,)
    decades = range(math.floor(math.log10(STEPS[0] * size)), math.ceil(math.log10(STEPS[-1] * size)))
    short = [digits * 10.0**decade for decade in decades for digits in SHORT]
    within = [step for step in short if STEPS[0] * size <= step <= STEPS[-1] * size]
    return (*within, *(size * step for step in STEPS))


def largest_rate(flight: Flight) -> float:
    """The largest change of the command from one sample to the next, over the sample time [u/s]."""
    return float(np.abs(np.diff(flight.commands)).max()) / flight.sample_time


def fading_sizes(flight: Flight) -> tuple[float, ...]:
    """The share by which a gain falls that is tried first: a small one, whatever the flight."""
    return (PROBE,)


def is_against(flight: Flight, size: float) -> bool:
    """Whether a force of this size acts against the speed, as drag and friction do on any flight."""
    return size > 0.0


def is_any(flight: Flight, size: float) -> bool:
    """True: any size means something on any flight."""
    return True


def is_reached(flight: Flight, size: float) -> bool:
    """Whether the commands exceed a limit of this size [u]."""
    return 0.0 < size < float(np.abs(flight.commands).max())


def is_narrow(flight: Flight, size: float) -> bool:
    """Whether a dead zone of this half width [u] lets the larger commands pass."""
    return 0.0 < size < 0.5 * float(np.abs(flight.commands).max())


def is_rounding(flight: Flight, size: float) -> bool:
    """Whether rounding to multiples of this step [u] leaves several values of the commands."""
    return 0.0 < size < float(np.abs(flight.commands).max()) / 2.0


def is_exceeded(flight: Flight, size: float) -> bool:
    """Whether the commands change faster than this rate [u/s]."""
    return 0.0 < size < largest_rate(flight)


def is_short(flight: Flight, size: float) -> bool:
    """Whether a lag or a delay of this time [s] is short beside the flight."""
    return 0.0 < size < 0.2 * flight.sample_time * len(flight.commands)


def is_moderate(flight: Flight, size: float) -> bool:
    """Whether the gain changes by less than the largest share that is believed, ``MOST_CHANGE``."""
    return abs(size) < MOST_CHANGE


def actuator_part(
    code: WarningCode,
    words: str,
    noun: str,
    model: Unmodelled,
    sizes: Callable[[Flight], tuple[float, ...]],
    is_possible: Callable[[Flight, float], bool],
) -> Part:
    """A part of an actuator of the package, whose first parameter is its positive size.

    Args:
        code: Code of the part's warning; see :class:`Part` for this and the other fields.
        words: What the part is.
        noun: Name of the part in the remedy.
        model: The actuator.
        sizes: First sizes.
        is_possible: Whether a size means something.
    """
    remedy = f"Give the study that {noun} with a law ([unmodelled] or [[actuator]]), or log the command behind it"
    return Part(code, words, remedy, model, behind(model), sizes, is_positive=True, is_possible=is_possible)


def force_part(
    words: str,
    remedy: str,
    sizes: Callable[[Flight], tuple[float, ...]],
    is_possible: Callable[[Flight, float], bool],
    forces: Callable[[Flight, float], np.ndarray],
) -> Part:
    """A part that is a force of either sign beside the actuator's output; arguments as fields of :class:`Part`."""
    return Part(
        "missing-force", words, remedy, None, on_time, sizes, is_positive=False, is_possible=is_possible, forces=forces
    )


FRICTION = force_part(
    words="a force against the speed of constant size (friction, {size:.3g} ± {deviation:.2g} {command}{acceleration})",
    remedy="Give the plant that force (docs/extending.md), or fly at the speeds that count",
    sizes=force_sizes,
    is_possible=is_against,
    forces=friction_forces,
)._replace(
    has_speed=True,
    leaves="friction also holds at rest, which leaves a residual of its own, or another part acts beside or instead",
)

STEADY_WIND = force_part(
    words="a constant force ({size:.3g} {command}, as of a steady wind)",
    remedy='Give the study that force with a law (disturbance, kind = "constant")',
    sizes=force_sizes,
    is_possible=is_any,
    forces=constant_forces,
)

ACTUATOR_LAG = actuator_part(
    "missing-lag", "a first-order lag of the actuator of {size:.3g} s", "lag", lag(Order.ONE), lag_sizes, is_short
)
FILTERED_OUTPUT = Part(
    code="filtered-output",
    words="a first-order lag of the sensor of {size:.3g} s",
    remedy='Give the study that lag with a law (sensor, kind = "lag"), or log the measurement before the filter',
    actuator=None,
    commands=on_time,
    sizes=lag_sizes,
    is_positive=True,
    is_possible=is_short,
    outputs=filtered,
)
FILTERED_ALONE = FILTERED_OUTPUT._replace(
    words="a low pass of y alone of {size:.3g} s",
    remedy="The logged y lies as much behind the integral of the logged y_dot: log y before that filter",
)
TWIN_LAGS = (ACTUATOR_LAG, FILTERED_OUTPUT)
"""Lags that act alike on a flight from rest."""

FADING = Part(
    code="changing-gain",
    words="a gain of the command that {verb} by {percent:.3g} % from the first sample to the last, as with a battery",
    remedy="Log the command times the gain, such as thrust in place of throttle, or fit a shorter part of the flight",
    actuator=None,
    commands=fading,
    sizes=fading_sizes,
    is_positive=False,
    is_possible=is_moderate,
)

PARTS = (
    force_part(
        words="a force against the speed that grows with the square of the speed (drag, {size:.3g} ± {deviation:.2g} "
        "{command} at 1 {output}/s{acceleration})",
        remedy="Give the plant that force (docs/extending.md), or fly at the speeds that count",
        sizes=drag_sizes,
        is_possible=is_against,
        forces=drag_forces,
    )._replace(has_speed=True),
    FRICTION,
    STEADY_WIND,
    ACTUATOR_LAG,
    FILTERED_OUTPUT,
    actuator_part(
        "missing-limit",
        "an actuator that limits the command to {size:.3g} {command} either side of 0",
        "limit",
        SATURATION,
        limit_sizes,
        is_reached,
    ),
    actuator_part(
        "missing-limit",
        "an actuator that limits the rate of the command to {size:.3g} {command}/s",
        "limit of the rate",
        RATE_LIMIT,
        rate_sizes,
        is_exceeded,
    ),
    actuator_part(
        "missing-dead-zone",
        "an actuator that leaves out commands of less than {size:.3g} {command}",
        "dead zone",
        DEAD_ZONE,
        dead_zone_sizes,
        is_narrow,
    ),
    actuator_part(
        "missing-rounding",
        "an actuator that rounds the command to multiples of {size:.3g} {command}",
        "rounding",
        QUANTISATION,
        step_sizes,
        is_rounding,
    )._replace(choices=MOST_STEPS),
    FADING,
)


LATE_OUTPUT = Part(
    code="delayed-output",
    words="an output that is {size:.3g} s late",
    remedy="",
    actuator=None,
    commands=on_time,
    sizes=lag_sizes,
    is_positive=True,
    is_possible=is_short,
    outputs=delayed,
)
LATE_COMMAND = LATE_OUTPUT._replace(
    code="delayed-command", words="a command that acts {size:.3g} s late", commands=late, outputs=None
)
DELAYS = (LATE_OUTPUT, LATE_COMMAND)


def lacking_parts(study: Study) -> list[Part]:
    """The parts that a study of one channel lacks, by what its models declare.

    An actuator that is linear is taken for a lag. A disturbance that is not random is taken for a constant force.
    """
    models = [element.model for element, _ in acting_elements(study.table, study.config)]
    has_linear_actuator = any(model.linear is not None for model in models)
    has_force = study.config.disturbance != ABSENT and not declares_noise(study)
    parts = []
    for part in PARTS:
        is_lag = part.actuator is not None and part.actuator.linear is not None
        has_actuator = any(model is part.actuator for model in models) or (is_lag and has_linear_actuator)
        has_lag = part is FILTERED_OUTPUT and has_sensor_lag(study)
        if not has_actuator and not has_lag and not (part is STEADY_WIND and has_force):
            parts.append(part)
    return parts
