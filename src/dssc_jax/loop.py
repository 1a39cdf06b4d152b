"""The closed loop of one draw, sample by sample: measure, control, hold, substeps."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.integrators import INTEGRATORS, Integrator
from dssc_jax.metrics import Instant, Sample
from dssc_jax.numerics import stream, wrap_angle
from dssc_jax.tracking import tracking_error
from dssc_jax.types import (
    Command,
    Controller,
    Differentiator,
    Disturbance,
    Measurement,
    Plant,
    PlantInput,
    Reference,
    ReferencePoint,
    Scalar,
    Sensor,
    State,
    Unmodelled,
    Wind,
)

UNROLLED = 2  # substeps at most that are traced one by one


class LoopParams(NamedTuple):
    """Parameters of every part of the loop; any number may be traced.

    Those of controller, sensor, differentiator, unmodelled dynamics and disturbance are tuples, one a channel.
    """

    plant: Any
    reference: Any
    wind: Any
    controller: tuple[Any, ...]
    sensor: tuple[Any, ...]
    differentiator: tuple[Any, ...]
    unmodelled: tuple[Any, ...]
    disturbance: tuple[Any, ...]


class Settled(NamedTuple):
    """When a draw is over before its time: from ``after`` on, |e| <= ``error`` in every channel for ``hold``.

    Args:
        error: Bound of |e| [m; rad for psi].
        hold: For how long [s].
        after: From when on [s].
    """

    error: float
    hold: float
    after: float


@dataclass(frozen=True)
class Loop:
    """What is chosen before tracing: the models in the loop's named slots, and the clock.

    Args:
        channels: Names of the channels; one empty name for a plant of one.
        sample_time: T_s [s].
        steps: Number of samples.
        substeps: Integrator steps between two samples.
        settled: When a draw is over before its time; None: never.
    """

    plant: Plant
    reference: Reference
    wind: Wind
    controller: tuple[Controller, ...]
    sensor: tuple[Sensor, ...]
    differentiator: tuple[Differentiator, ...]
    unmodelled: tuple[Unmodelled, ...]
    disturbance: tuple[Disturbance, ...]
    channels: tuple[str, ...]
    sample_time: float
    steps: int
    substeps: int = 1
    integrator: Integrator = Integrator.RK4
    settled: Settled | None = None

    def key(self, draw: jax.Array, slot: str, channel: str = "") -> jax.Array:
        """The random stream of a slot in a channel, of the draw's key."""
        return jax.random.fold_in(draw, stream(f"{slot}.{channel}" if channel else slot))


class ChannelState(NamedTuple):
    """State of one channel's parts, and its last robust command."""

    controller: State
    sensor: State
    differentiator: State
    unmodelled: State
    disturbance: State
    u: Scalar


class LoopState(NamedTuple):
    """State of the plant, the wind, and every channel."""

    plant: State
    wind: State
    channels: tuple[ChannelState, ...]


class Recorded(NamedTuple):
    """One sample as a trajectory shows it; ``finite`` and ``whole`` tell how the step to the next sample went.

    ``measurements`` are the plant's own, before sensors.
    """

    instant: Instant
    measurements: tuple[Measurement, ...]
    references: tuple[ReferencePoint, ...]
    finite: Scalar
    whole: Scalar


def as_arrays(tree: Any) -> Any:
    """Every leaf as an array of the working precision, so that the scan's carry keeps its types."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype=jnp.result_type(float)), tree)


def each(value: Any) -> tuple[Any, ...]:
    """One value a channel: a plain measurement, reference point or number stands for a plant of one channel."""
    return value if type(value) is tuple else (value,)


def joined(values_: tuple[Any, ...]) -> Any:
    """The inverse of :func:`each`, for what the plant is given."""
    return values_[0] if len(values_) == 1 else values_


def measured(
    loop: Loop, params: LoopParams, plant: State, references: tuple[ReferencePoint, ...]
) -> tuple[Measurement, ...]:
    """The plant's measurements; an angle is shifted by whole turns to lie within pi of its reference."""
    found = each(loop.plant.measure(params.plant, plant))
    return tuple(
        m._replace(y=r.y + wrap_angle(m.y - r.y)) if name in loop.plant.angles else m
        for name, m, r in zip(loop.channels, found, references, strict=True)
    )


