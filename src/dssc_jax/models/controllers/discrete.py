"""Controllers in discrete time: a transfer function of z, and a state-space model.

The transfer function is u = C(z) (y_m - y), in the transposed direct form II. Between its limits it is linear. At a
limit the denominator acts on the limited command, so that the controller does not wind up.

The state-space model is x(k+1) = A x + B w, u = C x + D w within its limits, where w holds y_m - y and then the
measured signals, in the order of the study's ``measures``. It has no anti-windup.

In units, u stands for the unit of the command.

References:
    K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed. (1997), sections 9.4 and 9.5.
"""

from typing import Annotated, NamedTuple, TypeVar

from dssc_jax.core.contracts import Controller
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import dot
from dssc_jax.core.quantities import Quantity, extent
from dssc_jax.core.registry import Entry, single
from dssc_jax.core.setting import LoopSetting
from dssc_jax.core.signals import Command, Measurement, ReferencePoint, Scalar
from dssc_jax.models.controllers.command_limits import HIGH, LOW, smooth_within_limits, within_limits
from dssc_jax.models.controllers.nominal import L0

MOST_STATES = 40
"""Largest order of a controller."""
NUMERATOR = Quantity("SI", "numerator's coefficient, highest power of z first")
DENOMINATOR = Quantity("SI", "denominator's coefficient, highest power of z first")
ENTRY = Quantity("SI", "entry of A, row by row")
INPUTS = Quantity("SI", "entry of B, row by row: columns of y_m - y, then of each measured signal")
OUTPUTS = Quantity("SI", "entry of the row C")
THROUGH = Quantity("SI", "entry of the row D: of y_m - y, then of each measured signal")
DESIGNED = Quantity("s", "T_s that it was designed for, to be compared with the loop's", above=0.0, law=False)

Row = tuple[Scalar, ...]
Rows = tuple[Row, ...]


class FractionGains(NamedTuple):
    """Coefficients of C(z), limits of u, and the T_s for which C(z) was designed.

    ``l0`` defines sigma of the metrics; the controller does not use it.
    """

    numerator: Annotated[Row, NUMERATOR]
    denominator: Annotated[Row, DENOMINATOR]
    low: Annotated[Scalar | None, LOW] = None
    high: Annotated[Scalar | None, HIGH] = None
    sample_time: Annotated[Scalar | None, DESIGNED] = None
    l0: Annotated[Scalar, L0] = 1.0


class MatrixGains(NamedTuple):
    """The matrices A, B, C and D of the model, limits of u, and the T_s for which the model was designed.

    ``l0`` defines sigma of the metrics; the controller does not use it.
    """

    a: Annotated[Rows, ENTRY]
    b: Annotated[Rows, INPUTS]
    c: Annotated[Row, OUTPUTS]
    d: Annotated[Row, THROUGH]
    low: Annotated[Scalar | None, LOW] = None
    high: Annotated[Scalar | None, HIGH] = None
    sample_time: Annotated[Scalar | None, DESIGNED] = None
    l0: Annotated[Scalar, L0] = 1.0


G = TypeVar("G", FractionGains, MatrixGains)


class DiscreteState(NamedTuple):
    """The state x of the transfer function or of the state-space model."""

    x: Row


class DiscreteInfo(NamedTuple):
    """What the controller reports at each sample: the command before its limits."""

    unlimited: Annotated[Scalar, Quantity("u", "command u before its limits")]


def padded_numerator(gains: FractionGains) -> Row:
    """The numerator's coefficients with leading zeros, so that they are as many as the denominator's.

    Both lists begin with the highest power of z, so that equal places then belong to equal powers.
    """
    leading_zeros = (0.0,) * (len(gains.denominator) - len(gains.numerator))
    return (*leading_zeros, *gains.numerator)


def fraction_init(gains: FractionGains, measurement: Measurement, reference: ReferencePoint) -> DiscreteState:
    """The controller at rest: earlier errors and commands are zero.

    The controller does not use the first measurement and reference.
    """
    return DiscreteState((0.0,) * (len(gains.denominator) - 1))


def fraction_step(
    gains: FractionGains, state: DiscreteState, measurement: Measurement, reference: ReferencePoint, dt: Scalar
) -> tuple[DiscreteState, Command, DiscreteInfo]:
    """One sample of the transposed direct form II.

    Let b_i and a_i be the coefficients of numerator and denominator, highest power of z first, e = y_m - y the error
    and x the state. Then v = (b_0 e + x_1)/a_0 is the command before its limits, u is v within its limits, and
    x_i+ = b_i e - a_i u + x_(i+1). ``dt`` is not used, because the coefficients belong to one T_s.
    """
    error = reference.y - measurement.y
    leading, *lower = gains.denominator
    first, *following = padded_numerator(gains)
    v = (first * error + (state.x[0] if state.x else 0.0)) / leading
    u = within_limits(v, gains.low, gains.high)
    after = []
    for i, (b, a) in enumerate(zip(following, lower, strict=True)):
        successor = state.x[i + 1] if i + 1 < len(state.x) else 0.0
        after.append(b * error - a * u + successor)
    return DiscreteState(tuple(after)), Command(robust=u, nominal=0.0), DiscreteInfo(v)


