"""A study's plant at its start, with the linear actuators before it, sampled exactly; and the loop with a controller.

The plant is linearised at its start. The actuators that declare themselves linear (lags, transfer functions, delays)
stay before it; the others count as a gain of 1, and are named. With the command held, the whole is one discrete system,
x(k+1) = A x(k) + B u(k). It follows from one matrix exponential of the plant and the actuators in continuous time, and
from the derivative of what the others do at a sample.
"""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.core.chains import chain
from dssc_jax.core.contracts import Controller, Unmodelled
from dssc_jax.core.influences import closure
from dssc_jax.core.numerics import arithmetic, as_vector
from dssc_jax.core.sampled_linear import LinearSystem
from dssc_jax.core.signals import Measurement, Params, ReferencePoint, Scalar
from dssc_jax.design.linearised_plant import LinearisedPlant
from dssc_jax.models.controllers.linear_quadratic import sampled_system
from dssc_jax.study.actuators import acting_elements
from dssc_jax.study.components import Component
from dssc_jax.study.fitting import nominal_params
from dssc_jax.study.study import Study

GRID = 600  # frequencies of the sensitivity's peak
DECADES = 6.0  # decades of this grid, below the Nyquist frequency
SETTLED = 0.02  # share of the largest distance from the end
FADED = 7.0  # time constants of the slowest pole, over which an output is looked at
INSTANTS = 2000


class LinearPlant(NamedTuple):
    """Plant and linear actuators, sampled: x(k+1) = A x + B u, y = c x; the first entries of x are the plant's state.

    Args:
        a: Shape (n, n).
        b: Shape (n,).
        c: Shape (n,).
        rate: Row of y', shape (n,).
        signals: Rows of the measured signals, shape (m, n).
        sample_time: T_s [s].
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    rate: np.ndarray
    signals: np.ndarray
    sample_time: float

    def response(self, omega: float) -> complex:
        """The frequency response from the held command to the sampled output, at an angular frequency [rad/s]."""
        z = np.exp(1j * omega * self.sample_time)
        return complex(self.c @ np.linalg.solve(z * np.eye(len(self.a)) - self.a, self.b))


class LinearActuators(NamedTuple):
    """The actuators of a study that declare themselves linear, in series; they belong to the linearised loop.

    Args:
        model: All of them as one actuator; None: there are none.
        params: Parameters of the model, without laws.
        linear_kinds: Kinds of these actuators.
        left_out: Kinds of the parts that the linearised loop lacks: all other actuators, sensors, a differentiator.
    """

    model: Unmodelled | None
    params: Params
    linear_kinds: tuple[str, ...]
    left_out: tuple[str, ...]


class ClosedLoop(NamedTuple):
    """The sampled closed loop x(k+1) = A x + b w, u = c x, with w added to the command u.

    Args:
        a: A, shape (n, n).
        b: Shape (n,).
        c: Shape (n,).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    @property
    def radius(self) -> float:
        """Largest modulus of its poles."""
        return float(np.max(np.abs(np.linalg.eigvals(self.a))))

    @property
    def sensitivity_peak(self) -> float:
        """Largest |S| up to the Nyquist frequency, with the sensitivity S = 1 + c (z - A)^-1 b of the command."""
        angles = np.append(
            np.geomspace(np.pi * 10.0**-DECADES, np.pi, GRID), np.abs(np.angle(np.linalg.eigvals(self.a)))
        )
        identity = np.eye(len(self.a))
        z = np.exp(1j * angles)[:, None, None]
        state_response = np.linalg.solve(z * identity - self.a, self.b[:, None])[..., 0]
        return float(np.max(np.abs(1.0 + state_response @ self.c)))

    def settling(self, row: np.ndarray) -> float:
        """Samples after which an output stays near its final value, after a step is added to the command.

        Near is within 2 % of the largest distance from it. Infinite if the loop is unstable.

        Args:
            row: Row from the state to the output, shape (n,).
        """
        if self.radius >= 1.0:
            return math.inf
        order = len(self.a)
        steady = np.linalg.solve(np.eye(order) - self.a, self.b)
        decay = -math.log(max(self.radius, np.finfo(float).tiny))
        stride = max(1, math.ceil(FADED / (decay * INSTANTS)))
        stride_transition = np.linalg.matrix_power(self.a, stride)
        distance = np.empty(INSTANTS)
        state = -steady
        for k in range(INSTANTS):
            distance[k] = abs(row @ state)
            state = stride_transition @ state
        outside = np.flatnonzero(distance > SETTLED * np.max(distance))
        return float(stride * (outside[-1] + 1)) if outside.size else 0.0


