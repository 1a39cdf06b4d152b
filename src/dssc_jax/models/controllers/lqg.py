"""LQG: a steady-state Kalman filter and a linear-quadratic regulator, both of the sampled nominal plant.

With the command held, the plant is x(k+1) = A x(k) + B u(k) + w. The measured signals are s = C x + D u(k-1) + v,
because they are taken just before the new command acts. At each sample,

    x^ = x- + L (s - C x- - D u(k-1)),   u = -K x^ - k_i z + N y_m within its limits,
    x-(k+1) = A x^ + B u,                z(k+1) = z + T_s (y - y_m).

About an operating point (y_0, u_0, s_0) other than 0, the deviations u - u_0, s - s_0 and y_m - y_0 stand in these
formulas. The model is the plant if that is linear, or the table ``model``, such as a linearisation at that point.

K and k_i minimise the sum over the samples of q_y y^2 + sum of q_i x_i^2 + q_z z^2 + r u^2. L is the gain of the filter
with the least variance for the stated standard deviations of w and v. A discrete algebraic Riccati equation gives each
of them when the study is built, with the median in place of each law, so that every draw has the controller of the
nominal plant. N makes the gain from y_m to y at rest equal to 1; if the plant has a zero at z = 1, N is 0. While the
command is at a limit, z does not integrate errors that drive the command further.

In units, y stands for the unit of the plant's output, and u for the unit of its command.

References:
    G. F. Franklin, J. D. Powell, M. Workman, Digital Control of Dynamic Systems, 3rd ed. (1998), chapters 8 and 9.
    K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed. (1997), chapter 11.
"""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np

from dssc_jax.core.contracts import Controller
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import difference, dot, is_zero
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry, single
from dssc_jax.core.setting import LoopSetting, NominalPlant
from dssc_jax.core.signals import Command, Measurement, ReferencePoint, Scalar
from dssc_jax.models.controllers.command_limits import HIGH, LOW, smooth_within_limits, within_limits
from dssc_jax.models.controllers.linear_quadratic import (
    SampledPlant,
    filter_gain,
    gain_at_rest,
    regulator_gain,
    sampled_system,
)
from dssc_jax.models.controllers.nominal import L0
from dssc_jax.models.controllers.operating_point import (
    RESTING_COMMAND,
    RESTING_OUTPUT,
    RESTING_SIGNALS,
    deviations,
    require_resting,
)

STATE_WEIGHTS = Quantity("SI", "weight q_i of each state's square; absent: 0", at_least=0.0, law=False)
OUTPUT_WEIGHT = Quantity("1/y^2", "weight q_y of y^2", at_least=0.0, law=False)
COMMAND_WEIGHT = Quantity("1/u^2", "weight r of u^2", above=0.0, law=False)
INTEGRAL_WEIGHT = Quantity("1/(y^2 s^2)", "weight q_z of z^2; 0: no integral action", at_least=0.0, law=False)
DISTURBANCE_STD = Quantity(
    "SI",
    "standard deviation of the disturbance, then of that at each named input; absent: 0",
    at_least=0.0,
    law=False,
)
STATE_STD = Quantity("SI", "standard deviation of each state's noise in a sample; absent: 0", at_least=0.0, law=False)
SIGNAL_STD = Quantity(
    "SI", "standard deviation of each measured signal's noise; of y without any", above=0.0, law=False
)

MODEL_A = Quantity("SI", "entry of A, row by row", law=False)
MODEL_B = Quantity("SI", "entry of the command's column", law=False)
MODEL_C = Quantity("SI", "entry of y's row", law=False)
MODEL_SIGNALS = Quantity("SI", "entry of each measured signal's row; absent: y alone is measured", law=False)
MODEL_FEEDTHROUGH = Quantity("SI", "feedthrough of the command to each measured signal; absent: 0", law=False)
MODEL_DISTURBANCES = Quantity(
    "SI", "entry of each disturbance's column, beside the command first; absent: the command's", law=False
)

Row = tuple[Scalar, ...]
Rows = tuple[Row, ...]


class LqgModel(NamedTuple):
    """The linear model x' = A x + b u + E w, y = c x, s = C x + D u that a study states for the design.

    The model is in continuous time, and its signals are deviations from the operating point. The field ``signals`` is
    C, ``feedthrough`` is D, and ``disturbances`` are the columns of E.
    """

    a: Annotated[Rows, MODEL_A]
    b: Annotated[Row, MODEL_B]
    c: Annotated[Row, MODEL_C]
    signals: Annotated[Rows, MODEL_SIGNALS] = ()
    feedthrough: Annotated[Row, MODEL_FEEDTHROUGH] = ()
    disturbances: Annotated[Rows, MODEL_DISTURBANCES] = ()


