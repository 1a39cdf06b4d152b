"""The closed loop of one draw: sample and hold, substeps, streaming metrics, and the freeze of a diverged draw."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.integrators import INTEGRATORS, Integrator
from dssc_jax.metrics import Measure, Sample, update_all, values
from dssc_jax.requirements import Requirement, judge
from dssc_jax.types import (
    Command,
    Controller,
    Disturbance,
    Measurement,
    Plant,
    PlantInput,
    Reference,
    ReferencePoint,
    Scalar,
    State,
    Unmodelled,
)


class LoopParams(NamedTuple):
    """Parameters of every part of the loop; any number may be traced."""

    plant: Any
    reference: Any
    controller: Any
    unmodelled: Any
    disturbance: Any


@dataclass(frozen=True)
class Loop:
    """What is chosen before tracing: the models in the loop's named slots, and the clock.

    Args:
        sample_time: T_s [s].
        steps: Number of samples.
        substeps: Integrator steps between two samples.
    """

    plant: Plant
    reference: Reference
    controller: Controller
    unmodelled: Unmodelled
    disturbance: Disturbance
    sample_time: float
    steps: int
    substeps: int = 1
    integrator: Integrator = Integrator.RK4


class LoopState(NamedTuple):
    """State of the parts, and the last robust command."""

    plant: State
    controller: State
    unmodelled: State
    disturbance: State
    u: Scalar


class Recorded(NamedTuple):
    """One sample as a trajectory shows it; ``finite`` tells whether the step to the next sample stayed finite."""

    t: Scalar
    measurement: Measurement
    reference: ReferencePoint
    sample: Sample
    finite: Scalar


class Run(NamedTuple):
    """A finished draw: metrics, margins, outcome code and the time of the first non-finite step (NaN: none)."""

    metrics: dict[str, Scalar]
    margins: dict[str, Scalar]
    outcome: Scalar
    failed_at: Scalar


def as_arrays(tree: Any) -> Any:
    """Every leaf as an array of the working precision, so that the scan's carry keeps its types."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype=jnp.result_type(float)), tree)


def start(loop: Loop, params: LoopParams, key: jax.Array) -> LoopState:
    """State at t = 0."""
    plant = as_arrays(loop.plant.init(params.plant))
    measurement = loop.plant.measure(params.plant, plant)
    reference = loop.reference.at(params.reference, 0.0)
    return as_arrays(
        LoopState(
            plant=plant,
            controller=loop.controller.init(params.controller, measurement, reference),
            unmodelled=loop.unmodelled.init(params.unmodelled),
            disturbance=loop.disturbance.init(params.disturbance, jax.random.fold_in(key, 0)),
            u=0.0,
        )
    )


def hold(
    loop: Loop, params: LoopParams, plant: State, unmodelled: State, disturbance: State, command: Scalar, t: Scalar
) -> tuple[State, State]:
    """Advance plant and unmodelled dynamics over one sample with the command held.

    The unmodelled dynamics are known at the start, middle and end of a substep, as the integrator asks.
    """
    h = loop.sample_time / loop.substeps
    integrate = INTEGRATORS[loop.integrator]
    for index in range(loop.substeps):
        middle = loop.unmodelled.step(params.unmodelled, unmodelled, command, 0.5 * h)
        end = loop.unmodelled.step(params.unmodelled, middle, command, 0.5 * h)
        reaching = [loop.unmodelled.output(params.unmodelled, z, command) for z in (unmodelled, middle, end)]
        times = [t + (index + fraction) * h for fraction in (0.0, 0.5, 1.0)]

        def derivative(state: State, half_steps: int, times: list = times, reaching: list = reaching) -> State:
            now = times[half_steps]
            measurement = loop.plant.measure(params.plant, state)
            reference = loop.reference.at(params.reference, now)
            sigma = measurement.y_dot - reference.y_dot + params.controller.l0 * (measurement.y - reference.y)
            d = loop.disturbance.value(params.disturbance, disturbance, measurement, sigma, now)
            return loop.plant.derivative(params.plant, state, PlantInput(reaching[half_steps], d), now)

        plant = integrate(derivative, plant, h, loop.plant.velocities)
        unmodelled = end
    return plant, unmodelled


def all_finite(state: LoopState) -> Scalar:
    """Whether the sum of squares of the whole state is finite: squares are what metrics accumulate."""
    return jnp.isfinite(sum(jnp.square(leaf) for leaf in jax.tree.leaves(state)))


