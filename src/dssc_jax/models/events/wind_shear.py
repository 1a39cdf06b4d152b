"""A wind that changes with height, from a time on."""

from typing import Annotated, NamedTuple

from dssc_jax.core.default_functions import rise_end
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.events import AT, UNTIL, Condition, Shear, VehicleEvent
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar
from dssc_jax.core.vectors import Vec3


class ShearParams(NamedTuple):
    """A wind that is added to the study's wind: ``gradient`` times the height of the vehicle above ``height``."""

    at: Annotated[Scalar, AT]
    gradient: Annotated[tuple[Scalar, ...], Quantity("1/s", "change of the wind x, y, z with height")]
    height: Annotated[Scalar, Quantity("m", "height z at which the shear adds nothing")] = 0.0
    rise: Annotated[Scalar | None, Quantity("s", "time in which it sets in; absent: at once", above=0.0)] = None
    until: Annotated[Scalar | None, UNTIL] = None


def prepare(params: ShearParams) -> ShearParams:
    """The parameters themselves, whose gradient must have the three values x, y, z.

    Raises:
        ConfigError: The gradient has another number of values.
    """
    if len(params.gradient) != 3:
        raise ConfigError("gradient", f"needs three values, got {len(params.gradient)}")
    return params


def change(params: ShearParams, condition: Condition, share: Scalar, rotors: int) -> Condition:
    """The condition of the vehicle with a share of this shear, beside the shears of other events.

    Args:
        params: The shear.
        condition: The condition after earlier events.
        share: Share of the shear that has set in, in [0, 1].
        rotors: Number of rotors, which is not needed here.
    """
    shear = Shear(Vec3(*params.gradient) * share, params.height)
    return condition._replace(shears=(*condition.shears, shear))


WIND_SHEAR = VehicleEvent(ShearParams, change, "the wind over height", prepare, last_change=rise_end)