class LqgGains(NamedTuple):
    """Weights and standard deviations of the design, and the controller that :func:`fit` computes from them.

    ``l0`` defines sigma of the metrics; the controller does not use it. The fields after ``l0`` are computed:

    * ``transition``, ``input``, ``signals`` and ``feedthrough`` are A, B, C and D of the sampled plant;
    * ``feedback``, ``correction``, ``integral_gain`` and ``feedforward`` are the gains K, L, k_i and N;
    * ``taken`` is the number of measured signals, or 0 if y alone is measured.
    """

    command_weight: Annotated[Scalar, COMMAND_WEIGHT]
    signal_std: Annotated[Row, SIGNAL_STD]
    output_weight: Annotated[Scalar, OUTPUT_WEIGHT] = 0.0
    state_weights: Annotated[Row, STATE_WEIGHTS] = ()
    integral_weight: Annotated[Scalar, INTEGRAL_WEIGHT] = 0.0
    disturbance_std: Annotated[Row, DISTURBANCE_STD] = ()
    state_std: Annotated[Row, STATE_STD] = ()
    low: Annotated[Scalar | None, LOW] = None
    high: Annotated[Scalar | None, HIGH] = None
    resting_output: Annotated[Scalar, RESTING_OUTPUT] = 0.0
    resting_command: Annotated[Scalar, RESTING_COMMAND] = 0.0
    resting_signals: Annotated[Row, RESTING_SIGNALS] = ()
    model: LqgModel | None = None
    l0: Annotated[Scalar, L0] = 1.0
    # computed
    transition: Rows = ()
    input: Row = ()
    signals: Rows = ()
    feedthrough: Row = ()
    feedback: Row = ()
    correction: Rows = ()
    integral_gain: Scalar = 0.0
    feedforward: Scalar = 0.0
    taken: int = 0


class LqgState(NamedTuple):
    """The predicted state x- of the plant, the integral z of the error y - y_m, and the last command u [u]."""

    predicted: Row
    integral: Scalar
    command: Scalar


class LqgInfo(NamedTuple):
    """What the controller reports: the integral part of the command, and the first innovation s - C x- - D u(k-1)."""

    integral: Annotated[Scalar, Quantity("u", "integral term of u")]
    innovation: Annotated[Scalar, Quantity("SI", "innovation of the first measured signal")]


def feedback_row(plant: SampledPlant, output: np.ndarray, gains: LqgGains, sample_time: float) -> np.ndarray:
    """The feedback K of the state, shape (n,), or K followed by k_i if the error is integrated, shape (n + 1,).

    Args:
        plant: The sampled plant.
        output: Row c of y, shape (n,).
        gains: Weights of the design.
        sample_time: T_s [s].

    Raises:
        ConfigError: There are too many or too few weights, or no feedback stabilises the plant.
    """
    order = len(plant.a)
    a = plant.a
    b = plant.b[:, None]
    weights = numbers_or_zeros("state_weights", gains.state_weights, order)
    q = np.diag(weights) + gains.output_weight * np.outer(output, output)
    if gains.integral_weight:  # one more state, z(k+1) = z + T_s y
        column = np.zeros((order, 1))
        a = np.block([[a, column], [sample_time * output[None, :], np.ones((1, 1))]])
        b = np.vstack([b, [[0.0]]])
        q = np.block([[q, column], [column.T, gains.integral_weight * np.ones((1, 1))]])
    return regulator_gain(a, b, q, float(gains.command_weight))


def correction_matrix(plant: SampledPlant, rows: np.ndarray, gains: LqgGains) -> np.ndarray:
    """The filter's gain L, shape (n, m), which turns the innovations of the measured signals into a correction of x.

    Args:
        plant: The sampled plant.
        rows: Rows of C of the measured signals, shape (m, n).
        gains: Standard deviations of the design.

    Raises:
        ConfigError: There are too many or too few numbers, or the measured signals do not show a mode of A.
    """
    count = plant.disturbances.shape[1]
    quiet_inputs = (0.0,) * (count - len(gains.disturbance_std))  # no noise at named inputs that the study leaves out
    disturbance_std = np.array(numbers_or_zeros("disturbance_std", (*gains.disturbance_std, *quiet_inputs), count))
    state_variance = np.diag(np.square(numbers_or_zeros("state_std", gains.state_std, len(plant.a))))
    process_covariance = plant.disturbances @ np.diag(disturbance_std**2) @ plant.disturbances.T + state_variance
    measurement_covariance = np.diag(np.square(numbers_or_zeros("signal_std", gains.signal_std, len(rows))))
    return filter_gain(plant.a, rows, process_covariance, measurement_covariance)