def step(loop: Loop, params: LoopParams, key: jax.Array, state: LoopState, k: Scalar) -> tuple[LoopState, Recorded]:
    """One sample: measure, control, hold."""
    dt = loop.sample_time
    t = k * dt
    measurement = loop.plant.measure(params.plant, state.plant)
    reference = loop.reference.at(params.reference, t)
    controller, command, info = loop.controller.step(params.controller, state.controller, measurement, reference, dt)
    assert isinstance(command, Command)
    disturbance = loop.disturbance.step(params.disturbance, state.disturbance, jax.random.fold_in(key, k + 1), t, dt)
    plant, unmodelled = hold(loop, params, state.plant, state.unmodelled, disturbance, command.total, t)
    after = as_arrays(LoopState(plant, controller, unmodelled, disturbance, command.robust))
    e = measurement.y - reference.y
    sample = Sample(
        t=t,
        dt=dt,
        e=e,
        sigma=measurement.y_dot - reference.y_dot + params.controller.l0 * e,
        u=command.robust,
        u_previous=jnp.where(k == 0, command.robust, state.u),
        u_total=command.total,
        k_p=loop.plant.input_gain(params.plant),
        info=info,
    )
    return after, Recorded(t, measurement, reference, sample, all_finite(after))


class Progress(NamedTuple):
    """The scan's carry: next sample, state, accumulators, whether all has been finite, and for how many steps.

    The sample's index is carried, not scanned over: an array of indices would grow with the duration.
    """

    k: Scalar
    state: LoopState
    accumulators: tuple[Scalar, ...]
    finite: Scalar
    steps: Scalar


def simulate(
    loop: Loop,
    params: LoopParams,
    key: jax.Array,
    measures: tuple[Measure, ...] = (),
    requirements: tuple[Requirement, ...] = (),
    every: int | None = None,
) -> tuple[Run, Recorded | None]:
    """One draw from start to end.

    A draw that becomes non-finite is frozen at that step: state and accumulators keep their last finite values,
    its metrics are NaN and its margins -inf, and the batch goes on.

    Args:
        loop: The models and the clock.
        params: Their parameters.
        key: The draw's own random key.
        measures: What to measure.
        requirements: Bounds of some of the measures.
        every: Record every so-manieth sample; None: none, so that memory does not grow with the duration.

    Returns:
        The outcome, and the trajectory with leaves of shape (ceil(steps/every),), if any.
    """

    def sample(at: Progress, _: None = None) -> tuple[Progress, Recorded]:
        after, recorded = step(loop, params, key, at.state, at.k)
        updated = update_all(measures, at.accumulators, recorded.sample, at.k, loop.sample_time)
        finite = jnp.logical_and(at.finite, recorded.finite)
        state, accumulators = jax.tree.map(
            lambda new, old: jnp.where(finite, new, old), (after, updated), (at.state, at.accumulators)
        )
        return Progress(at.k + 1, state, accumulators, finite, at.steps + finite), recorded

    def block(at: Progress, _: None) -> tuple[Progress, Recorded]:
        last = jnp.minimum(at.k + (every or 1), loop.steps)
        at, recorded = sample(at)
        return jax.lax.while_loop(lambda at: at.k < last, lambda at: sample(at)[0], at), recorded

    count, zero = jnp.zeros((), dtype=jnp.int32), jnp.zeros((), dtype=jnp.result_type(float))
    at = Progress(count, start(loop, params, key), (zero,) * len(measures), jnp.asarray(True), count)
    if every is None:
        end, recorded = jax.lax.scan(lambda at, _: (sample(at)[0], None), at, length=loop.steps)
    elif every == 1:
        end, recorded = jax.lax.scan(sample, at, length=loop.steps)
    else:
        end, recorded = jax.lax.scan(block, at, length=-(-loop.steps // every))
    measured = values(measures, end.accumulators, loop.steps, loop.sample_time)
    outcome, margins = judge(requirements, measured, end.finite)
    run = Run(
        metrics={name: jnp.where(end.finite, value, jnp.nan) for name, value in measured.items()},
        margins=margins,
        outcome=outcome,
        failed_at=jnp.where(end.finite, jnp.nan, (end.steps + 1) * loop.sample_time),
    )
    return run, recorded
