"""The vocabulary: what a number means, what crosses the borders of a model, and the contracts of models.

A model is a ``NamedTuple`` of pure functions for one draw, without a batch axis, and the ``NamedTuple`` type
of its parameters. It is chosen before tracing; its parameters may be traced. Every parameter field is
annotated with a :class:`Quantity`, from which study files are validated.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import Any, NamedTuple, TypeAlias

import jax

Scalar: TypeAlias = jax.Array | float
Params: TypeAlias = Any
State: TypeAlias = Any
Info: TypeAlias = Any
Progress: TypeAlias = Callable[[int, int], None]
"""Called with what is done so far, in lanes or steps, and with how much there is in all."""


@dataclass(frozen=True)
class Quantity:
    """Unit, meaning and admissible interval of one number of a model.

    Args:
        unit: SI unit; ``"1"`` when dimensionless.
        meaning: The standard term, with the paper's symbol.
        above: Exclusive lower bound.
        at_least: Inclusive lower bound.
        below: Exclusive upper bound.
        at_most: Inclusive upper bound.
        law: Whether a probability law may stand in place of the number.
    """

    unit: str
    meaning: str
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    law: bool = True

    def violated_by(self, low: float, high: float) -> str | None:
        """The rule that the interval [low, high] breaks, or None."""
        if self.above is not None and not low > self.above:
            return f"must be > {self.above:g}"
        if self.at_least is not None and not low >= self.at_least:
            return f"must be >= {self.at_least:g}"
        if self.below is not None and not high < self.below:
            return f"must be < {self.below:g}"
        if self.at_most is not None and not high <= self.at_most:
            return f"must be <= {self.at_most:g}"
        return None


@dataclass(frozen=True)
class Slot:
    """Marks a parameter field that holds a part chosen by ``kind`` from ``registry``.

    A part is a ``NamedTuple`` of numbers with methods; its type tells the step what to compute, so that nothing
    is decided while tracing.

    Args:
        registry: The kinds that may stand here.
        number: The kind that a bare number stands for (its first field takes it).
        default: The kind when the table names none; without one, ``kind`` is required.
    """

    registry: "Registry"
    number: str | None = None
    default: str | None = None


class Measurement(NamedTuple):
    """What the controller sees of the plant: output ``y`` [m] and its derivative ``y_dot`` [m/s]."""

    y: Scalar
    y_dot: Scalar


class ReferencePoint(NamedTuple):
    """Desired output ``y`` = y_m [m] with first and second derivative [m/s], [m/s^2]."""

    y: Scalar
    y_dot: Scalar
    y_ddot: Scalar


class Command(NamedTuple):
    """Plant input u_p of equation (11) in its two parts [m/s]."""

    robust: Scalar
    nominal: Scalar

    @property
    def total(self) -> Scalar:
        """u_p = u + u_n (11) [m/s]."""
        return self.robust + self.nominal


class PlantInput(NamedTuple):
    """What drives the plant: the command u_p after unmodelled dynamics, and the matched disturbance d [m/s].

    Both are scalars for a plant of one channel, and tuples in the order of its channels otherwise; ``wind`` is a
    ``Vec3`` [m/s] for plants that fly.
    """

    command: Any
    disturbance: Any
    wind: Any = None


def extent(value: Any) -> tuple[float, float]:
    """Lowest and highest value that a number, or a law that stands for it, can take."""
    support = getattr(value, "support", None)
    return support if support is not None else (float(value), float(value))


def nominal(value: Any) -> float:
    """A number, or the median of the law that stands for it."""
    return float(getattr(value, "median", value))


class NoParams(NamedTuple):
    """The parameters of a model that has none."""


def nothing(params: Params) -> Params:
    """The preparation that changes nothing."""
    return params


def as_it_is(params: Params, state: State) -> State:
    """The projection that changes nothing."""
    return state


def nothing_seen(params: Params, state: State, drive: PlantInput) -> tuple[()]:
    """The monitor that sees nothing."""
    return ()


def never(params: Params, state: State) -> bool:
    """The plant that does not break."""
    return False


def stateless(params: Params, key: jax.Array) -> tuple[()]:
    """The start of what has no state."""
    return ()


def unchanged(params: Params, state: State, key: jax.Array, t: Scalar, dt: Scalar) -> State:
    """The step of what holds nothing over a sample."""
    return state


def unsampled(params: Params, state: State, command: Scalar, dt: Scalar) -> State:
    """The state of what does not heed sample instants."""
    return state


class Plant(NamedTuple):
    """A plant of relative degree two from each command to its output.

    A plant of several channels (the UAV) names them; its measurement, input gain and input are then tuples in
    that order. A plant of one channel deals in plain values.

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params) -> state`` at t = 0.
        derivative: ``(params, state, input, t) -> state'``, the same structure as the state.
        measure: ``(params, state) -> Measurement``.
        input_gain: ``(params) -> k_p``, the high-frequency gain from command to y'' [1/s].
        velocities: Names of the state's fields that semi-implicit Euler advances first.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
        channels: Names of the channels; none for a plant of one.
        angles: Channels whose output is an angle: its error is wrapped to (-pi, pi].
        project: ``(params, state) -> state`` after each integrator step, back onto the state's manifold.
        monitor: ``(params, state, input) -> info`` at each sample, a NamedTuple for metrics and people.
        broken: ``(params, state) -> bool``: the model ends here (a singular attitude), the draw is frozen.
    """

    params: type
    init: Callable[[Params], State]
    derivative: Callable[[Params, State, PlantInput, Scalar], State]
    measure: Callable[[Params, State], Any]
    input_gain: Callable[[Params], Any]
    velocities: tuple[str, ...] = ()
    prepare: Callable[[Params], Params] = nothing
    channels: tuple[str, ...] = ()
    angles: tuple[str, ...] = ()
    project: Callable[[Params, State], State] = as_it_is
    monitor: Callable[[Params, State, PlantInput], Info] = nothing_seen
    broken: Callable[[Params, State], Any] = never


def angular_unit(unit: str) -> str:
    """A channel's unit where its output is an angle: rad in place of a leading metre."""
    return re.sub(r"^m\b", "rad", unit)