def start(loop: Loop, params: LoopParams, key: jax.Array) -> LoopState:
    """State at t = 0."""
    plant = as_arrays(loop.plant.init(params.plant))
    references = each(loop.reference.at(params.reference, 0.0))
    measurements = measured(loop, params, plant, references)
    channels = []
    for i, name in enumerate(loop.channels):
        stream_key = loop.key(key, "sensor", name)
        sensor = loop.sensor[i].init(params.sensor[i], measurements[i], jax.random.fold_in(stream_key, 0))
        # the controller starts from what it will see at the first sample, not from the truth
        first = jax.random.fold_in(stream_key, 1)
        _, seen = loop.sensor[i].step(params.sensor[i], sensor, measurements[i], first, 0.0, loop.sample_time)
        differentiator = loop.differentiator[i].init(params.differentiator[i], seen)
        _, seen = loop.differentiator[i].step(params.differentiator[i], differentiator, seen, loop.sample_time)
        channels.append(
            ChannelState(
                controller=loop.controller[i].init(params.controller[i], seen, references[i]),
                sensor=sensor,
                differentiator=differentiator,
                unmodelled=loop.unmodelled[i].init(params.unmodelled[i]),
                disturbance=loop.disturbance[i].init(
                    params.disturbance[i], jax.random.fold_in(loop.key(key, "disturbance", name), 0)
                ),
                u=0.0,
            )
        )
    wind = loop.wind.init(params.wind, jax.random.fold_in(loop.key(key, "wind"), 0))
    return as_arrays(LoopState(plant, wind, tuple(channels)))


def hold(
    loop: Loop, params: LoopParams, state: LoopState, commands: tuple[Scalar, ...], t: Scalar
) -> tuple[State, tuple[State, ...]]:
    """Advance plant and unmodelled dynamics over one sample with the commands held.

    The unmodelled dynamics are known at the start, middle and end of a substep, as the integrator asks. Few substeps
    are traced one by one; of many only one is, since compilation takes as long as what is traced.
    """
    h = loop.sample_time / loop.substeps
    integrate = INTEGRATORS[loop.integrator]

    def lagged(states: tuple[State, ...]) -> tuple[State, ...]:
        parts = zip(loop.unmodelled, params.unmodelled, states, commands, strict=True)
        return tuple(model.step(p, z, u, 0.5 * h) for model, p, z, u in parts)

    def reaching(states: tuple[State, ...]) -> tuple[Scalar, ...]:
        parts = zip(loop.unmodelled, params.unmodelled, states, commands, strict=True)
        return tuple(model.output(p, z, u) for model, p, z, u in parts)

    def substep(index: Scalar, at: tuple[State, tuple[State, ...]]) -> tuple[State, tuple[State, ...]]:
        plant, lags = at
        middle = lagged(lags)
        end = lagged(middle)
        stages = [(t + (index + fraction) * h, reaching(z)) for fraction, z in ((0.0, lags), (0.5, middle), (1.0, end))]

        def derivative(plant: State, half_steps: int) -> State:
            now, arriving = stages[half_steps]
            drive = driven(loop, params, state, plant, arriving, now)
            return loop.plant.derivative(params.plant, plant, drive, now)

        return loop.plant.project(params.plant, integrate(derivative, plant, h, loop.plant.velocities)), end

    at = state.plant, tuple(channel.unmodelled for channel in state.channels)
    if loop.substeps > UNROLLED:
        return jax.lax.fori_loop(0, loop.substeps, lambda index, at: as_arrays(substep(index, at)), as_arrays(at))
    for index in range(loop.substeps):
        at = substep(index, at)
    return at


