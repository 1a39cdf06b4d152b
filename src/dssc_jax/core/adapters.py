"""Models built from other models: for several channels, as sums, and from linear systems."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax

from dssc_jax.core.contracts import Disturbance, LinearDynamics, NoParams, Plant, Reference, Unmodelled, Variation
from dssc_jax.core.default_functions import unchanged_params
from dssc_jax.core.numerics import dot
from dssc_jax.core.sampled_linear import Forcing, LinearSystem, hold
from dssc_jax.core.signals import (
    LastChange,
    Measurement,
    Measurements,
    Params,
    PlantInput,
    ReferencePoint,
    ReferencePoints,
    Scalar,
    Signals,
    State,
)
from dssc_jax.core.smoothness import SMOOTH, Declaration, Substitution
from dssc_jax.core.vectors import Vec3
from dssc_jax.core.wind import Wind, WindBounds


def linear_derivative(
    linear: Callable[[Params], LinearDynamics],
) -> Callable[[Params, State, PlantInput[Scalar], Scalar], State]:
    """Return the ``derivative`` of a linear plant with one channel, from the plant's linear dynamics.

    The derivative is A x + b u_p + e d plus the sum of each named disturbance input times its column.
    """

    def derivative(params: Params, state: State, drive: PlantInput[Scalar], t: Scalar) -> State:
        """Return the derivative of the state; the time has no effect, since a linear plant does not change with it."""
        del t
        dynamics = linear(params)
        (command,) = dynamics.command
        (disturbance,) = dynamics.disturbance
        x, structure = jax.tree.flatten(state)
        signals = (*x, drive.command, drive.disturbance, *drive.inputs)
        columns = (command, disturbance, *dynamics.inputs[: len(drive.inputs)])
        slopes = []
        for i, row in enumerate(dynamics.a):
            entries = (column[i] for column in columns)
            slopes.append(dot((*row, *entries), signals))
        return structure.unflatten(slopes)

    return derivative


def quiet_inputs(plant: Plant, params: Params) -> Signals:
    """Return ``PlantInput.inputs`` for a plant on which no disturbance acts: a zero for each input that it names."""
    return (0.0,) * len(plant.inputs(params)) if plant.inputs else ()


def as_mimo_plant(plant: Plant[Measurement, Scalar]) -> Plant[Measurements, Signals]:
    """Adapt a plant with one channel to the interface of several channels: each signal becomes a tuple of one value."""

    def plain(drive: PlantInput[Signals]) -> PlantInput[Scalar]:
        """Return the input in the form that the plant itself takes: plain values in place of tuples of one value."""
        (command,) = drive.command
        (disturbance,) = drive.disturbance
        return PlantInput(command, disturbance, drive.wind, drive.inputs, drive.condition)

    remainder = plant.remainder  # None where the plant has none, as `advance` and `software`
    advance = plant.advance
    software = plant.software
    if software is not None:
        sample = software.sample
        software = software._replace(sample=lambda params, state, drive, dt: sample(params, state, plain(drive), dt))
    untyped_plant: Plant[Any, Any] = plant  # its replaced functions take and return tuples
    return untyped_plant._replace(
        derivative=lambda params, state, drive, t: plant.derivative(params, state, plain(drive), t),
        measure=lambda params, state, drive: (plant.measure(params, state, plain(drive)),),
        input_gain=lambda params: (plant.input_gain(params),),
        monitor=lambda params, state, drive: plant.monitor(params, state, plain(drive)),
        grounded=lambda params, state, drive, t, dt: plant.grounded(params, state, plain(drive), t, dt),
        remainder=remainder and (lambda params, state, drive, t: remainder(params, state, plain(drive), t)),
        software=software,
        advance=advance and (lambda params, state, drive, t, h: advance(params, state, plain(drive), t, h)),
    )


def as_mimo_reference(reference: Reference[ReferencePoint]) -> Reference[ReferencePoints]:
    """Adapt a reference with one channel to the interface of several channels: a point becomes a tuple of one point."""
    return Reference(
        params=reference.params,
        at=lambda params, t: (reference.at(params, t),),
        prepare=reference.prepare,
        last_change=reference.last_change,
    )


def with_channel_count(reference: Reference[ReferencePoints], count: int) -> Reference[ReferencePoints]:
    """Return a reference of several channels with ``count`` channels: cut, or extended by channels that stay at 0."""

    def at(params: Params, t: Scalar) -> ReferencePoints:
        """Return the desired points of ``count`` channels at t [s]."""
        points = tuple(reference.at(params, t))[:count]
        return points + (ReferencePoint(0.0, 0.0, 0.0),) * (count - len(points))

    return reference._replace(at=at)


class ReplacedParams(NamedTuple):
    """Parameters of :func:`replace_channels`.

    Args:
        joint: Parameters of the reference of all channels.
        replacements: Parameters of each channel's own reference, in the order of the replaced channels.
    """

    joint: Params
    replacements: tuple[Params, ...]


def replace_channels(
    joint: Reference[ReferencePoints], replacements: dict[int, Reference[ReferencePoint]]
) -> Reference:
    """Return a reference of several channels in which some channels have references of their own.

    Args:
        joint: The reference of all channels.
        replacements: The new reference of a channel, by the channel's index.
    """

    def at(params: ReplacedParams, t: Scalar) -> ReferencePoints:
        """Return the desired points of all channels at t [s]."""
        points = list(joint.at(params.joint, t))
        for (index, reference), channel_params in zip(replacements.items(), params.replacements, strict=True):
            points[index] = reference.at(channel_params, t)
        return tuple(points)

    joint_change = latest_change([joint, *replacements.values()])
    last_change = joint_change and (lambda params: joint_change((params.joint, *params.replacements)))
    return Reference(ReplacedParams, at, last_change=last_change)


def latest_change(parts: Sequence[Reference | Wind | Disturbance]) -> LastChange | None:
    """Return the ``last_change`` of several parts together: the latest of their last changes.

    Args:
        parts: The parts. The returned function takes a tuple of their parameters.

    Returns:
        The function; None if a part declares no last change.
    """
    changes = [part.last_change for part in parts if part.last_change is not None]
    if len(changes) < len(parts):
        return None
    return lambda params: max(change(values) for change, values in zip(changes, params, strict=True))


def separate_init(parts: Sequence[Wind | Disturbance]) -> Callable[[tuple[Params, ...], jax.Array], tuple[State, ...]]:
    """Return the ``init`` of several parts together, which returns a tuple of the parts' states.

    Each part draws its own random numbers, from the key folded with the part's index.
    """

    def init(params: tuple[Params, ...], key: jax.Array) -> tuple[State, ...]:
        """Return the state of each part before the first sample."""
        states = []
        for index, (part, part_params) in enumerate(zip(parts, params, strict=True)):
            states.append(part.init(part_params, jax.random.fold_in(key, index)))
        return tuple(states)

    return init


def separate_step(
    parts: Sequence[Wind | Disturbance],
) -> Callable[[tuple[Params, ...], tuple[State, ...], jax.Array, Scalar, Scalar], tuple[State, ...]]:
    """Return the ``step`` of several parts together, which returns a tuple of the parts' states.

    Each part draws its own random numbers, from the key folded with the part's index.
    """

    def step(
        params: tuple[Params, ...], state: tuple[State, ...], key: jax.Array, t: Scalar, dt: Scalar
    ) -> tuple[State, ...]:
        """Return the state of each part for the sample [t, t + dt)."""
        states = []
        for index, (part, part_params, part_state) in enumerate(zip(parts, params, state, strict=True)):
            states.append(part.step(part_params, part_state, jax.random.fold_in(key, index), t, dt))
        return tuple(states)

    return step


def sum_of_winds(parts: tuple[Wind, ...]) -> Wind:
    """Return the sum of several winds as one wind, whose parameters and state are tuples with an element a part."""

    def value(params: tuple[Params, ...], state: tuple[State, ...], t: Scalar) -> Vec3:
        """Return the sum of the parts' velocities at t [m/s]."""
        total = Vec3(0.0, 0.0, 0.0)
        for wind, wind_params, wind_state in zip(parts, params, state, strict=True):
            total = total + wind.value(wind_params, wind_state, t)
        return total

    def bounds(params: tuple[Params, ...]) -> WindBounds:
        """Return the sums of the parts' bounds; there is no bound of the rate if a part may jump."""
        parts_with_params = zip(parts, params, strict=True)
        limits = [wind.bounds(wind_params) for wind, wind_params in parts_with_params if wind.bounds is not None]
        rates = [limit.rate for limit in limits if limit.rate is not None]
        may_jump = len(rates) < len(parts)
        speed = sum(limit.speed for limit in limits)
        vertical = sum(limit.vertical for limit in limits)
        return WindBounds(speed, vertical, rate=None if may_jump else sum(rates))

    def mean(params: tuple[Params, ...], dt: Scalar) -> Vec3:
        """Return the sum of the parts' expected velocities over the first sample, of length dt [m/s]."""
        total = Vec3(0.0, 0.0, 0.0)
        for wind, wind_params in zip(parts, params, strict=True):
            total = total + wind.at_start(wind_params, dt)
        return total

    has_bounds = all(wind.bounds is not None for wind in parts)
    init = separate_init(parts)
    step = separate_step(parts)
    return Wind(
        params=NoParams,
        init=init,
        step=step,
        value=value,
        bounds=bounds if has_bounds else None,
        mean=mean,
        last_change=latest_change(parts),
    )


