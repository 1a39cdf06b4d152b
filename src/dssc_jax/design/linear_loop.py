"""The sampled closed loop of a linear plant and a controller that is linearised at rest, and its figures of merit."""

import math
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.core.contracts import Controller
from dssc_jax.core.influences import closure
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import Measurement, ReferencePoint, Scalar
from dssc_jax.design.linear_plant import LinearPlant
from dssc_jax.study.components import Component

GRID = 600
"""Number of frequencies in the grid on which the peak of the sensitivity is sought."""
DECADES = 6.0
"""Decades below the Nyquist frequency that the grid of frequencies covers."""
SETTLED = 0.02
"""Share of the largest distance from its final value within which an output counts as settled."""
FADED = 7.0
"""Duration over which an output is followed, in time constants of the slowest pole."""
INSTANTS = 2000
"""Number of instants at which an output is computed."""


class ClosedLoop(NamedTuple):
    """The sampled closed loop x(k+1) = A x + b w, u = c x, with a disturbance w added to the command u.

    Args:
        a: A, shape (n, n); the state x is that of the plant, then that of the controller.
        b: Column of the disturbance at the command, shape (n,).
        c: Row of the command, shape (n,).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray

    @property
    def radius(self) -> float:
        """Largest modulus of the loop's poles; the loop is stable if it is below 1."""
        return float(np.max(np.abs(np.linalg.eigvals(self.a))))

    @property
    def sensitivity_peak(self) -> float:
        """Largest |S| up to the Nyquist frequency, with the sensitivity S = 1 + c (z - A)^-1 b at the command.

        The search covers a logarithmic grid of frequencies, and the frequencies of the poles, where S may have peaks.
        """
        grid = np.geomspace(np.pi * 10.0**-DECADES, np.pi, GRID)  # angles of z on the unit circle, omega T_s
        pole_angles = np.abs(np.angle(np.linalg.eigvals(self.a)))
        angles = np.append(grid, pole_angles)
        identity = np.eye(len(self.a))
        z = np.exp(1j * angles)[:, None, None]
        state_response = np.linalg.solve(z * identity - self.a, self.b[:, None])[..., 0]
        return float(np.max(np.abs(1.0 + state_response @ self.c)))

    def settling(self, row: np.ndarray) -> float:
        """Settling time of an output after a step of a disturbance at the command, in samples.

        From this time on, the output stays within 2 % of its largest distance from the final value. The time is
        infinite if the loop is unstable.

        Args:
            row: Row from the state to the output, shape (n,).
        """
        if self.radius >= 1.0:
            return math.inf
        order = len(self.a)
        final_state = np.linalg.solve(np.eye(order) - self.a, self.b)
        decay = -math.log(max(self.radius, np.finfo(float).tiny))  # of the slowest pole in one sample
        stride = max(1, math.ceil(FADED / (decay * INSTANTS)))  # samples from one instant to the next
        stride_transition = np.linalg.matrix_power(self.a, stride)
        distance = np.empty(INSTANTS)  # of the output from its final value
        deviation = -final_state
        for instant in range(INSTANTS):
            distance[instant] = abs(row @ deviation)
            deviation = stride_transition @ deviation
        outside = np.flatnonzero(distance > SETTLED * np.max(distance))
        if not outside.size:
            return 0.0
        return float(stride * (outside[-1] + 1))


def closed_loop(plant: LinearPlant, controller: Component) -> ClosedLoop:
    """Close the sampled loop of a linear plant and a controller, which is linearised at its second sample at rest.

    States of the controller that do not move, or have no effect on the command, are left out. Otherwise an integral
    without k_i would add a pole at 1.

    Args:
        plant: The plant behind its linear actuators, sampled.
        controller: The controller, parsed, with gains in plain numbers.
    """
    linear = linearised_controller(controller, outputs_count=2 + len(plant.signals), sample_time=plant.sample_time)
    order = len(linear.a)
    rows = np.vstack([plant.c, plant.rate, plant.signals])  # outputs that the controller takes, from the plant's state
    command = np.append(linear.d @ rows, linear.c)
    a = np.block([[plant.a, np.zeros((len(plant.a), order))], [linear.b @ rows, linear.a]])
    b = np.append(plant.b, np.zeros(order))
    return ClosedLoop(a + np.outer(b, command), b, command)


class LinearController(NamedTuple):
    """A sampled linear controller, xi(k+1) = A xi(k) + B o(k), u = C xi + D o, of the outputs o = (y, y', signals).

    Args:
        a: A, shape (n, n).
        b: B, shape (n, m).
        c: C, shape (n,).
        d: D, shape (m,).
    """

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    d: np.ndarray


def linearised_controller(controller: Component, outputs_count: int, sample_time: float) -> LinearController:
    """Linearise a controller at its second sample at rest, and drop states that do not move or have no effect.

    Args:
        controller: The controller, parsed, with gains in plain numbers.
        outputs_count: Number of the outputs: y, y' and the measured signals.
        sample_time: Sample time T_s [s].
    """
    model: Controller = controller.model
    gains = controller.params
    dt = sample_time
    with arithmetic():

        def sample(state: Any, outputs: jax.Array) -> tuple[Any, Scalar]:
            """Next state and command of the controller, for a reference at rest and these outputs of the plant."""
            measurement = Measurement(outputs[0], outputs[1], tuple(outputs[2:]))
            next_state, command, _ = model.step(gains, state, measurement, ReferencePoint(0.0, 0.0, 0.0), dt)
            return next_state, command.total

        zero_outputs = jnp.zeros(outputs_count)
        start = model.init(gains, Measurement(0.0, 0.0, tuple(zero_outputs[2:])), ReferencePoint(0.0, 0.0, 0.0))
        second_state, _ = sample(jax.tree.map(lambda leaf: jnp.asarray(leaf, float), start), zero_outputs)
        second_vector, unravel = ravel_pytree(second_state)

        def flat_sample(state: jax.Array, outputs: jax.Array) -> jax.Array:
            """Next state of the controller, then the command, as one vector of shape (states + 1,)."""
            next_state, command = sample(unravel(state), outputs)
            next_vector, _ = ravel_pytree(next_state)
            return jnp.append(next_vector, command)

        slopes_of = jax.jit(jax.jacfwd(flat_sample, argnums=(0, 1)))
        state_slopes, output_slopes = map(np.asarray, slopes_of(second_vector, zero_outputs))
    a = state_slopes[:-1]
    c = state_slopes[-1]
    b = output_slopes[:-1]
    d = output_slopes[-1]
    return without_idle_states(LinearController(a, b, c, d))


def without_idle_states(controller: LinearController) -> LinearController:
    """Drop the states of a controller that no output moves, and those that have no effect on the command."""
    a, b, c, d = controller
    influences = a != 0.0  # of each state (column) on each next state (row)
    is_driven = np.any(b != 0.0, axis=1)
    is_moving = closure(is_driven, influences.T)
    has_effect = closure(c != 0.0, influences)  # an integral without k_i has none
    kept = is_moving & has_effect
    return LinearController(a[kept][:, kept], b[kept], c[kept], d)
