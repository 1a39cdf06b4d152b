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
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.sampled_linear import LinearSystem
from dssc_jax.core.signals import Measurement, Params, ReferencePoint, Scalar
from dssc_jax.design.linearised_plant import LinearisedPlant
from dssc_jax.models.controllers.lqg import sampled_system
from dssc_jax.study.actuators import acting_elements
from dssc_jax.study.components import Component
from dssc_jax.study.fitting import nominal_params
from dssc_jax.study.study import Study

GRID = 600  # frequencies of the sensitivity's peak
DECADES = 6.0  # of this grid, below the Nyquist frequency
SETTLED = 0.02  # of the largest distance from the end
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
        """From the held command to the sampled output at an angular frequency [rad/s]."""
        z = np.exp(1j * omega * self.sample_time)
        return complex(self.c @ np.linalg.solve(z * np.eye(len(self.a)) - self.a, self.b))


class ActuatorsBefore(NamedTuple):
    """The actuators of a study: those in the linearised loop, and the kinds that are left out.

    Args:
        model: The linear ones as one; None: there are none.
        params: Their parameters, in plain numbers.
        taken: Their kinds.
        left_out: What the loop with these lacks: the kinds of all others, of sensors and of a differentiator.
    """

    model: Unmodelled | None
    params: Params
    taken: tuple[str, ...]
    left_out: tuple[str, ...]


class ClosedLoop(NamedTuple):
    """The sampled closed loop x(k+1) = A x + b w, u = c x, with w added to the command u; in plain numbers."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    @property
    def radius(self) -> float:
        """Largest modulus of its poles."""
        return float(np.max(np.abs(np.linalg.eigvals(self.a))))

    @property
    def sensitivity_peak(self) -> float:
        """Largest abs(S) up to the Nyquist frequency, S = 1 + c (z - A)^-1 b."""
        angles = np.append(
            np.geomspace(np.pi * 10.0**-DECADES, np.pi, GRID), np.abs(np.angle(np.linalg.eigvals(self.a)))
        )
        eye = np.eye(len(self.a))
        at = np.linalg.solve(np.exp(1j * angles)[:, None, None] * eye - self.a, self.b[:, None])[..., 0]
        return float(np.max(np.abs(1.0 + at @ self.c)))

    def settling(self, row: np.ndarray) -> float:
        """Samples after which an output stays near its end, after a step added to the command; infinite if unstable.

        Near is within 2 % of its largest distance from the end.

        Args:
            row: From the state to the output, shape (n,).
        """
        if self.radius >= 1.0:
            return math.inf
        order = len(self.a)
        steady = np.linalg.solve(np.eye(order) - self.a, self.b)
        decay = -math.log(max(self.radius, np.finfo(float).tiny))
        stride = max(1, math.ceil(FADED / (decay * INSTANTS)))
        over = np.linalg.matrix_power(self.a, stride)
        distance = np.empty(INSTANTS)
        state = -steady
        for k in range(INSTANTS):
            distance[k] = abs(row @ state)
            state = over @ state
        outside = np.flatnonzero(distance > SETTLED * np.max(distance))
        return float(stride * (outside[-1] + 1)) if outside.size else 0.0


class Subject(NamedTuple):
    """What first gains are made for.

    Args:
        study: The study.
        plant: Its plant at the start, in continuous time.
        alone: The same, sampled without actuators.
        actuators: Its actuators.
        whole: The plant sampled behind the linear ones.
        limit: Largest size of the command, in its unit; None: none.
    """

    study: Study
    plant: LinearisedPlant
    alone: LinearPlant
    actuators: ActuatorsBefore
    whole: LinearPlant
    limit: float | None


def actuators_before(study: Study) -> ActuatorsBefore:
    """The actuators of a study of one channel, those that declare themselves linear as one."""
    linear = []
    left_out = kinds_between(study)
    for element, params in acting_elements(study.table, study.config):
        if element.model.linear is not None or element.model.superposes:
            linear.append((element, nominal_params(params)))
        else:
            left_out.append(element.kind)
    if not linear:
        return ActuatorsBefore(None, (), (), tuple(left_out))
    model, params = linear[0][0].model, linear[0][1]
    if len(linear) > 1:
        model = chain(tuple(element for element, _ in linear))
        params = tuple(params for _, params in linear)
    return ActuatorsBefore(model, params, tuple(element.kind for element, _ in linear), tuple(left_out))


def kinds_between(study: Study) -> list[str]:
    """The parts between plant and controller that a linearised loop without them lacks."""
    config = study.config
    found = []
    for slot, neutral in (("sensor", "ideal"), ("differentiator", "none")):
        kind = getattr(config, slot).get("kind", neutral)
        found += [] if kind == neutral else [f"{slot} '{kind}'"]
    for signal in study.loop.measures:
        kind = config.sensor.get(signal.name, {}).get("kind", "ideal")
        found += [] if kind == "ideal" else [f"sensor '{kind}' of {signal.name}"]
    return found


def sampled_plant(plant: LinearisedPlant, actuators: ActuatorsBefore, sample_time: float) -> LinearPlant:
    """The plant behind the linear actuators with the command held over a sample.

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
    held = sampled_system(a, np.append(plant.b * system.d, system.b)[:, None], sample_time)
    after_sample = np.zeros((total, total + 1))  # the state with which the sample begins, of the state and of u
    after_sample[:n, :n] = np.eye(n)
    after_sample[n:, n:] = np.column_stack([at_sample.state, at_sample.state_input])
    acting = np.concatenate([np.zeros(n), at_sample.output @ at_sample.state])
    acting_input = float(at_sample.output @ at_sample.state_input) + at_sample.output_input
    stepped = held.a @ after_sample + np.outer(held.b, np.append(acting, acting_input))
    transition = np.zeros((total + 1, total + 1))
    transition[:total, :total] = stepped[:, :total]
    transition[total, :total] = acting
    reaching = np.concatenate([np.zeros(n), system.c, [system.d]])

    def wide(row: np.ndarray) -> np.ndarray:
        return np.append(row, np.zeros(order + 1))

    signals = [wide(row) + d * reaching for row, d in zip(plant.signals, plant.feedthrough, strict=True)]
    return LinearPlant(
        transition,
        np.append(stepped[:, total], acting_input),
        wide(plant.c),
        wide(plant.rate) + plant.rate_through * reaching,
        np.reshape(signals, (len(signals), total + 1)),
        sample_time,
    )