def prepare_fraction(gains: FractionGains) -> FractionGains:
    """Require a proper transfer function; raises ConfigError.

    The denominator must not be longer than ``MOST_STATES`` + 1 coefficients, and its first one must not be 0 for any
    value of its law.
    """
    if not 1 <= len(gains.denominator) <= MOST_STATES + 1:
        rule = f"must have 1 to {MOST_STATES + 1} coefficients, got {len(gains.denominator)}"
        raise ConfigError("denominator", rule)
    if not 1 <= len(gains.numerator) <= len(gains.denominator):
        rule = f"must have 1 to {len(gains.denominator)} coefficients, so that C(z) is proper"
        raise ConfigError("numerator", f"{rule}; got {len(gains.numerator)}")
    smallest_leading, largest_leading = extent(gains.denominator[0])
    if smallest_leading <= 0.0 <= largest_leading:
        raise ConfigError("denominator.0", "is the coefficient of the highest power and must not be zero; leave it out")
    return gains


def matrix_init(gains: MatrixGains, measurement: Measurement, reference: ReferencePoint) -> DiscreteState:
    """The controller at rest: its state is zero.

    The controller does not use the first measurement and reference.
    """
    return DiscreteState((0.0,) * len(gains.a))


def matrix_step(
    gains: MatrixGains, state: DiscreteState, measurement: Measurement, reference: ReferencePoint, dt: Scalar
) -> tuple[DiscreteState, Command, DiscreteInfo]:
    """One sample.

    The command is u = C x + D w within its limits, and the next state is A x + B w. Here w is y_m - y and then the
    measured signals; a D of one number takes none of them. ``dt`` is not used, because the matrices belong to one T_s.
    """
    signals = (reference.y - measurement.y, *measurement.signals[: len(gains.d) - 1])
    v = dot((*gains.c, *gains.d), (*state.x, *signals))
    after = []
    for row, entries in zip(gains.a, gains.b, strict=True):
        after.append(dot((*row, *entries), (*state.x, *signals)))
    u = within_limits(v, gains.low, gains.high)
    return DiscreteState(tuple(after)), Command(robust=u, nominal=0.0), DiscreteInfo(v)


def require_rows(name: str, rows: Rows, shape: tuple[int, int]) -> None:
    """Require that the matrix in the field ``name`` has a number of rows and of columns; raises ConfigError.

    Args:
        name: Name of the field, for the message.
        rows: The matrix, row by row.
        shape: Required numbers of rows and of columns.
    """
    row_count, column_count = shape
    if len(rows) != row_count:
        raise ConfigError(name, f"must have {row_count} rows, one for each state, got {len(rows)}")
    for i, row in enumerate(rows):
        if len(row) != column_count:
            raise ConfigError(f"{name}.{i}", f"must have {column_count} numbers, got {len(row)}")


def prepare_matrix(gains: MatrixGains) -> MatrixGains:
    """Require matrices whose sizes fit each other; raises ConfigError."""
    order = len(gains.a)
    if order > MOST_STATES:
        raise ConfigError("a", f"must have at most {MOST_STATES} rows, got {order}")
    if not gains.d:
        raise ConfigError("d", "must have a number for y_m - y, then one for each measured signal; got none")
    require_rows("a", gains.a, (order, order))
    require_rows("b", gains.b, (order, len(gains.d)))
    if len(gains.c) != order:
        raise ConfigError("c", f"must have {order} numbers, one for each state, got {len(gains.c)}")
    return gains


def require_sample_time(gains: G, setting: LoopSetting) -> G:
    """The gains themselves, whose stated T_s must be the loop's; None: they state none. Raises ConfigError.

    Args:
        gains: Coefficients or matrices, with the T_s for which they were designed [s].
        setting: The loop, with its T_s.
    """
    if gains.sample_time is None:
        return gains
    design_time = float(gains.sample_time)
    if abs(design_time - setting.sample_time) > 1e-9 * setting.sample_time:
        rule = f"must be the loop's sample_time = {setting.sample_time:g} s, got {design_time:g}"
        raise ConfigError("sample_time", f"{rule}; design the controller for that, or change the loop")
    return gains


DISCRETE_TRANSFER_FUNCTION: Entry = single(
    Controller(
        FractionGains,
        fraction_init,
        fraction_step,
        prepare_fraction,
        smooth=smooth_within_limits(fraction_init, fraction_step),
        fit=require_sample_time,
        info=DiscreteInfo,
    ),
    "u = C(z) (y_m - y), by the coefficients of C",
    numerator=[2.0, -1.8],
    denominator=[1.0, -0.7],
    low=-9.0,
)
DISCRETE_STATE_SPACE: Entry = single(
    Controller(
        MatrixGains,
        matrix_init,
        matrix_step,
        prepare_matrix,
        smooth=smooth_within_limits(matrix_init, matrix_step),
        takes=lambda gains: len(gains.d) - 1,
        fit=require_sample_time,
        info=DiscreteInfo,
    ),
    "x(k+1) = A x + B w, u = C x + D w, where w is y_m - y and the measured signals",
    a=[[0.9, 0.1], [0.0, 0.7]],
    b=[[0.1], [0.3]],
    c=[1.0, 0.5],
    d=[2.0],
    high=9.0,
)