def numbers_or_zeros(name: str, values: Row, count: int) -> tuple[float, ...]:
    """The values of the field ``name`` as plain numbers, or ``count`` zeros if it has none.

    Args:
        name: Name of the field, for the message.
        values: The values; () if the study gives none.
        count: Required number of values.

    Raises:
        ConfigError: The field has values, but not ``count`` of them.
    """
    if values and len(values) != count:
        raise ConfigError(name, f"must have {count} numbers, got {len(values)}")
    return tuple(map(float, values)) or (0.0,) * count


def require_lengths(name: str, rows: Rows, count: int) -> None:
    """Require ``count`` numbers in each row of a matrix of the table ``model``; raises ConfigError.

    Args:
        name: Name of the matrix in the table.
        rows: The matrix, row by row.
        count: Required number of columns.
    """
    for row in rows:
        if len(row) != count:
            raise ConfigError(f"model.{name}", f"must have {count} numbers in a row, got {len(row)}")


def plant_of_model(model: LqgModel, setting: LoopSetting) -> NominalPlant:
    """The plant of the table ``model``; raises ConfigError if the sizes of its matrices do not fit.

    Without columns of disturbances, a disturbance acts as the command does.

    Args:
        model: The table.
        setting: What the loop states: its measured signals and the names of the plant's inputs.
    """
    order = len(model.a)
    columns = model.disturbances or (model.b,)
    rows = model.signals
    require_lengths("a", model.a, order)
    require_lengths("b", (model.b,), order)
    require_lengths("c", (model.c,), order)
    require_lengths("signals", rows, order)
    require_lengths("disturbances", columns, order)
    if model.feedthrough:
        require_lengths("feedthrough", (model.feedthrough,), len(rows))
    if len(rows) != len(setting.measures):
        rule = f"must have a row for each of the {len(setting.measures)} measured signals, got {len(rows)}"
        raise ConfigError("model.signals", rule)
    return NominalPlant(
        a=np.array(model.a, float),
        command=np.array(model.b, float),
        disturbances=np.array(columns, float).T,
        output=np.array(model.c, float),
        signals=np.reshape(np.array(rows, float), (len(rows), order)),
        feedthrough=np.array(numbers_or_zeros("model.feedthrough", model.feedthrough, len(rows))),
        inputs=() if setting.plant is None else setting.plant.inputs,
    )


def require_signal_stds(gains: LqgGains, count: int, measures: tuple[str, ...]) -> None:
    """Require a standard deviation for each of ``count`` measured signals; raises ConfigError.

    Args:
        gains: The gains.
        count: Number of measured signals; 1 if y alone is measured.
        measures: Names of the measured signals; () if y alone is measured.
    """
    if len(gains.signal_std) == count:
        return
    names = ", ".join(measures) or "y"
    rule = f"must have a number for each measured signal ({names}), got {len(gains.signal_std)}"
    if measures and "y" not in measures:
        rule = f"{rule}; to measure y as well, add it to [sensor] measures"
    raise ConfigError("signal_std", rule)


def fit(gains: LqgGains, setting: LoopSetting) -> LqgGains:
    """The gains with the regulator and the filter of the nominal plant, or of the table ``model`` if there is one.

    Args:
        gains: Weights and standard deviations of the design.
        setting: The nominal plant, the sample time and the measured signals of the loop.

    Raises:
        ConfigError: There is no linear plant, numbers do not fit its sizes, or a Riccati equation has no solution.
    """
    plant = setting.plant if gains.model is None else plant_of_model(gains.model, setting)
    if plant is None:
        rule = "'lqg' needs a linear plant with one command, such as kind = 'state_space', or a linear model of it"
        raise ConfigError("kind", f"{rule} in [controller.model], as `design --controller lqg` writes it")
    require_resting(gains.resting_signals, len(setting.measures))
    measures_y_alone = not setting.measures
    rows = plant.output[None, :] if measures_y_alone else plant.signals
    feedthrough = np.zeros(1) if measures_y_alone else plant.feedthrough
    require_signal_stds(gains, len(rows), setting.measures)
    columns = np.column_stack([plant.command, plant.disturbances])
    discrete = sampled_system(plant.a, columns, setting.sample_time)
    order = len(discrete.a)
    feedback = feedback_row(discrete, plant.output, gains, setting.sample_time)
    return gains._replace(
        transition=plain_rows(discrete.a),
        input=tuple(map(float, discrete.b)),
        signals=plain_rows(rows),
        feedthrough=tuple(map(float, feedthrough)),
        feedback=tuple(map(float, feedback[:order])),
        correction=plain_rows(correction_matrix(discrete, rows, gains)),
        integral_gain=float(feedback[order]) if len(feedback) > order else 0.0,
        feedforward=gain_at_rest(discrete, plant.output, feedback[:order]),
        taken=len(setting.measures),
    )