class SystemArrays(NamedTuple):
    """x' = A x + b u, y = c x + d u, in plain numbers."""

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


def actuators_at_sample(actuators: ActuatorsBefore, sample_time: float) -> ActuatorsAtSample:
    """The parts of linear actuators, by the derivative of what they do; it is the same at every state."""
    model, params = actuators.model, actuators.params
    if model is None:
        return ActuatorsAtSample(np.zeros((0, 0)), np.zeros(0), np.zeros(0), 1.0, as_arrays(None, 0))
    with arithmetic():
        begin, unravel = ravel_pytree(jax.tree.map(lambda leaf: jnp.asarray(leaf, float), model.init(params)))
        key = jax.random.key(0)

        def sample(z: jax.Array, u: Scalar) -> jax.Array:
            return ravel_pytree(model.sample(params, unravel(z), u, key, sample_time))[0]

        def driving(z: jax.Array, u: Scalar) -> Scalar:
            if model.advance is not None:
                return jnp.asarray(model.advance(params, sample_time)(unravel(z), u)[1].mean, float)
            return jnp.asarray(u if model.linear is not None else model.output(params, unravel(z), u), float)

        state, state_input = map(np.asarray, jax.jit(jax.jacfwd(sample, argnums=(0, 1)))(begin, 0.0))
        output, output_input = map(np.asarray, jax.jit(jax.jacfwd(driving, argnums=(0, 1)))(begin, 0.0))
        system = as_arrays(model.linear(params) if model.linear is not None else None, len(begin))
    return ActuatorsAtSample(state, state_input, output, float(output_input), system)


def as_arrays(system: LinearSystem | None, order: int) -> SystemArrays:
    """A system with arrays as its parts; None: a gain of 1, and states that stand still."""
    if system is None:
        return SystemArrays(np.zeros((order, order)), np.zeros(order), np.zeros(order), 1.0)
    a, b, c = (np.asarray(part, float) for part in system[:3])
    return SystemArrays(a, b, c, float(system.d))


def closed(plant: LinearPlant, controller: Component) -> ClosedLoop:
    """The loop with a controller, by the derivative of its second sample at rest."""
    model: Controller = controller.model
    gains = controller.params
    dt = plant.sample_time
    rows = np.vstack([plant.c, plant.rate, plant.signals])
    with arithmetic():

        def sample(state: Any, shown: jax.Array) -> tuple[Any, Scalar]:
            measurement = Measurement(shown[0], shown[1], tuple(shown[2:]))
            after, command, _ = model.step(gains, state, measurement, ReferencePoint(0.0, 0.0, 0.0), dt)
            return after, command.total

        quiet = jnp.zeros(len(rows))
        begin = model.init(gains, Measurement(0.0, 0.0, tuple(quiet[2:])), ReferencePoint(0.0, 0.0, 0.0))
        begin, _ = sample(jax.tree.map(lambda leaf: jnp.asarray(leaf, float), begin), quiet)
        at, unravel = ravel_pytree(begin)

        def flat(state: jax.Array, shown: jax.Array) -> jax.Array:
            after, command = sample(unravel(state), shown)
            return jnp.append(ravel_pytree(after)[0], command)

        of_state, of_shown = map(np.asarray, jax.jit(jax.jacfwd(flat, argnums=(0, 1)))(at, quiet))
    moves = of_state[:-1] != 0.0
    shown_states = np.any(of_shown[:-1] != 0.0, axis=1)
    kept = closure(shown_states, moves.T) & closure(of_state[-1] != 0.0, moves)  # an integral without k_i stands still
    of_state, of_shown = of_state[np.append(kept, True)][:, kept], of_shown[np.append(kept, True)]
    order = int(np.count_nonzero(kept))
    command = np.append(of_shown[order] @ rows, of_state[order])
    a = np.block([[plant.a, np.zeros((len(plant.a), order))], [of_shown[:order] @ rows, of_state[:order]]])
    b = np.append(plant.b, np.zeros(order))
    return ClosedLoop(a + np.outer(b, command), b, command)
