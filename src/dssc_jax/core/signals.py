"""Signals between models: measurements, reference points, commands, plant inputs, tracking errors, outcomes.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import jax

Scalar: TypeAlias = jax.Array | float

Params: TypeAlias = Any

State: TypeAlias = Any

Info: TypeAlias = Any

LastChange: TypeAlias = Callable[[Params], Scalar]
"""``(params) -> t``: time [s] from which a signal does nothing that it has not done before. Changes at the times that
parameters declare by ``begins`` do not count, and noise counts as doing the same at all times. ``params`` has the
largest value of each number. The result math.inf means that the signal changes again and again."""

ProgressCallback: TypeAlias = Callable[[int, int | None], None]
"""``(finished, total)``: called with the number of finished lanes or steps and the total number; the total is None if
it is not known."""


class Measurement(NamedTuple):
    """A measurement of one channel.

    Args:
        y: Output [y].
        y_dot: Derivative of the output [y/s].
        signals: The other measured signals, in the order of the study's ``measures``. Only the controller gets these:
            measurements of the plant, of sensors and of differentiators have an empty tuple.
    """

    y: Scalar
    y_dot: Scalar
    signals: tuple[Scalar, ...] = ()


class ReferencePoint(NamedTuple):
    """The desired output y_m of one channel, with its derivatives.

    Args:
        y: y_m [y].
        y_dot: y_m' [y/s].
        y_ddot: y_m'' [y/s^2].
    """

    y: Scalar
    y_dot: Scalar
    y_ddot: Scalar


Signals: TypeAlias = tuple[Scalar, ...]
"""One value per channel."""

Measurements: TypeAlias = tuple[Measurement, ...]
"""One measurement per channel."""

ReferencePoints: TypeAlias = tuple[ReferencePoint, ...]
"""One desired point per channel."""

Signal = TypeVar("Signal", bound=Scalar | Signals)
"""A scalar for a plant with one channel (SISO), a tuple of scalars for several (MIMO)."""


class Command(NamedTuple):
    """A controller's command u_p of equation (11), split into its two parts u (robust) and u_n (nominal) [u]."""

    robust: Scalar
    nominal: Scalar

    @property
    def total(self) -> Scalar:
        """The sum u_p = u + u_n (11) [u]."""
        return self.robust + self.nominal


class PlantInput(NamedTuple, Generic[Signal]):
    """The plant's input.

    Args:
        command: The command u_p after the actuators [u]; a tuple for a plant with several channels.
        disturbance: The matched disturbance d [u]; a tuple for a plant with several channels.
        wind: A ``Vec3`` [m/s] for flying plants; None: there is no wind.
        inputs: The disturbances at the inputs that the plant names, in the plant's order.
        condition: The changes that events have made to a vehicle, a :class:`dssc_jax.core.events.Condition`; None: no
            event has happened.
    """

    command: Signal
    disturbance: Signal
    wind: State = None
    inputs: Signals = ()
    condition: State = None


class Outcome(IntEnum):
    """How a draw ended.

    ``REQUIREMENT + i`` means that the draw completed, and that requirement i, counted from 0 in the study's order, is
    the first one that it violates.
    """

    OK = 0  # the draw completed, and meets all requirements
    NON_FINITE = 1  # the state became infinite or NaN
    SINGULAR_ATTITUDE = 2  # the model of the plant was no longer valid
    INTO_GROUND = 3  # the vehicle flew into the ground
    REQUIREMENT = 10


class TrackingError(NamedTuple):
    """The tracking error of one channel.

    Args:
        e: Output error e = y - y_m (9) [y].
        sigma: Output of relative degree one sigma = e' + l_0 e (10) [y/s].
    """

    e: Scalar
    sigma: Scalar


def tracking_error(measurement: Measurement, reference: ReferencePoint, l0: Scalar) -> TrackingError:
    """Return e and sigma by equations (9) and (10).

    Args:
        measurement: y and y'.
        reference: y_m and y_m'.
        l0: Error pole l_0 [1/s].
    """
    e = measurement.y - reference.y
    return TrackingError(e, measurement.y_dot - reference.y_dot + l0 * e)
