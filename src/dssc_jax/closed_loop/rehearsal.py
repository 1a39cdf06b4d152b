"""A trace of one sample before any simulation, which reports faults of user-defined parts by function and line."""

import inspect
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import CodeType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.plant_inputs import actuate, plant_input
from dssc_jax.closed_loop.repeatability import first_difference
from dssc_jax.closed_loop.sample import LoopState, step
from dssc_jax.core.contracts import Sensor
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.signals import Command, Measurement, Measurements, Params, ReferencePoints, State

NEW_LINE = "\n"
PACKAGE = __name__.partition(".")[0]  # dssc_jax
RESULTS_OF_STEP = 3  # of a controller: state, command, info
RESULTS_OF_SENSOR = 2  # state, reading
SLOTS_OF_CHANNELS = ("controller", "sensor", "differentiator", "unmodelled", "disturbance")
KEPT_VALUES = "a part keeps nothing between calls: what it has to remember is in the state that it returns"
TRACED_VALUES = (
    "a model's numbers are traced: write jnp.where(condition, a, b) for `if`, and functions of jax.numpy for those of "
    "math and NumPy"
)


class PartFunction(NamedTuple):
    """The role that a user's own function plays in a study.

    Args:
        part: The part of the study that the function belongs to, such as ``controller.x``.
        field: Name of the function among those of such a part, such as ``step``.
    """

    part: str
    field: str


def rehearse(loop: Loop, params: LoopParams) -> None:
    """Trace the first sample of a loop once, so that a fault in a user's part is found before any simulation.

    A loop without parts of the user's own passes at once.

    Args:
        loop: The models and the clock.
        params: Parameters of the models; numbers may be abstract.

    Raises:
        ConfigError: A user's function fails, a state changes its form, or the same call gives different values.
    """
    if not user_functions(loop):
        return
    key = jax.random.key(0)
    with faults_by_part(loop):
        check_results(loop, params)
        check_starts(loop, params)
        state = initial_state(loop, params, key)
        derivative = initial_derivative(loop, params, state)
        require_form("plant", "derivative", "the state's derivative", state.plant, derivative)
        next_state, _ = step(loop, params, key, state, 0)
        require_repeatable(loop, params)
    require_form("plant", "project", "the state", state.plant, next_state.plant)
    require_forms_of_steps(loop, state, next_state)


def require_forms_of_steps(loop: Loop, state: LoopState, next_state: LoopState) -> None:
    """Require that each part's ``step`` returns a state of the same form as the state that it takes.

    Args:
        loop: The models and the clock.
        state: The loop's state before the first sample.
        next_state: The state after the sample.

    Raises:
        ConfigError: A part returns another form.
    """
    for channel, name in enumerate(loop.channels):
        for slot in SLOTS_OF_CHANNELS:
            before = getattr(state.channels[channel], slot)
            after = getattr(next_state.channels[channel], slot)
            require_form(place_of(slot, name), "step", "the state", before, after)
    for measured, before, after in zip(loop.measures, state.signals, next_state.signals, strict=True):
        require_form(place_of("sensor", measured.name), "step", "the state", before, after)
    require_form("wind", "step", "the state", state.wind, next_state.wind)


def require_repeatable(loop: Loop, params: LoopParams) -> None:
    """Require that two traces of the first sample give the same program, as they do if all parts are pure functions.

    Raises:
        ConfigError: The traces differ, because a user's function draws random numbers, reads a clock, or counts its
            calls.
    """

    def program() -> Callable[[], tuple[LoopState, State, LoopState]]:
        """A new function object at each call, because JAX remembers the trace of an old one."""

        def first_sample() -> tuple[LoopState, State, LoopState]:
            """The state before the first sample, the plant's derivative there, and the state after the sample."""
            key = jax.random.key(0)
            state = initial_state(loop, params, key)
            next_state, _ = step(loop, params, key, state, 0)
            return state, initial_derivative(loop, params, state), next_state

        return first_sample

    codes = first_difference(program)
    if codes is None:  # both traces are the same
        return
    functions = user_functions(loop)
    calls = [functions[code] for code in codes if code in functions]  # outermost first
    if calls:
        part = calls[-1].part
        subject = f"`{calls[-1].field}` gives"
    else:
        part = part_names(functions)
        subject = "gives"
    raise ConfigError(
        part,
        f"{subject} other values when the same call is repeated, as with numpy.random, a clock or a counter. A part is "
        "a pure function, which is traced once: give what is random a law, a [[disturbance]] or a [sensor]",
    )