def sum_of_disturbances(parts: tuple[Disturbance, ...]) -> Disturbance:
    """Return the sum of several disturbances at one place as one disturbance.

    The parameters and the state of the sum are tuples with an element for each part. A single disturbance is returned
    unchanged, with its own parameters.
    """
    if len(parts) == 1:
        return parts[0]

    def value(
        params: tuple[Params, ...], state: tuple[State, ...], measurement: Measurement, sigma: Scalar, t: Scalar
    ) -> Scalar:
        """Return the sum of the parts' values, in the unit of the command [u]."""
        total: Scalar = 0.0
        for part, part_params, part_state in zip(parts, params, state, strict=True):
            total = total + part.value(part_params, part_state, measurement, sigma, t)
        return total

    by_dependence = list(Variation).index  # the members are in rising order of dependence
    variation = max((part.variation for part in parts), key=by_dependence)
    smooth = SMOOTH if all(part.smooth == SMOOTH for part in parts) else None
    init = separate_init(parts)
    step = separate_step(parts)
    return Disturbance(
        params=NoParams,
        init=init,
        step=step,
        value=value,
        variation=variation,
        smooth=smooth,
        last_change=latest_change(parts),
    )


def static_unmodelled(
    params: type,
    output: Callable[[Params, Scalar], Scalar],
    *,
    smooth: Declaration = None,
    continuous: bool = False,
    prepare: Callable[[Params], Params] = unchanged_params,
) -> Unmodelled:
    """Return unmodelled dynamics without a state, such as a saturation.

    Args:
        params: NamedTuple type of the parameters.
        output: ``(params, command) -> command`` that the plant receives.
        smooth: Where ``output`` has a derivative (:mod:`dssc_jax.core.smoothness`); None: not declared.
        continuous: Whether a model in continuous time has the same output.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
    """
    return Unmodelled(
        params,
        init=lambda params: (),
        step=lambda params, state, command, dt: state,
        output=lambda params, state, command: output(params, command),
        prepare=prepare,
        held=True,
        smooth=smooth,
        continuous=continuous,
    )