def plain_rows(matrix: np.ndarray) -> Rows:
    """A matrix as a tuple of rows of plain numbers, as gains hold it."""
    return tuple(tuple(map(float, row)) for row in matrix)


def init(gains: LqgGains, measurement: Measurement, reference: ReferencePoint) -> LqgState:
    """The state at the first sample: predicted state, integral and last command are 0.

    The controller does not use the first measurement and reference.
    """
    return LqgState(predicted=(0.0,) * len(gains.input), integral=0.0, command=0.0)


def step(
    gains: LqgGains, state: LqgState, measurement: Measurement, reference: ReferencePoint, dt: Scalar
) -> tuple[LqgState, Command, LqgInfo]:
    """One sample: correct, command, predict.

    The measured signals correct the predicted state to an estimate. The command follows from the estimate, the integral
    and the reference, within its limits. The model then predicts the state at the next sample. The integral does not
    take an error that drives the command further beyond a limit.
    """
    # signals and the last command as deviations from the operating point
    shown = (difference(measurement.y, gains.resting_output),)
    if measurement.signals:
        shown = deviations(measurement.signals, gains.resting_signals)
    command = difference(state.command, gains.resting_command)
    innovations = []
    for row, feedthrough, signal in zip(gains.signals, gains.feedthrough, shown, strict=True):
        innovations.append(signal - dot((*row, feedthrough), (*state.predicted, command)))
    estimate = []
    for x, row in zip(state.predicted, gains.correction, strict=True):
        estimate.append(x + dot(row, innovations))
    error = measurement.y - reference.y
    integral_part = -gains.integral_gain * state.integral
    desired = difference(reference.y, gains.resting_output)
    v = integral_part + gains.feedforward * desired - dot(gains.feedback, estimate)
    if not is_zero(gains.resting_command):  # from the deviation to the command itself
        v = v + gains.resting_command
    u = within_limits(v, gains.low, gains.high)
    change = dt * error
    if gains.low is not None or gains.high is not None:
        # integrating the error changes v by -k_i error; at a limit, away from u if the product is positive
        drives_further = gains.integral_gain * error * (u - v) > 0.0
        change = jnp.where(drives_further, 0.0, change)
    predicted = []
    for row, entry in zip(gains.transition, gains.input, strict=True):
        predicted.append(dot((*row, entry), (*estimate, difference(u, gains.resting_command))))
    after = LqgState(tuple(predicted), state.integral + change, u)
    return after, Command(robust=u, nominal=0.0), LqgInfo(integral_part, innovations[0])


def transfer(
    gains: LqgGains, measurement: Measurement, reference: ReferencePoint, command: Scalar, dt: Scalar
) -> LqgState:
    """The integral that gives a command, with a state that the measurement does not correct; 0 without integral.

    Without an integral gain the integral is 0. With one, the first step from the returned state gives the command, for
    a bumpless start: the command without integral and limits shows what the integral must add.
    """
    start = init(gains, measurement, reference)
    _, unlimited, _ = step(gains._replace(low=None, high=None), start, measurement, reference, dt)
    acts = gains.integral_gain != 0.0
    gain = jnp.where(acts, gains.integral_gain, 1.0)
    return start._replace(integral=jnp.where(acts, (unlimited.robust - command) / gain, 0.0))


LQG: Entry = single(
    Controller(
        gains=LqgGains,
        init=init,
        step=step,
        transfer=transfer,
        smooth=smooth_within_limits(init, step),
        takes=lambda gains: gains.taken,
        fit=fit,
        info=LqgInfo,
    ),
    "Kalman filter and linear-quadratic regulator of the sampled nominal plant",
    command_weight=1.0,
    output_weight=4.0,
    integral_weight=2.0,
    signal_std=[0.01],
    disturbance_std=[0.5],
    low=-9.0,
)