class DesignProblem(NamedTuple):
    """The plant and the actuators for which first gains are designed.

    Args:
        study: The study.
        plant: The plant, linearised in continuous time.
        bare_plant: The plant, sampled without actuators.
        actuators: The linear actuators.
        actuated_plant: The plant, sampled behind the linear actuators.
        limit: Largest magnitude of the command, in its unit; None: the command has no limit.
    """

    study: Study
    plant: LinearisedPlant
    bare_plant: LinearPlant
    actuators: LinearActuators
    actuated_plant: LinearPlant
    limit: float | None


def linear_actuators(study: Study) -> LinearActuators:
    """The linear actuators of a study of one channel, in series as one actuator, and the kinds of the parts left out.

    Left out are sensors and actuators for which superposition does not hold.
    """
    linear_elements = []
    left_out = measuring_kinds(study)
    for element, params in acting_elements(study.table, study.config):
        if element.model.linear is not None or element.model.superposes:
            linear_elements.append((element, nominal_params(params)))
        else:
            left_out.append(element.kind)
    if not linear_elements:
        return LinearActuators(None, (), (), tuple(left_out))
    model, params = linear_elements[0][0].model, linear_elements[0][1]
    if len(linear_elements) > 1:
        model = chain(tuple(element for element, _ in linear_elements))
        params = tuple(params for _, params in linear_elements)
    return LinearActuators(model, params, tuple(element.kind for element, _ in linear_elements), tuple(left_out))


def measuring_kinds(study: Study) -> list[str]:
    """Slot and kind of the sensors and the differentiator between plant and controller, but for ideal ones."""
    config = study.config
    kinds = []
    for slot, neutral in (("sensor", "ideal"), ("differentiator", "none")):
        kind = getattr(config, slot).get("kind", neutral)
        if kind != neutral:
            kinds.append(f"{slot} '{kind}'")
    for signal in study.loop.measures:
        kind = config.sensor.get(signal.name, {}).get("kind", "ideal")
        if kind != "ideal":
            kinds.append(f"sensor '{kind}' of {signal.name}")
    return kinds


def sampled_plant(plant: LinearisedPlant, actuators: LinearActuators, sample_time: float) -> LinearPlant:
    """The plant behind the linear actuators, sampled with a held command.

    The state lists that of the plant, that of the actuators, and what their part that acts at the samples gave over the
    last sample. A signal through which the command passes shows what reached the plant just before the sample.
    """
    n = len(plant.a)
    at_sample = actuators_at_sample(actuators, sample_time)
    system = at_sample.system
    order = len(system.a)
    total = n + order
    a = np.zeros((total, total))
    a[:n, :n] = plant.a
    a[:n, n:] = np.outer(plant.b, system.c)
    a[n:, n:] = system.a
    held_system = sampled_system(a, np.append(plant.b * system.d, system.b)[:, None], sample_time)
    after_sample = np.zeros((total, total + 1))  # the state with which the sample begins, of the state and of u
    after_sample[:n, :n] = np.eye(n)
    after_sample[n:, n:] = np.column_stack([at_sample.state, at_sample.state_input])
    drive_row = np.concatenate([np.zeros(n), at_sample.output @ at_sample.state])
    drive_input = float(at_sample.output @ at_sample.state_input) + at_sample.output_input
    sampled = held_system.a @ after_sample + np.outer(held_system.b, np.append(drive_row, drive_input))
    transition = np.zeros((total + 1, total + 1))
    transition[:total, :total] = sampled[:, :total]
    transition[total, :total] = drive_row
    plant_input_row = np.concatenate([np.zeros(n), system.c, [system.d]])

    def padded(row: np.ndarray) -> np.ndarray:
        return np.append(row, np.zeros(order + 1))

    signals = [padded(row) + d * plant_input_row for row, d in zip(plant.signals, plant.feedthrough, strict=True)]
    return LinearPlant(
        a=transition,
        b=np.append(sampled[:, total], drive_input),
        c=padded(plant.c),
        rate=padded(plant.rate) + plant.rate_through * plant_input_row,
        signals=np.reshape(signals, (len(signals), total + 1)),
        sample_time=sample_time,
    )


