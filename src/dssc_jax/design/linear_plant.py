"""A study's plant at its start, with the linear actuators before it, sampled exactly.

The plant is linearised at its start. Actuators that declare themselves linear (lags, transfer functions, delays) act
before it. All other actuators count as a gain of 1, and results name them. With a held command, plant and linear
actuators are one discrete system x(k+1) = A x(k) + B u(k). One matrix exponential gives its part in continuous time.
Derivatives of the actuators' functions give what the actuators do at a sample.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.core.chains import chain
from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.numerics import arithmetic, as_vector
from dssc_jax.core.sampled_linear import LinearSystem
from dssc_jax.core.signals import Params, Scalar
from dssc_jax.design.linearised_plant import LinearisedPlant
from dssc_jax.models.controllers.linear_quadratic import sampled_system
from dssc_jax.study.actuators import acting_elements
from dssc_jax.study.laws import nominal_params
from dssc_jax.study.study import Study


class LinearPlant(NamedTuple):
    """Plant and linear actuators, sampled with a held command: x(k+1) = A x(k) + B u(k), y = c x.

    The first entries of x are the plant's state.

    Args:
        a: A, shape (n, n).
        b: B, shape (n,).
        c: Row of y, shape (n,): y = c x.
        rate: Row of y', shape (n,).
        signals: Rows of the measured signals, shape (m, n).
        sample_time: Sample time T_s [s].
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    rate: np.ndarray
    signals: np.ndarray
    sample_time: float

    def response(self, omega: float) -> complex:
        """Frequency response from the held command u to the sampled output y, at an angular frequency [rad/s]."""
        z = np.exp(1j * omega * self.sample_time)
        return complex(self.c @ np.linalg.solve(z * np.eye(len(self.a)) - self.a, self.b))


class LinearActuators(NamedTuple):
    """The actuators of a study that declare themselves linear, in series, as a part of the linearised loop.

    Args:
        model: All linear actuators as one actuator; None: there are none.
        params: Parameters of the model, without laws.
        linear_kinds: Kinds of the linear actuators, from the command to the plant.
        left_out: Kinds of the parts that the linearised loop leaves out: other actuators, sensors, a differentiator.
    """

    model: Unmodelled | None
    params: Params
    linear_kinds: tuple[str, ...]
    left_out: tuple[str, ...]


NO_ACTUATORS = LinearActuators(model=None, params=(), linear_kinds=(), left_out=())
"""The linear actuators of a plant without any: the command reaches the plant unchanged."""


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
    """The linear actuators of a study with one channel, in series as one actuator, and the kinds left out.

    Sensors, a differentiator, and actuators for which superposition does not hold are left out.
    """
    elements = []
    params_of_elements = []
    left_out = measuring_kinds(study)
    for element, params in acting_elements(study.table, study.config):
        is_linear = element.model.linear is not None or element.model.superposes
        if is_linear:
            elements.append(element)
            params_of_elements.append(nominal_params(params))
        else:
            left_out.append(element.kind)
    if not elements:
        return NO_ACTUATORS._replace(left_out=tuple(left_out))
    kinds = tuple(element.kind for element in elements)
    if len(elements) == 1:
        return LinearActuators(elements[0].model, params_of_elements[0], kinds, tuple(left_out))
    return LinearActuators(chain(tuple(elements)), tuple(params_of_elements), kinds, tuple(left_out))


