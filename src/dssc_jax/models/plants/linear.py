"""Linear plants with one input and one output: state space, and transfer function.

Both have the form x' = A x + b (u_p + d), y = c x, without feedthrough. The relative degree r is the smallest number
with c A^(r-1) b not zero, or the excess of poles over zeros. A controller can rely on the following:

* r = 2: y' does not depend on the command, and y'' depends on it with the gain c A b. The plant is of the class
  (5)-(8) where its zeros are stable (:mod:`dssc_jax.core.normal_form`).
* r = 1: y' jumps with the command. At a sample y' is measured just before the jump, so that it contains the last
  command. A differentiator (``[differentiator]``) or a controller that uses y alone (PID) does not need this y'.
* r > 2: y' is exact, but sigma = e' + l_0 e does not have relative degree one.
"""

from typing import Annotated, Any, NamedTuple

from dssc_jax.core.adapters import linear_derivative
from dssc_jax.core.contracts import LinearDynamics, Plant
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.named import by_names
from dssc_jax.core.normal_form import RealisedSystem, relative_degree
from dssc_jax.core.numerics import dot
from dssc_jax.core.quantities import Quantity, nominal
from dssc_jax.core.sampled_linear import Column, one_entry
from dssc_jax.core.signals import Info, Measurement, PlantInput, Scalar
from dssc_jax.core.smoothness import SMOOTH
from dssc_jax.models.plants.named import Inputs, Outputs, named_signals, output_report, require_named

MOST_STATES = 20
ENTRY = Quantity("SI", "entry of A, row by row")
INPUT = Quantity("SI", "entry of the input column b")
OUTPUT = Quantity("SI", "entry of the output row c")
PLANT_NUMERATOR = Quantity("SI", "numerator's coefficient, highest power of s first")
PLANT_DENOMINATOR = Quantity("SI", "denominator's coefficient, highest power of s first")
DISTURBANCE_INPUT = Quantity("SI", "entry of the disturbance's input column e; absent: b")
FEEDTHROUGH = Quantity("SI", "feedthrough of the command to y; only 0 is possible", law=False)
DELAYED_BY_A_SAMPLE = (
    "the command takes effect after the sample that decided it, so y must not show it at once. Give the fast part that "
    "stands behind D as one more state, d/(T s + 1), such as the lag of a sensor; or keep y = c x, name the whole in "
    "[plant.outputs.NAME] with its `d`, and list NAME in [sensor] measures: it shows d u(k-1), the last command"
)
"""The reason why a plant has no feedthrough to y, and the remedy."""
INITIAL_STATE = Quantity("SI", "initial state; the rest of it is zero")

MatrixRows = tuple[tuple[Scalar, ...], ...]


class StateSpaceParams(NamedTuple):
    """The linear plant x' = A x + b u + e d, y = c x.

    Args:
        a: Rows of A.
        b: Input column of the command.
        c: Output row.
        disturbance: Input column e of the disturbance; None: the command's, so that the disturbance is matched.
        x0: First entries of the initial state; the others are zero.
        outputs: Signals beside y, by their names in the study.
        inputs: Input columns of additional disturbances, by their names in the study.
        d: Feedthrough of the command to y, which must be 0.
        degree: Relative degree from the command to y, set by :func:`prepare_state_space`.
        disturbance_degree: Relative degree from the disturbance to y, set by :func:`prepare_state_space`.
    """

    a: Annotated[MatrixRows, ENTRY]
    b: Annotated[tuple[Scalar, ...], INPUT]
    c: Annotated[tuple[Scalar, ...], OUTPUT]
    disturbance: Annotated[tuple[Scalar, ...] | None, DISTURBANCE_INPUT] = None
    x0: Annotated[tuple[Scalar, ...], INITIAL_STATE] = ()
    outputs: Outputs = None
    inputs: Inputs = None
    d: Annotated[Scalar, FEEDTHROUGH] = 0.0
    degree: int | None = None
    disturbance_degree: int | None = None

    @property
    def disturbance_column(self) -> Column:
        """The input column of the disturbance, by default the command's."""
        return self.b if self.disturbance is None else self.disturbance