def unit_gain(params: type) -> Substitution:
    """Return the :data:`Substitution` of a static element by a gain of 1, for linearisations.

    Args:
        params: NamedTuple type of the element's parameters, which stay the same though the gain ignores them.
    """
    model = static_unmodelled(params, lambda params, command: command, smooth=SMOOTH, continuous=True)
    return lambda params: (model, params)


def linear_unmodelled(
    params: type,
    init: Callable[[Params], State],
    linear: Callable[[Params], LinearSystem],
    prepare: Callable[[Params], Params] = unchanged_params,
    time_constant: str = "",
) -> Unmodelled:
    """Return unmodelled dynamics that are a linear system, which advances by its exact solution over a step.

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params) -> state``, at rest; its leaves are the states of the system.
        linear: ``(params) -> LinearSystem`` from the command to the output.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
        time_constant: Name of the parameter that scales all times of the dynamics, such as mu of a lag; empty: none.
    """

    def step(values: Params, state: State, command: Scalar, dt: Scalar) -> State:
        """Return the state after the time dt [s] with the command held."""
        system = linear(values)
        x, structure = jax.tree.flatten(state)
        held_system = hold(system.a, (Forcing(system.b, terms=1),), dt)
        return structure.unflatten(held_system.full.apply(x, ((command,),)))

    def output(values: Params, state: State, command: Scalar) -> Scalar:
        """Return the output y = c x + d u, the command that reaches the plant."""
        system = linear(values)
        return dot((*system.c, system.d), (*jax.tree.leaves(state), command))

    return Unmodelled(
        params,
        init,
        step,
        output,
        prepare,
        linear=linear,
        smooth=SMOOTH,
        continuous=True,
        time_constant=time_constant,
    )
