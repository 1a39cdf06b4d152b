"""Signals between models: measurements, reference points, commands, plant inputs, tracking errors, outcomes."""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import jax

Scalar: TypeAlias = jax.Array | float

Params: TypeAlias = Any

State: TypeAlias = Any

Info: TypeAlias = Any

ProgressCallback: TypeAlias = Callable[[int, int | None], None]
"""Called with the number of finished lanes or steps and the total number; None: the total is not known."""


class Measurement(NamedTuple):
    """The plant's measurement: output ``y`` [m] and its derivative ``y_dot`` [m/s].

    What reaches a controller has the other measured ``signals`` as well, in the order of the study's ``measures``. The
    plant's own measurement, and what passes through sensor and differentiator of a channel, has none.
    """

    y: Scalar
    y_dot: Scalar
    signals: tuple[Scalar, ...] = ()


class ReferencePoint(NamedTuple):
    """Desired output ``y`` = y_m [m] with first and second derivative [m/s], [m/s^2]."""

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
    """Plant input u_p of equation (11) in its two parts [m/s]."""

    robust: Scalar
    nominal: Scalar

    @property
    def total(self) -> Scalar:
        """u_p = u + u_n (11) [m/s]."""
        return self.robust + self.nominal


class PlantInput(NamedTuple, Generic[Signal]):
    """The plant's input: the command u_p after unmodelled dynamics, and the matched disturbance d [m/s].

    Both are scalars for a plant with one channel, and tuples in the order of the channels otherwise; ``wind`` is a
    ``Vec3`` [m/s] for flying plants. ``inputs`` are the disturbances at the inputs that the plant names, in their
    order. ``condition`` is what events have made of a vehicle; None: nothing has happened.
    """

    command: Signal
    disturbance: Signal
    wind: State = None
    inputs: Signals = ()
    condition: State = None


class Outcome(IntEnum):
    """How a draw ended.

    ``REQUIREMENT + i``: the draw completed, and requirement i (from 0) is the first violated one in the study's order.
    """

    OK = 0
    NON_FINITE = 1
    SINGULAR_ATTITUDE = 2
    INTO_GROUND = 3
    REQUIREMENT = 10


class TrackingError(NamedTuple):
    """Output error e = y - y_m (9) [m] and the output of relative degree one sigma = e' + l_0 e (10) [m/s]."""

    e: Scalar
    sigma: Scalar


def tracking_error(measurement: Measurement, reference: ReferencePoint, l0: Scalar) -> TrackingError:
    """Equations (9) and (10)."""
    e = measurement.y - reference.y
    return TrackingError(e, measurement.y_dot - reference.y_dot + l0 * e)