class SystemArrays(NamedTuple):
    """The linear system x' = A x + b u, y = c x + d u, as arrays."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: float


class ActuatorsAtSample(NamedTuple):
    """Linear actuators at a sample, z <- S z + s u and v = V z + w u, and the system that v drives until the next one.

    Args:
        state: S, shape (n, n).
        state_input: s, shape (n,).
        output: V, shape (n,), of the state after the sample.
        output_input: w.
        system: From v to what reaches the plant; its state is z.
    """

    state: np.ndarray
    state_input: np.ndarray
    output: np.ndarray
    output_input: float
    system: SystemArrays


def actuators_at_sample(actuators: LinearActuators, sample_time: float) -> ActuatorsAtSample:
    """The matrices of linear actuators at a sample, and their system between samples.

    They are the derivatives of the actuators' functions, which are the same at every state.
    """
    model, params = actuators.model, actuators.params
    if model is None:
        return ActuatorsAtSample(np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0, as_arrays(None, 0))
    with arithmetic():
        start, unravel = as_vector(model.init(params))
        key = jax.random.key(0)

        def sample(z: jax.Array, u: Scalar) -> jax.Array:
            return ravel_pytree(model.sample(params, unravel(z), u, key, sample_time))[0]

        def driving(z: jax.Array, u: Scalar) -> Scalar:
            if model.advance is not None:
                _, moments = model.advance(params, sample_time)(unravel(z), u)
                return jnp.asarray(moments.mean, float)
            return jnp.asarray(u if model.linear is not None else model.output(params, unravel(z), u), float)

        state, state_input = map(np.asarray, jax.jit(jax.jacfwd(sample, argnums=(0, 1)))(start, 0.0))
        output, output_input = map(np.asarray, jax.jit(jax.jacfwd(driving, argnums=(0, 1)))(start, 0.0))
        system = as_arrays(model.linear(params) if model.linear is not None else None, len(start))
    return ActuatorsAtSample(state, state_input, output, float(output_input), system)


def as_arrays(system: LinearSystem | None, order: int) -> SystemArrays:
    """A linear system as arrays; None: a gain of 1, and ``order`` states that stand still."""
    if system is None:
        return SystemArrays(np.zeros((order, order)), np.zeros(order), np.zeros(order), 1.0)
    a, b, c = (np.asarray(part, float) for part in system[:3])
    return SystemArrays(a, b, c, float(system.d))


def closed_loop(plant: LinearPlant, controller: Component) -> ClosedLoop:
    """The sampled loop of a linear plant and a controller, which is linearised at its second sample at rest.

    States of the controller that do not move or have no effect are left out: an integral without k_i would be a pole
    at 1.
    """
    model: Controller = controller.model
    gains = controller.params
    dt = plant.sample_time
    rows = np.vstack([plant.c, plant.rate, plant.signals])
    with arithmetic():

        def sample(state: Any, outputs: jax.Array) -> tuple[Any, Scalar]:
            measurement = Measurement(outputs[0], outputs[1], tuple(outputs[2:]))
            next_state, command, _ = model.step(gains, state, measurement, ReferencePoint(0.0, 0.0, 0.0), dt)
            return next_state, command.total

        zero_outputs = jnp.zeros(len(rows))
        start = model.init(gains, Measurement(0.0, 0.0, tuple(zero_outputs[2:])), ReferencePoint(0.0, 0.0, 0.0))
        start, _ = sample(jax.tree.map(lambda leaf: jnp.asarray(leaf, float), start), zero_outputs)
        start_vector, unravel = ravel_pytree(start)

        def flat_sample(state: jax.Array, outputs: jax.Array) -> jax.Array:
            next_state, command = sample(unravel(state), outputs)
            return jnp.append(ravel_pytree(next_state)[0], command)

        slopes_of = jax.jit(jax.jacfwd(flat_sample, argnums=(0, 1)))
        state_slopes, output_slopes = map(np.asarray, slopes_of(start_vector, zero_outputs))
    state_influences = state_slopes[:-1] != 0.0
    driven_states = np.any(output_slopes[:-1] != 0.0, axis=1)
    moving_states = closure(driven_states, state_influences.T)
    effective_states = moving_states & closure(state_slopes[-1] != 0.0, state_influences)  # no integral without k_i
    state_slopes, output_slopes = (
        state_slopes[np.append(effective_states, True)][:, effective_states],
        output_slopes[np.append(effective_states, True)],
    )
    order = int(np.count_nonzero(effective_states))
    command = np.append(output_slopes[order] @ rows, state_slopes[order])
    a = np.block([[plant.a, np.zeros((len(plant.a), order))], [output_slopes[:order] @ rows, state_slopes[:order]]])
    b = np.append(plant.b, np.zeros(order))
    return ClosedLoop(a + np.outer(b, command), b, command)
