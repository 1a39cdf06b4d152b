"""A rotor that gives a share of its thrust from a time on, or none."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.default_functions import unchanging
from dssc_jax.core.events import AT, UNTIL, Condition, VehicleEvent
from dssc_jax.core.numerics import is_known
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar


class RotorParams(NamedTuple):
    """A rotor that keeps a share of its thrust; rotors count from 1, as ``rotor_1`` of trajectories.

    The rotor turns at its speed times the root of this share, so drag torque, drag and gyroscopic torque change, too.
    """

    at: Annotated[Scalar, AT]
    rotor: Annotated[Scalar, Quantity("1", "number of the rotor, 1 is the first", at_least=1.0, whole=True)]
    effectiveness: Annotated[Scalar, Quantity("1", "share of its thrust that it keeps", at_least=0.0, at_most=1.0)] = (
        0.0
    )
    until: Annotated[Scalar | None, UNTIL] = None


def change(params: RotorParams, condition: Condition, share: Scalar, rotors: int) -> Condition:
    """The condition of the vehicle with a share of the rotor's loss of thrust.

    The number of the rotor may be traced, as in a sweep. The program then compares every rotor with this number.

    Args:
        params: The rotor, and the share of its thrust that it keeps.
        condition: The condition after earlier events, whose losses multiply with this one.
        share: Share of the loss that has happened, in [0, 1].
        rotors: Number of rotors of the vehicle.
    """
    shares = condition.effectiveness or (1.0,) * rotors  # (): no earlier event
    remaining_share = 1.0 - share * (1.0 - params.effectiveness)
    effectiveness = []
    for index, value in enumerate(shares, start=1):
        if is_known(params.rotor):
            is_affected = round(float(params.rotor)) == index
            effectiveness.append(value * remaining_share if is_affected else value)
        else:
            is_affected = jnp.abs(params.rotor - index) < 0.5
            effectiveness.append(jnp.where(is_affected, value * remaining_share, value))
    return condition._replace(effectiveness=tuple(effectiveness))


ROTOR = VehicleEvent(RotorParams, change, "the thrust of a rotor", last_change=unchanging)