def driven(
    loop: Loop, params: LoopParams, state: LoopState, plant: State, commands: tuple[Scalar, ...], now: Scalar
) -> PlantInput:
    """What drives the plant at a stage: commands, disturbances of its present state, wind."""
    references = each(loop.reference.at(params.reference, now))
    measurements = measured(loop, params, plant, references)
    disturbances = []
    for i, channel in enumerate(state.channels):
        sigma = tracking_error(measurements[i], references[i], params.controller[i].l0).sigma
        model, held = loop.disturbance[i], channel.disturbance
        disturbances.append(model.value(params.disturbance[i], held, measurements[i], sigma, now))
    wind = loop.wind.value(params.wind, state.wind, now)
    return PlantInput(joined(commands), joined(tuple(disturbances)), wind)


def all_finite(state: LoopState) -> Scalar:
    """Whether the sum of squares of the whole state is finite: squares are what metrics accumulate."""
    return jnp.isfinite(sum(jnp.square(leaf) for leaf in jax.tree.leaves(state)))


def control(
    loop: Loop,
    params: LoopParams,
    key: jax.Array,
    channel: ChannelState,
    i: int,
    measurement: Measurement,
    reference: ReferencePoint,
    k: Scalar,
) -> tuple[ChannelState, Command, Any]:
    """One channel's sample: sensor, differentiator, controller, and what the disturbance holds."""
    t, dt, name = k * loop.sample_time, loop.sample_time, loop.channels[i]
    sensor, seen = loop.sensor[i].step(
        params.sensor[i],
        channel.sensor,
        measurement,
        jax.random.fold_in(loop.key(key, "sensor", name), k + 1),
        t,
        dt,
    )
    differentiator, seen = loop.differentiator[i].step(params.differentiator[i], channel.differentiator, seen, dt)
    controller, command, info = loop.controller[i].step(params.controller[i], channel.controller, seen, reference, dt)
    disturbance = loop.disturbance[i].step(
        params.disturbance[i],
        channel.disturbance,
        jax.random.fold_in(loop.key(key, "disturbance", name), k + 1),
        t,
        dt,
    )
    after = ChannelState(controller, sensor, differentiator, channel.unmodelled, disturbance, command.robust)
    return after, command, info


def step(loop: Loop, params: LoopParams, key: jax.Array, state: LoopState, k: Scalar) -> tuple[LoopState, Recorded]:
    """One sample: measure, control, hold."""
    dt = loop.sample_time
    t = k * dt
    references = each(loop.reference.at(params.reference, t))
    measurements = measured(loop, params, state.plant, references)
    gains = each(loop.plant.input_gain(params.plant))
    channels, samples, commands = [], [], []
    for i, channel in enumerate(state.channels):
        m, r = measurements[i], references[i]
        after, command, info = control(loop, params, key, channel, i, m, r, k)
        error = tracking_error(m, r, params.controller[i].l0)
        samples.append(
            Sample(
                k=k,
                dt=dt,
                e=error.e,
                sigma=error.sigma,
                u=command.robust,
                u_previous=jnp.where(k == 0, command.robust, channel.u),
                u_total=command.total,
                k_p=gains[i],
                info=info,
            )
        )
        sampled = loop.unmodelled[i].sample(params.unmodelled[i], channel.unmodelled, command.total, dt)
        channels.append(after._replace(unmodelled=sampled))
        commands.append(command.total)
    wind = loop.wind.step(params.wind, state.wind, jax.random.fold_in(loop.key(key, "wind"), k + 1), t, dt)
    held = LoopState(state.plant, wind, tuple(channels))
    plant, lags = hold(loop, params, held, tuple(commands), t)
    reaching = tuple(
        model.output(p, c.unmodelled, u)
        for model, p, c, u in zip(loop.unmodelled, params.unmodelled, channels, commands, strict=True)
    )
    seen = loop.plant.monitor(params.plant, state.plant, driven(loop, params, held, state.plant, reaching, t))
    after = as_arrays(
        LoopState(plant, wind, tuple(c._replace(unmodelled=z) for c, z in zip(channels, lags, strict=True)))
    )
    whole = jnp.logical_not(loop.plant.broken(params.plant, after.plant))
    instant = Instant(t, dt, tuple(samples), seen)
    return after, Recorded(instant, measurements, references, all_finite(after), whole)