def check_starts(loop: Loop, params: LoopParams) -> None:
    """Require that the user's parts start at finite numbers.

    A number that follows from traced parameters has no value yet, and passes.

    Raises:
        ConfigError: A number of an initial state is infinite or NaN.
    """
    key = jax.random.key(0)
    user_parts = {function.part for function in user_functions(loop).values()}

    def check(part: str, init: Callable[..., State], *arguments: object) -> None:
        """Require finite numbers of ``init(*arguments)`` if the part is the user's own."""
        if part in user_parts:
            with jax.ensure_compile_time_eval():  # a constant array of the part has its value here
                require_finite_start(part, init(*arguments))

    check("plant", loop.plant.init, params.plant)
    check("wind", loop.wind.init, params.wind, key)
    measurements, references = signals_at_start(loop, params)
    for i, name in enumerate(loop.channels):
        seen = measurements[i]._replace(signals=(0.0,) * len(loop.measures))
        check(place_of("controller", name), loop.controller[i].init, params.controller[i], seen, references[i])
        check(place_of("sensor", name), loop.sensor[i].init, params.sensor[i], measurements[i], key)
        differentiator = loop.differentiator[i]
        check(place_of("differentiator", name), differentiator.init, params.differentiator[i], measurements[i])
        check(place_of("unmodelled", name), loop.unmodelled[i].init, params.unmodelled[i])
        check(place_of("disturbance", name), loop.disturbance[i].init, params.disturbance[i], key)
    for name, model, model_params in zip(loop.input_names, loop.inputs, params.inputs, strict=True):
        check(f"disturbance.{name}", model.init, model_params, key)
    for signal, model, model_params in zip(loop.measures, loop.signal_sensor, params.signal_sensor, strict=True):
        check(place_of("sensor", signal.name), model.init, model_params, Measurement(0.0, 0.0), key)


def require_finite_start(part: str, state: State) -> None:
    """Require that the numbers of an initial state are finite; a traced number has no value yet, and passes.

    Args:
        part: Path of the part in the study.
        state: Initial state of the part, any tree of numbers.

    Raises:
        ConfigError: A number is infinite or NaN; the message has its field.
    """
    for path, leaf in jax.tree_util.tree_flatten_with_path(state)[0]:
        is_number = isinstance(leaf, jax.Array | np.ndarray | np.generic | float | int)
        if not is_number or is_finite_or_traced(leaf):
            continue
        field = jax.tree_util.keystr(path, simple=True, separator=".") or "the state"
        raise ConfigError(
            part,
            f"`init` starts {field} at {np.asarray(leaf).tolist()}: a draw whose state is not finite has diverged and "
            "ends. Start it at a finite number, such as the first measurement for a running minimum, or add a field "
            "that tells whether it is set",
        )


def is_finite_or_traced(leaf: object) -> bool:
    """Whether a number or array is finite; a traced one has no value yet, and passes."""
    try:
        return bool(np.all(np.isfinite(np.asarray(leaf))))
    except jax.errors.TracerArrayConversionError:
        return True


def signals_at_start(loop: Loop, params: LoopParams) -> tuple[Measurements, ReferencePoints]:
    """Measurement and reference of each channel at t = 0, with commands and disturbances of 0."""
    plant = as_arrays(loop.plant.init(params.plant))
    measurements = loop.mimo_plant.measure(params.plant, plant, loop.zero_input(params.plant))
    return measurements, loop.mimo_reference.at(params.reference, 0.0)