class Preset(NamedTuple):
    """A parameter type with an instance that a table overrides field by field."""

    params: type
    defaults: Any
    prepare: Callable[[Params], Params] = nothing


class Controller(NamedTuple):
    """A sampled controller.

    Args:
        gains: NamedTuple type of the gains; must have the field ``l0``.
        init: ``(gains, measurement, reference) -> state`` from the first sample.
        step: ``(gains, state, measurement, reference, dt) -> (state, command, info)``. ``info`` is a NamedTuple
            of scalars for people and metrics, and is never fed back.
        prepare: As in :class:`Plant`.
    """

    gains: type
    init: Callable[[Params, Measurement, ReferencePoint], State]
    step: Callable[[Params, State, Measurement, ReferencePoint, Scalar], tuple[State, Command, Info]]
    prepare: Callable[[Params], Params] = nothing

    @property
    def params(self) -> type:
        """The gains, under the name that all models share."""
        return self.gains


class Reference(NamedTuple):
    """A desired trajectory: ``at(params, t) -> ReferencePoint``, or a tuple of them, one a channel.

    ``defaults`` is an instance of the parameters that stands where a table is silent.
    """

    params: type
    at: Callable[[Params, Scalar], Any]
    prepare: Callable[[Params], Params] = nothing
    defaults: Any = None


class Disturbance(NamedTuple):
    """A matched disturbance d(y, y', t) [m/s].

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params, key) -> state``.
        step: ``(params, state, key, t, dt) -> state`` at each sample: what is held over [t, t + dt).
        value: ``(params, state, measurement, sigma, t) -> d``, evaluated in every stage of the integrator.
        prepare: As in :class:`Plant`.
    """

    params: type
    init: Callable[[Params, jax.Array], State]
    step: Callable[[Params, State, jax.Array, Scalar, Scalar], State]
    value: Callable[[Params, State, Measurement, Scalar, Scalar], Scalar]
    prepare: Callable[[Params], Params] = nothing


