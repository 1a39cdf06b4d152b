"""Any proper rational transfer function of s in series with the plant input, with coefficients that may be uncertain.

With s' = unit s and z = (v, s' v, ..., s'^(n-1) v), v = u/denominator, in controllable canonical form. The unit is the
geometric mean of the time constants at the medians of the coefficients, which keeps the states of one size.
"""

from typing import Annotated, NamedTuple

from dssc_jax.core.adapters import linear_unmodelled
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import is_zero
from dssc_jax.core.quantities import Quantity, extent, nominal
from dssc_jax.core.sampled_linear import FASTEST, LinearSystem, one_entry
from dssc_jax.core.signals import Scalar

MOST_ORDER = 6
NUMERATOR = Quantity("SI", "numerator's coefficient, highest power of s first")
DENOMINATOR = Quantity("SI", "denominator's coefficient, highest power of s first")


class RationalActuatorParams(NamedTuple):
    """The transfer function G(s) from the command to the plant's input.

    Args:
        numerator: Coefficients, highest power first.
        denominator: Coefficients, highest power first.
        unit: Unit of time of the states [s], which :func:`prepare` computes.
    """

    numerator: Annotated[tuple[Scalar, ...], NUMERATOR]
    denominator: Annotated[tuple[Scalar, ...], DENOMINATOR]
    unit: float = 1.0


def prepare(params: RationalActuatorParams) -> RationalActuatorParams:
    """Require that G is proper for every value of its coefficients, and set the unit of time; raises ConfigError."""
    order = len(params.denominator) - 1
    if not 0 <= order <= MOST_ORDER:
        raise ConfigError("denominator", f"must have 1 to {MOST_ORDER + 1} coefficients, got {order + 1}")
    if not 1 <= len(params.numerator) <= order + 1:
        rule = f"must have 1 to {order + 1} coefficients, no more than the denominator (G must be proper)"
        raise ConfigError("numerator", f"{rule}, got {len(params.numerator)}")
    low, high = extent(params.denominator[0])
    if low <= 0.0 <= high:
        raise ConfigError("denominator.0", f"must not be or become 0, so that G stays proper, got [{low:g}, {high:g}]")
    return params._replace(unit=time_unit([nominal(coefficient) for coefficient in params.denominator]))


def time_unit(denominator: list[float]) -> float:
    """The geometric mean of the poles' time constants [s], at least FASTEST; poles at 0 are left out.

    Args:
        denominator: Coefficients, highest power first.

    Returns:
        The mean; 1 if all poles are 0, or if there is none.
    """
    leading = denominator[0]
    for zero_poles, coefficient in enumerate(reversed(denominator[1:])):
        if coefficient != 0.0:
            count = len(denominator) - 1 - zero_poles
            mean = abs(leading / coefficient) ** (1.0 / count)  # |coefficient/leading| is the product of their sizes
            return max(mean, FASTEST)
    return 1.0


def init(params: RationalActuatorParams) -> tuple[Scalar, ...]:
    """The state at rest: commands before t = 0 are zero."""
    return (0.0,) * (len(params.denominator) - 1)


def system(params: RationalActuatorParams) -> LinearSystem:
    """G as a linear system in controllable canonical form, in the unit of time."""
    order = len(params.denominator) - 1
    leading = params.denominator[0]

    def rising(coefficients: tuple[Scalar, ...]) -> list[Scalar]:
        """Coefficients in rising powers of s', over the denominator's leading one."""
        scaled: list[Scalar] = [0.0] * (order + 1)
        for power, coefficient in enumerate(reversed(coefficients)):
            scaled[power] = 0.0 if is_zero(coefficient) else coefficient / leading * params.unit ** (order - power)
        return scaled

    zeros = rising(params.numerator)
    poles = rising(params.denominator)
    rate = 1.0 / params.unit
    rows: list[tuple[Scalar, ...]] = []
    for i in range(order - 1):
        rows.append(one_entry(rate, i + 1, order))
    if order:
        rows.append(tuple(0.0 if is_zero(pole) else -rate * pole for pole in poles[:-1]))
    feedthrough = zeros[-1]
    output = []
    for zero, pole in zip(zeros[:-1], poles[:-1], strict=True):
        output.append(zero if is_zero(feedthrough) or is_zero(pole) else zero - feedthrough * pole)
    column = one_entry(rate, order - 1, order)
    return LinearSystem(tuple(rows), column, tuple(output), feedthrough)


RATIONAL = linear_unmodelled(RationalActuatorParams, init, system, prepare)