class RationalParams(NamedTuple):
    """G(s) from the command to the output, in controllable canonical form.

    Args:
        numerator: Coefficients, highest power first.
        denominator: Coefficients, highest power first.
        x0: First entries of the initial state; the others are zero, as all are at rest.
        degree: Relative degree, set by :func:`prepare_transfer_function`.
    """

    numerator: Annotated[tuple[Scalar, ...], PLANT_NUMERATOR]
    denominator: Annotated[tuple[Scalar, ...], PLANT_DENOMINATOR]
    x0: Annotated[tuple[Scalar, ...], INITIAL_STATE] = ()
    degree: int | None = None


class LinearState(NamedTuple):
    """The state x of a linear plant."""

    x: tuple[Scalar, ...]


def initial_state(x0: tuple[Scalar, ...], order: int) -> LinearState:
    """The state at t = 0: the entries ``x0``, filled up with zeros.

    Args:
        x0: First entries of the state.
        order: Number of states.
    """
    return LinearState((*x0, *(0.0,) * (order - len(x0))))


def state_space_dynamics(params: StateSpaceParams) -> LinearDynamics:
    """Return the plant's matrices: A, the columns of command and disturbance, and the columns of the named inputs."""
    columns = tuple(item.column for _, item in by_names(params.inputs))
    return LinearDynamics(a=params.a, command=(params.b,), disturbance=(params.disturbance_column,), inputs=columns)


def state_space_measure(params: StateSpaceParams, state: LinearState, drive: PlantInput) -> Measurement:
    """The output y = c x, and its derivative y' = c A x + c b u + c e d + the effect of the named inputs.

    Here u is the command, and d the disturbance with its column e. Where a relative degree is known to be above 1, the
    product c b or c e is 0 and is left out.
    """
    slope = dot(params.c, tuple(dot(row, state.x) for row in params.a))
    if params.degree == 1:
        slope = slope + dot(params.c, params.b) * drive.command
    if params.disturbance_degree == 1:
        slope = slope + dot(params.c, params.disturbance_column) * drive.disturbance
    for (_, item), value in zip(by_names(params.inputs), drive.inputs, strict=False):  # () stands for zeros
        slope = slope + dot(params.c, item.column) * value
    return Measurement(dot(params.c, state.x), slope)


def state_space_report(params: StateSpaceParams, state: LinearState, drive: PlantInput) -> Info:
    """The values of the outputs that the study names, for metrics and plots; () if it names none."""
    return output_report(params.outputs, params.inputs, state.x, drive, is_matched=params.disturbance is None)


def state_space_gain(params: StateSpaceParams) -> Scalar:
    """The high-frequency gain c A^(r-1) b: from the command to the r-th derivative of y, with the relative degree r."""
    degree = int(params.degree or 1)  # None before the plant is prepared
    column = params.b
    for _ in range(degree - 1):
        column = tuple(dot(row, column) for row in params.a)
    return dot(params.c, column)


def prepare_state_space(params: StateSpaceParams) -> StateSpaceParams:
    """Check all sizes, and set the relative degrees of the nominal plant.

    Raises:
        ConfigError: A size does not fit, y has a feedthrough, or the command does not reach y.
    """
    order = len(params.a)
    if params.d != 0.0:
        raise ConfigError("d", f"must be 0, got {params.d:g}: {DELAYED_BY_A_SAMPLE}")
    if not 1 <= order <= MOST_STATES:
        raise ConfigError("a", f"must have 1 to {MOST_STATES} rows, got {order}")
    for i, row in enumerate(params.a):
        if len(row) != order:
            raise ConfigError(f"a.{i}", f"must have {order} numbers, one for each row, got {len(row)}")
    for name in ("b", "c", "disturbance"):
        entries = getattr(params, name)
        if entries is not None and len(entries) != order:
            raise ConfigError(name, f"must have {order} numbers, one for each state, got {len(entries)}")
    require_start(params.x0, order)
    require_named(params.outputs, params.inputs, order)
    a = nominal_values(params.a)
    b = nominal_values(params.b)
    c = nominal_values(params.c)
    degree = relative_degree(RealisedSystem(a, b, c))
    if degree is None:
        raise ConfigError("c", "the command does not reach the output: c A^k b is zero for every k")
    disturbance_column = nominal_values(params.disturbance_column)
    disturbance_degree = relative_degree(RealisedSystem(a, disturbance_column, c))
    return params._replace(degree=degree, disturbance_degree=disturbance_degree)


