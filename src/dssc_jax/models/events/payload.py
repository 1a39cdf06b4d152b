"""A mass that the vehicle picks up, or drops, at a time."""

from typing import Annotated, NamedTuple

from dssc_jax.core.default_functions import unchanging
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.events import AT, UNTIL, Condition, Load, VehicleEvent
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3


class PayloadParams(NamedTuple):
    """A point mass that the vehicle picks up at a place or, if the mass is negative, drops from there.

    The vehicle's own mass must include a mass that is dropped later. Velocity and body rate do not jump, since a mass
    that is picked up is assumed to move with the vehicle already.
    """

    at: Annotated[Scalar, AT]
    mass: Annotated[Scalar, Quantity("kg", "mass that is added; below 0: dropped")]
    offset: Annotated[tuple[Scalar, ...], Quantity("m", "place of the mass from the centre of mass, body axes")] = (
        0.0,
        0.0,
        0.0,
    )
    until: Annotated[Scalar | None, UNTIL] = None


def prepare(params: PayloadParams) -> PayloadParams:
    """The parameters themselves, whose place must have the three values x, y, z.

    Raises:
        ConfigError: The place has another number of values.
    """
    if len(params.offset) != 3:
        raise ConfigError("offset", f"needs three values, got {len(params.offset)}")
    return params


def change(params: PayloadParams, condition: Condition, share: Scalar, rotors: int) -> Condition:
    """The condition of the vehicle with a share of the mass at its place.

    Masses of other events stay: the moments of all masses add up.

    Args:
        params: The mass and its place.
        condition: The condition after earlier events.
        share: Share of the mass that is at its place, in [0, 1].
        rotors: Number of rotors, which is not needed here.
    """
    mass = share * params.mass
    x, y, z = params.offset
    load = Load(
        mass=mass,
        first=Vec3(x, y, z) * mass,
        square=Vec3(x * x, y * y, z * z) * mass,
        product=Vec3(y * z, z * x, x * y) * mass,
    )
    earlier = condition.load
    if earlier is not None:
        load = Load(
            mass=earlier.mass + load.mass,
            first=earlier.first + load.first,
            square=earlier.square + load.square,
            product=earlier.product + load.product,
        )
    return condition._replace(load=load)


PAYLOAD = VehicleEvent(PayloadParams, change, "mass, centre of mass and inertia", prepare, last_change=unchanging)
