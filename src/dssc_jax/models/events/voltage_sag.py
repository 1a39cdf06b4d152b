"""A voltage that falls from a time on, and with it the speed of all rotors."""

from typing import Annotated, NamedTuple

from dssc_jax.core.default_functions import rise_end
from dssc_jax.core.events import AT, UNTIL, Condition, VehicleEvent
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Scalar


class SagParams(NamedTuple):
    """A fall of the voltage to a share.

    Rotors turn at this share of their speed, so that thrust falls with the square of the share.
    """

    at: Annotated[Scalar, AT]
    voltage: Annotated[Scalar, Quantity("1", "share of the voltage that remains", above=0.0, at_most=1.5)]
    rise: Annotated[Scalar | None, Quantity("s", "time in which it falls; absent: at once", above=0.0)] = None
    until: Annotated[Scalar | None, UNTIL] = None


def change(params: SagParams, condition: Condition, share: Scalar, rotors: int) -> Condition:
    """The condition of the vehicle after ``share`` of the fall; voltages are relative to the condition without events.

    The fall multiplies the voltage that earlier falls have left. A condition with the voltage None had no earlier fall.

    Args:
        params: The fall.
        condition: The condition after earlier events.
        share: Share of the fall that has happened, in [0, 1].
        rotors: Number of rotors, which is not needed here.
    """
    remaining = 1.0 - share * (1.0 - params.voltage)
    earlier = condition.voltage
    return condition._replace(voltage=remaining if earlier is None else earlier * remaining)


VOLTAGE_SAG = VehicleEvent(SagParams, change, "the voltage of all rotors", last_change=rise_end)
