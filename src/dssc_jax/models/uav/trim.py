"""Equilibrium of a vehicle that holds its place in a steady wind: tilt, thrust, moment and speeds of the rotors.

At rest in the wind w the forces and the moments are in balance,

    R (f_across + f e3) + F_drag(-w) = M g e3,   M_rotors + tau_drag(-w) = 0,

where drag and thrust depend on the attitude R and on the speeds of the rotors. Substitution solves the balance: each
round turns body z along the force that is needed, and corrects thrust and moment by what they lack.
"""

from typing import NamedTuple

import jax

from dssc_jax.core.numerics import as_arrays, dot, root_abs
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.uav.aerodynamics import drag
from dssc_jax.models.uav.ground import rotor_thrusts
from dssc_jax.models.uav.inner_loops.sampled import Trim, attitude_from_angles, body_angles
from dssc_jax.models.uav.parameters import UavParams
from dssc_jax.models.uav.rotors import wrench
from dssc_jax.models.uav.vehicle import GRAVITY

ROUNDS = 24
"""Rounds of the substitution, each of which multiplies the error by at most the square of the tilt."""


class Guess(NamedTuple):
    """Unknowns of the balance: the direction of body z, and the wanted thrust [N] and moment [N m]."""

    upward: Vec3
    thrust: Scalar
    moment: Vec3


def trim(params: UavParams, wind: Vec3) -> Trim:
    """The equilibrium of a draw that holds its initial position and yaw in a steady wind.

    Args:
        params: The prepared parameters.
        wind: Velocity of the air, inertial [m/s].
    """

    def substitution(_: Scalar, guess: Guess) -> Guess:
        """One round of the substitution; the index of the round does not matter."""
        return as_arrays(improved_guess(params, wind, guess))

    weight = params.inner_model.mass * GRAVITY
    first = Guess(Vec3(0.0, 0.0, 1.0), weight, Vec3(0.0, 0.0, 0.0))
    guess = jax.lax.fori_loop(0, ROUNDS, substitution, as_arrays(first))
    thrusts = commanded_thrusts(params, guess)
    return Trim(body_angles(guess.upward, params.yaw), guess.thrust, guess.moment, thrusts)


def commanded_thrusts(params: UavParams, guess: Guess) -> tuple[Scalar, ...]:
    """The rotors' thrusts that the inner loop commands for a guess of thrust and moment, without their limits [N]."""
    return tuple(dot(row, (guess.thrust, *guess.moment)) for row in params.allocation)


def improved_guess(params: UavParams, wind: Vec3, guess: Guess) -> Guess:
    """The next guess of the substitution, nearer to the balance of forces and moments.

    Thrust and moment of a guess are what the inner loop wants; the rotors of the draw give others. The next thrust is
    the size of the required force times the ratio of wanted and given thrust. The next moment is the guessed one minus
    the sum of the moments of rotors and drag, times the same ratio.

    Args:
        params: The prepared parameters.
        wind: Velocity of the air, inertial [m/s].
        guess: The guess before.
    """
    vehicle = params.vehicle
    rotors = zip(commanded_thrusts(params, guess), params.believed_coefficients, strict=True)
    speeds = tuple(root_abs(f / coefficient) for f, coefficient in rotors)
    _, _, height = params.position
    thrust, moment, side_force = wrench(vehicle, rotor_thrusts(vehicle, params.ground, height, speeds))
    rotation = attitude_from_angles(body_angles(guess.upward, params.yaw)).matrix()
    drag_effect = drag(vehicle, rotation, Vec3(0.0, 0.0, 0.0), -wind, speeds)
    required_force = Vec3(0.0, 0.0, vehicle.mass * GRAVITY) - drag_effect.force
    if side_force:  # () where all rotors point along body z
        x, y = side_force
        required_force = required_force - rotation @ Vec3(x, y, 0.0)
    size = root_abs(required_force.dot(required_force))
    ratio = guess.thrust / thrust  # wanted over given thrust
    excess_moment = moment + drag_effect.torque
    return Guess(required_force / size, ratio * size, guess.moment - excess_moment * ratio)