class Wind(NamedTuple):
    """Wind velocity in the inertial frame, z up [m/s].

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params, key) -> state``.
        step: ``(params, state, key, t, dt) -> state`` at each sample: what is held over [t, t + dt).
        value: ``(params, state, t) -> Vec3``, evaluated in every stage of the integrator.
        prepare: As in :class:`Plant`.
    """

    params: type
    init: Callable[[Params, jax.Array], State]
    step: Callable[[Params, State, jax.Array, Scalar, Scalar], State]
    value: Callable[[Params, State, Scalar], Any]
    prepare: Callable[[Params], Params] = nothing


class Sensor(NamedTuple):
    """A sensor between one channel of the plant and its controller.

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params, measurement, key) -> state`` from the first true measurement.
        step: ``(params, state, measurement, key, t, dt) -> (state, measurement)`` at each sample.
        prepare: As in :class:`Plant`.
    """

    params: type
    init: Callable[[Params, Measurement, jax.Array], State]
    step: Callable[[Params, State, Measurement, jax.Array, Scalar, Scalar], tuple[State, Measurement]]
    prepare: Callable[[Params], Params] = nothing


class Differentiator(NamedTuple):
    """Makes y' of y where only y is measured; stands between sensor and controller.

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params, measurement) -> state`` from the first measurement, whose velocity is not to be used.
        step: ``(params, state, measurement, dt) -> (state, measurement)`` at each sample.
        prepare: As in :class:`Plant`.
    """

    params: type
    init: Callable[[Params, Measurement], State]
    step: Callable[[Params, State, Measurement, Scalar], tuple[State, Measurement]]
    prepare: Callable[[Params], Params] = nothing


class Unmodelled(NamedTuple):
    """Unmodelled dynamics G_mu(mu s) in series with the plant input (Section V-A2).

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params) -> state`` at rest.
        step: ``(params, state, command, dt) -> state`` with the command held over dt.
        output: ``(params, state, command) -> command`` that reaches the plant.
        prepare: As in :class:`Plant`.
        sample: ``(params, state, command, dt) -> state`` once a sample of length dt, when its command is given.
    """

    params: type
    init: Callable[[Params], State]
    step: Callable[[Params, State, Scalar, Scalar], State]
    output: Callable[[Params, State, Scalar], Scalar]
    prepare: Callable[[Params], Params] = nothing
    sample: Callable[[Params, State, Scalar, Scalar], State] = unsampled


class Entry(NamedTuple):
    """One registry row: a model, or a family of which an option picks the member.

    Args:
        members: The model for each value of the option; a single model stands under the key ``None``.
        option: Name of the option's field, e.g. ``discretisation``.
        default: The option's value when the table does not give it.
        summary: One line for ``dssc-jax info``.
        silent: What a table is taken to say where it is silent.
    """

    members: dict[Any, Any]
    summary: str
    option: str | None = None
    default: Any = None
    silent: dict[str, Any] = {}  # noqa: RUF012  (never changed)


Registry: TypeAlias = dict[str, Entry]


def single(model: Any, summary: str) -> Entry:
    """A registry row without options."""
    return Entry({None: model}, summary)


class Discretisation(StrEnum):
    """How a continuous-time law is sampled; see docs/model.md, Sampling."""

    IMPLICIT = "implicit"
    EXPLICIT = "explicit"
    PROPER = "proper"


class Outcome(IntEnum):
    """How a draw ended. Requirement i (from 0) that fails first is coded ``REQUIREMENT + i``."""

    OK = 0
    NON_FINITE = 1
    SINGULAR_ATTITUDE = 2
    REQUIREMENT = 10