def measuring_kinds(study: Study) -> list[str]:
    """Slot and kind, in words, of each sensor and differentiator that is not ideal."""
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
    """The plant behind the linear actuators, sampled with a held command u.

    The state is (x, z, v): the state x of the plant, the state z of the actuators, and their drive v since the last
    sample. At a sample, the command u changes z and sets v. Until the next sample, the constant v drives the actuators'
    continuous system, whose output acts on the plant. A signal with a feedthrough contains that output just before the
    sample.

    Args:
        plant: The plant in continuous time.
        actuators: The linear actuators.
        sample_time: Sample time T_s [s].
    """
    n = len(plant.a)
    at_sample = actuators_at_sample(actuators, sample_time)
    system = at_sample.system
    order = len(system.a)
    total = n + order
    # (x, z)' = a (x, z) + b v between two samples
    a = np.zeros((total, total))
    a[:n, :n] = plant.a
    a[:n, n:] = np.outer(plant.b, system.c)
    a[n:, n:] = system.a
    b = np.append(plant.b * system.d, system.b)
    held_system = sampled_system(a, b[:, None], sample_time)
    # (x, z) just after the sample and v, as rows that act on (x, z, u) just before it
    after_sample = np.zeros((total, total + 1))
    after_sample[:n, :n] = np.eye(n)
    after_sample[n:, n:] = np.column_stack([at_sample.state, at_sample.state_input])
    drive_row = np.concatenate([np.zeros(n), at_sample.output @ at_sample.state])
    drive_input = float(at_sample.output @ at_sample.state_input) + at_sample.output_input
    # (x, z) just before the next sample, as rows that act on (x, z, u)
    sampled = held_system.a @ after_sample + np.outer(held_system.b, np.append(drive_row, drive_input))
    transition = np.zeros((total + 1, total + 1))
    transition[:total, :total] = sampled[:, :total]
    transition[total, :total] = drive_row
    plant_input_row = np.concatenate([np.zeros(n), system.c, [system.d]])  # what reaches the plant, from (x, z, v)

    def padded(row: np.ndarray) -> np.ndarray:
        """Extend a row that acts on x by zeros, so that it acts on (x, z, v)."""
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
    """Linear actuators: z <- S z + s u and then v = V z + w u at a sample, and a system that v drives until the next.

    Args:
        state: S, shape (n, n), by which the state z after the sample depends on z before the sample.
        state_input: s, shape (n,).
        output: V, shape (n,); it multiplies the state after the sample.
        output_input: w.
        system: Continuous system with the state z, from v to what reaches the plant.
    """

    state: np.ndarray
    state_input: np.ndarray
    output: np.ndarray
    output_input: float
    system: SystemArrays


def actuators_at_sample(actuators: LinearActuators, sample_time: float) -> ActuatorsAtSample:
    """The matrices of linear actuators at a sample, and their continuous system between samples.

    The matrices are derivatives of the actuators' functions; since the actuators are linear, the derivatives are the
    same at every state.
    """
    model = actuators.model
    params = actuators.params
    if model is None:  # v = u, without a state
        return ActuatorsAtSample(
            state=np.zeros((0, 0)),
            state_input=np.zeros(0),
            output=np.zeros(0),
            output_input=1.0,
            system=as_arrays(None, order=0),
        )
    with arithmetic():
        start, unravel = as_vector(model.init(params))
        key = jax.random.key(0)

        def sample(z: jax.Array, u: Scalar) -> jax.Array:
            """State z after the sample."""
            vector, _ = ravel_pytree(model.sample(params, unravel(z), u, key, sample_time))
            return vector

        def drive(z: jax.Array, u: Scalar) -> Scalar:
            """Drive v of the actuators' system until the next sample, from the state z after the sample."""
            if model.advance is not None:
                _, moments = model.advance(params, sample_time)(unravel(z), u)
                return jnp.asarray(moments.mean, float)
            if model.linear is not None:
                return jnp.asarray(u, float)
            return jnp.asarray(model.output(params, unravel(z), u), float)

        state, state_input = map(np.asarray, jax.jit(jax.jacfwd(sample, argnums=(0, 1)))(start, 0.0))
        output, output_input = map(np.asarray, jax.jit(jax.jacfwd(drive, argnums=(0, 1)))(start, 0.0))
        system = as_arrays(model.linear(params) if model.linear is not None else None, order=len(start))
    return ActuatorsAtSample(state, state_input, output, float(output_input), system)


def as_arrays(system: LinearSystem | None, order: int) -> SystemArrays:
    """A linear system as arrays of NumPy.

    Args:
        system: The system; None: a gain of 1 that does not use the states, which stand still.
        order: Number of states if the system is None; otherwise not used.
    """
    if system is None:
        return SystemArrays(np.zeros((order, order)), np.zeros(order), np.zeros(order), 1.0)
    return SystemArrays(
        a=np.asarray(system.a, float),
        b=np.asarray(system.b, float),
        c=np.asarray(system.c, float),
        d=float(system.d),
    )
