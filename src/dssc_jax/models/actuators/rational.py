"""Any proper rational transfer function of s in series with the plant input, with coefficients that may be uncertain.

The states are z = (v, s' v, ..., s'^(n-1) v) with v = u/denominator and s' = unit s: the controllable canonical form.
The unit of time is the geometric mean of the poles' time constants at the medians of the coefficients. It gives all
states about the same size.
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
    """The coefficients of the transfer function G(s) from the command to the plant's input.

    Args:
        numerator: Coefficients, highest power of s first.
        denominator: Coefficients, highest power of s first.
        unit: Unit of time in which the states are kept [s]; :func:`prepare` computes it.
    """

    numerator: Annotated[tuple[Scalar, ...], NUMERATOR]
    denominator: Annotated[tuple[Scalar, ...], DENOMINATOR]
    unit: float = 1.0


def prepare(params: RationalActuatorParams) -> RationalActuatorParams:
    """The parameters with their unit of time, if G is proper for every value of its coefficients.

    Raises:
        ConfigError: A number of coefficients is not admissible, or the denominator's first coefficient can be 0.
    """
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
    """The geometric mean of the time constants 1/|pole| [s], at least ``FASTEST``; poles at 0 are left out.

    As a unit of time it gives all states of the canonical form about the same size. The product of the other poles'
    sizes is |a/leading|, where a is the last coefficient that is not 0.

    Args:
        denominator: Coefficients, highest power first.

    Returns:
        The mean; 1 if all poles are at 0, or if there is none.
    """
    leading, *lower = denominator
    for place in reversed(range(len(lower))):
        if lower[place] != 0.0:
            poles = place + 1  # number of poles that are not at 0
            return max(abs(leading / lower[place]) ** (1.0 / poles), FASTEST)
    return 1.0


def init(params: RationalActuatorParams) -> tuple[Scalar, ...]:
    """The state at rest: commands before t = 0 are zero."""
    return (0.0,) * (len(params.denominator) - 1)


def system(params: RationalActuatorParams) -> LinearSystem:
    """G as a linear system in controllable canonical form, whose states have the unit of time of the parameters.

    All coefficients are divided by the denominator's leading one. The denominator's others, with the sign changed, are
    the last row of A times the unit. The output row has the coefficients of the numerator minus the direct feedthrough
    times the denominator.
    """
    order = len(params.denominator) - 1
    leading = params.denominator[0]

    def rising(coefficients: tuple[Scalar, ...]) -> list[Scalar]:
        """Coefficients in rising powers of s' = unit s, divided by the denominator's leading coefficient there."""
        scaled: list[Scalar] = [0.0] * (order + 1)
        for power, coefficient in enumerate(reversed(coefficients)):
            scaled[power] = 0.0 if is_zero(coefficient) else coefficient / leading * params.unit ** (order - power)
        return scaled

    numerator = rising(params.numerator)
    denominator = rising(params.denominator)
    rate = 1.0 / params.unit
    rows: list[tuple[Scalar, ...]] = []
    for i in range(order - 1):
        rows.append(one_entry(rate, i + 1, order))
    if order:
        rows.append(tuple(0.0 if is_zero(a) else -rate * a for a in denominator[:-1]))
    feedthrough = numerator[-1]
    output = []
    for b, a in zip(numerator[:-1], denominator[:-1], strict=True):
        output.append(b if is_zero(feedthrough) or is_zero(a) else b - feedthrough * a)
    column = one_entry(rate, order - 1, order)
    return LinearSystem(tuple(rows), column, tuple(output), feedthrough)


RATIONAL = linear_unmodelled(RationalActuatorParams, init, system, prepare)