def check_results(loop: Loop, params: LoopParams) -> None:
    """Require that plant, sensors and controllers return values of the right types.

    The plant must return measurements, each sensor a state and a reading, and each controller state, command and info.

    Raises:
        ConfigError: A part returns something else.
    """
    measurements, references = signals_at_start(loop, params)
    for channel, name in enumerate(loop.channels):
        require_form("plant", "measure", "the measurement", Measurement(0.0, 0.0), measurements[channel])
        sensor = loop.sensor[channel]
        sensor_params = params.sensor[channel]
        check_reading(sensor, sensor_params, measurements[channel], place_of("sensor", name), loop.sample_time)
        measurement = measurements[channel]._replace(signals=(0.0,) * len(loop.measures))
        model = loop.controller[channel]
        gains = params.controller[channel]
        state = as_arrays(model.init(gains, measurement, references[channel]))
        result = model.step(gains, state, measurement, references[channel], loop.sample_time)
        place = place_of("controller", name)
        if not isinstance(result, tuple) or len(result) != RESULTS_OF_STEP:
            raise ConfigError(place, f"`step` must return (state, command, info), got {form(result)}")
        _, command, _ = result
        require_form(place, "step", "the command", Command(0.0, 0.0), command)
    for signal, model, model_params in zip(loop.measures, loop.signal_sensor, params.signal_sensor, strict=True):
        place = place_of("sensor", signal.name)
        check_reading(model, model_params, Measurement(0.0, 0.0), place, loop.sample_time)


def check_reading(model: Sensor, params: Params, measurement: Measurement, place: str, dt: float) -> None:
    """Require that a sensor returns its state and a reading of numbers.

    Args:
        model: The sensor.
        params: Parameters of the sensor.
        measurement: A true measurement.
        place: Path of the sensor in the study.
        dt: Sample time T_s [s].

    Raises:
        ConfigError: The sensor returns something else.
    """
    key = jax.random.key(0)
    result = model.step(params, model.init(params, measurement, key), measurement, key, 0.0, dt)
    if not isinstance(result, tuple) or len(result) != RESULTS_OF_SENSOR:
        raise ConfigError(place, f"`step` must return (state, reading), got {form(result)}")
    _, reading = result
    require_form(place, "step", "the reading", Measurement(0.0, 0.0), reading)


def place_of(slot: str, channel: str) -> str:
    """Path of a channel's part in the study, such as ``controller.x``; for a channel without a name, the slot alone."""
    return f"{slot}.{channel}" if channel else slot


def initial_derivative(loop: Loop, params: LoopParams, state: LoopState) -> State:
    """The derivative of the plant's state at t = 0 under zero commands.

    Args:
        loop: The models and the clock.
        params: Parameters of the models.
        state: The loop's state before the first sample.
    """
    unmodelled = tuple(channel.unmodelled for channel in state.channels)
    zero_commands = (0.0,) * len(loop.channels)
    actuation = actuate(loop, params, unmodelled, zero_commands)
    condition = loop.condition(params, 0.0)
    drive = plant_input(loop, params, state.disturbances, state.wind, state.plant, actuation, 0.0, condition)
    return loop.mimo_plant.derivative(params.plant, state.plant, drive, 0.0)