def last_slope(params: RationalParams, state: LinearState) -> Scalar:
    """Derivative of the last state x_n without command and disturbance: -(a_0 x_1 + a_1 x_2 + ...)/a_n.

    The coefficient a_i of the denominator belongs to s^i.
    """
    leading, *lower = params.denominator
    return -dot(tuple(reversed(lower)), state.x) / leading


def transfer_function_dynamics(params: RationalParams) -> LinearDynamics:
    """Make the plant's matrices in controllable canonical form.

    The states obey x_i' = x_(i+1). Command and disturbance add to the derivative of the last state with gain 1. The
    numerator determines only the output (:func:`transfer_function_measure`).
    """
    leading, *lower = params.denominator
    order = len(lower)
    rows: list[tuple[Scalar, ...]] = []
    for i in range(1, order):
        rows.append(one_entry(1.0, i, order))
    rows.append(tuple(-coefficient / leading for coefficient in reversed(lower)))
    column = one_entry(1.0, order - 1, order)
    return LinearDynamics(a=tuple(rows), command=(column,), disturbance=(column,))


def transfer_function_measure(params: RationalParams, state: LinearState, drive: PlantInput) -> Measurement:
    """The output y = (b_0 x_1 + b_1 x_2 + ...)/a_n, and its derivative y'.

    The coefficients b_i of the numerator belong to s^i. Since x_i' = x_(i+1), only the derivative of the last state
    depends on command and disturbance.
    """
    rising = tuple(reversed(params.numerator))
    slope = (*state.x[1:], last_slope(params, state) + drive.command + drive.disturbance)
    count = len(rising)  # at most the number of states: the plant is strictly proper
    leading = params.denominator[0]
    return Measurement(dot(rising, state.x[:count]) / leading, dot(rising, slope[:count]) / leading)


def transfer_function_gain(params: RationalParams) -> Scalar:
    """The high-frequency gain b_m/a_n: from the command to the r-th derivative of y, with the relative degree r."""
    return params.numerator[0] / params.denominator[0]


def prepare_transfer_function(params: RationalParams) -> RationalParams:
    """The parameters with their relative degree, which must be those of a strictly proper plant.

    Raises:
        ConfigError: The plant is not strictly proper, has too many states or initial values, or has a leading
            coefficient that is 0.
    """
    order = len(params.denominator) - 1
    if not 1 <= order <= MOST_STATES:
        raise ConfigError("denominator", f"must have 2 to {MOST_STATES + 1} coefficients, got {order + 1}")
    if not 1 <= len(params.numerator) <= order:
        rule = f"must have 1 to {order} coefficients, fewer than the denominator, got {len(params.numerator)}"
        raise ConfigError("numerator", f"{rule}: {DELAYED_BY_A_SAMPLE}")
    for name in ("numerator", "denominator"):
        if nominal_values(getattr(params, name))[0] == 0.0:
            raise ConfigError(f"{name}.0", "is the coefficient of the highest power and must not be zero; leave it out")
    require_start(params.x0, order)
    return params._replace(degree=order + 1 - len(params.numerator))


def require_start(x0: tuple[Scalar, ...], order: int) -> None:
    """Require at most as many initial values as the plant has states.

    Args:
        x0: The initial values.
        order: Number of states.

    Raises:
        ConfigError: There are more.
    """
    if len(x0) > order:
        raise ConfigError("x0", f"must have at most {order} numbers, one for each state, got {len(x0)}")


def nominal_values(values: Any) -> Any:
    """Replace each law in numbers or rows of numbers by its median."""
    return tuple(nominal_values(value) if isinstance(value, tuple) else nominal(value) for value in values)


STATE_SPACE = Plant(
    StateSpaceParams,
    init=lambda params: initial_state(params.x0, len(params.a)),
    derivative=linear_derivative(state_space_dynamics),
    measure=state_space_measure,
    input_gain=state_space_gain,
    prepare=prepare_state_space,
    monitor=state_space_report,
    linear=state_space_dynamics,
    smooth=SMOOTH,
    outputs=lambda params: named_signals(params.outputs),
    inputs=lambda params: named_signals(params.inputs),
)
RATIONAL_PLANT = Plant(
    RationalParams,
    init=lambda params: initial_state(params.x0, len(params.denominator) - 1),
    derivative=linear_derivative(transfer_function_dynamics),
    measure=transfer_function_measure,
    input_gain=transfer_function_gain,
    prepare=prepare_transfer_function,
    linear=transfer_function_dynamics,
    smooth=SMOOTH,
)