def user_functions(loop: Loop) -> dict[CodeType, PartFunction]:
    """The functions of a loop's parts that users wrote, by their code objects.

    Tracebacks contain the code objects. A function is the user's own if its module does not belong to this package.
    """
    places = [("plant", loop.plant), ("reference", loop.reference), ("wind", loop.wind)]
    for slot in SLOTS_OF_CHANNELS:
        for name, model in zip(loop.channels, getattr(loop, slot), strict=True):
            places.append((place_of(slot, name), model))
    places += [(f"disturbance.{name}", model) for name, model in zip(loop.input_names, loop.inputs, strict=True)]
    signal_names = [signal.name for signal in loop.measures]
    places += [(f"sensor.{name}", model) for name, model in zip(signal_names, loop.signal_sensor, strict=True)]
    functions = {}
    for place, model in places:
        for field, function in model._asdict().items():
            function = inspect.unwrap(function) if callable(function) else None
            code = getattr(function, "__code__", None)
            if code is not None and function.__module__.partition(".")[0] != PACKAGE:
                functions[code] = PartFunction(place, field)
    return functions


def part_names(functions: dict[CodeType, PartFunction]) -> str:
    """The parts that some functions belong to, in words: ``controller.x and plant``."""
    return " and ".join(sorted({function.part for function in functions.values()}))


@contextmanager
def faults_by_part(loop: Loop) -> Iterator[None]:
    """A context in which an exception becomes an error that names the user's part, function and line.

    If the loop has no parts of the user's own, exceptions pass unchanged.

    Raises:
        ConfigError: In place of the exception.
    """
    try:
        yield
    except ConfigError:
        raise
    except Exception as error:  # user code may raise anything
        functions = user_functions(loop)
        if not functions:
            raise
        raise fault_of(error, functions) from error


def fault_of(error: Exception, functions: dict[CodeType, PartFunction]) -> ConfigError:
    """The error that tells users which of their functions failed, and in which line.

    The function is the user's innermost one on the exception's traceback. The line is the innermost one in a file of
    that function's folder. If no such function is on the traceback, the exception follows from a value that one
    returned.

    Args:
        error: The exception.
        functions: The user's functions by their code objects.
    """
    first_line = str(error).partition(NEW_LINE)[0].rstrip(".")
    message = f"{type(error).__name__}: {first_line}"
    fault = None
    folder = None
    line = ""
    for frame, number in traceback.walk_tb(error.__traceback__):
        file = Path(frame.f_code.co_filename)
        if frame.f_code in functions:
            fault = functions[frame.f_code]
            folder = file.parent
        if folder is not None and file.parent == folder:
            line = f"line {number} of {file}"
    if fault is None:
        rule = f"does not fit the loop: {message}; docs/extending.md tells what each function returns"
        return ConfigError(part_names(functions), rule)
    if isinstance(error, jax.errors.UnexpectedTracerError):
        remedy = f"; {KEPT_VALUES}"
    elif isinstance(error, jax.errors.JAXTypeError):
        remedy = f"; {TRACED_VALUES}"
    else:
        remedy = ""
    return ConfigError(fault.part, f"`{fault.field}` fails in {line}: {message}{remedy}")


def require_form(part: str, field: str, meaning: str, expected: object, result: object) -> None:
    """Require that the result of a part's function has the expected fields and shapes.

    Args:
        part: Path of the part in the study.
        field: Name of the function in its contract.
        meaning: What the function returns, for the message.
        expected: A value of the expected form.
        result: The function's result.

    Raises:
        ConfigError: The result has another form.
    """
    if form(result) != form(expected):
        raise ConfigError(part, f"`{field}` must return {meaning} as {form(expected)}, got {form(result)}")


def form(value: object) -> str:
    """Type, fields and shapes of a value in words, such as ``Command(robust=number, nominal=number)``."""
    names = getattr(value, "_fields", None)
    if isinstance(value, tuple) and names is not None:
        fields = [f"{name}={form(field)}" for name, field in zip(names, value, strict=True)]
        return f"{type(value).__name__}({', '.join(fields)})"
    if isinstance(value, tuple | list):
        return f"({', '.join(map(form, value))})"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{name}: {form(item)}' for name, item in value.items())}}}"
    if not isinstance(value, jax.Array | np.ndarray | np.generic | float | int):
        return type(value).__name__
    shape = jnp.shape(value)
    return f"array of shape {shape}" if shape else "number"
