"""The part of a loop that runs on a flight computer, traced by itself: differentiator and controller of one channel."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import keystr, tree_flatten_with_path

from dssc_jax.closed_loop.control import ControlState, control, initial_control, transfer_control
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.signals import Command, Measurement, ReferencePoint, Scalar
from dssc_jax.flight_code.parameters import Parameter, loop_parameters
from dssc_jax.lanes.c.names import member_names, prefix_name, underscored
from dssc_jax.lanes.c.operations import c_type
from dssc_jax.lanes.program import Program
from dssc_jax.lanes.tracing.origins import Origin, translate_with_origins
from dssc_jax.lanes.unsupported import Unsupported
from dssc_jax.study import Study

FLOWN_SLOTS = ("controller", "differentiator")
"""Parts of a channel that run on the flight computer as generated code, by their names in a study."""
COMMAND = ("u", "u_n", "u_p")
"""Names of the parts of a command: robust part u, nominal part u_n, and their sum u_p (11)."""

OF_CHANNEL = ("y", "y_dot")
"""Names of the measured signals that every controller takes."""


class MeasuredSignal(NamedTuple):
    """A member of a controller's measurement.

    Args:
        name: Name in C.
        unit: Unit.
        meaning: Meaning in words.
        signal: Name in the study of a signal beside y and y'; empty for y and y'.
    """

    name: str
    unit: str
    meaning: str
    signal: str = ""


def measured_signals(study: Study, index: int) -> tuple[MeasuredSignal, ...]:
    """The measured signals of a channel's controller: y, y' and, if it takes any, those of the study's ``measures``.

    Args:
        study: The study.
        index: Position of the channel in the loop.
    """
    units = study.units[index]
    y, y_dot = OF_CHANNEL
    signals = [
        MeasuredSignal(y, units.output, f"measured {units.output_meaning}"),
        MeasuredSignal(y_dot, units.of("y/s"), f"derivative of measured {units.output_meaning}"),
    ]
    if takes_signals(study):
        measures = study.loop.measures
        _, _, *names = member_names([y, y_dot, *(f"signal_{measure.name}" for measure in measures)])
        for name, measure in zip(names, measures, strict=True):
            unit = measure.unit or "1"  # of a number without a unit
            signals.append(MeasuredSignal(name, unit, f"measured {measure.quantity.meaning}", measure.name))
    return tuple(signals)


def takes_signals(study: Study) -> bool:
    """Whether any controller of a study, with its gains, takes measured signals beside y and y'.

    The answer is one for all channels: if one controller takes the signals, the measurement of every channel has them.
    """
    controllers_with_gains = zip(study.loop.controller, study.template.controller, strict=True)
    return any(controller.takes(gains) for controller, gains in controllers_with_gains)


class TracedFunction(NamedTuple):
    """A traced function, from which C is written.

    Args:
        program: The program; its inputs are the leaves of the function's arguments.
        origins: Place in the models' source where each value is computed, by the value's id.
    """

    program: Program
    origins: dict[int, Origin]


def traced_function(function: Callable[..., Any], *shapes: Any) -> tuple[TracedFunction, Any]:
    """Trace a function into a program that can be written in C.

    Args:
        function: A function of trees of scalars.
        shapes: Shape and type of each argument.

    Returns:
        The traced function, and the tree of its results.

    Raises:
        Unsupported: An operation has no exact form in C.
    """
    program, results, origins = translate_with_origins(function, *shapes)
    return TracedFunction(program, origins), results


@dataclass(frozen=True)
class SampledController:
    """The traced differentiator and controller of one channel.

    Args:
        channel: Name of the channel; empty for a plant with one channel.
        index: Position of the channel.
        prefix: Prefix of the controller's functions and types in C.
        parameters: Numbers that may be changed in flight.
        states: Names in C of the states of differentiator and controller.
        infos: Names in C of the telemetry.
        start: ``(parameters, signals) -> states`` before the first sample.
        step: ``(parameters, states, signals) -> (states, command, telemetry)``.
        transfer: ``(parameters, command, signals) -> (states, command)``: states from which the first step gives the
            wanted command, and the command that this step gives. None: the controller's state cannot carry a command.
        precision: Bits of a number.
        measured_signals: The members of the measurement.
    """

    channel: str
    index: int
    prefix: str
    parameters: tuple[Parameter, ...]
    states: tuple[str, ...]
    infos: tuple[str, ...]
    start: TracedFunction
    step: TracedFunction
    transfer: TracedFunction | None
    precision: int
    measured_signals: tuple[MeasuredSignal, ...]

    @property
    def signals(self) -> tuple[str, ...]:
        """C's expressions of the inputs at each sample: measurement, then reference."""
        measurement = (f"measurement.{signal.name}" for signal in self.measured_signals)
        return (*measurement, *(f"reference.{name}" for name in ReferencePoint._fields))

    @property
    def real(self) -> np.dtype:
        """The dtype of its numbers."""
        return np.dtype(f"float{self.precision}")

    @property
    def c_real(self) -> str:
        """C's type of its numbers."""
        return c_type(self.real)

    @property
    def smallest_difference(self) -> np.floating:
        """The largest difference of two commands near 0 that counts as none, in the command's unit.

        A bumpless start compares the wanted command with the command of the first step. The comparison ignores
        differences up to this number, because a relative tolerance is 0 at the command 0.
        """
        return self.real.type(1e-6 if self.precision == 32 else 1e-9)


@dataclass(frozen=True)
class FlightCode:
    """The data from which all files of generated code are written.

    Args:
        study: The study, without a sweep.
        controllers: The controller of each channel.
        certificate: The verdict of Theorem 1 on the study, in a sentence.
    """

    study: Study
    controllers: list[SampledController]
    certificate: str

    @property
    def name(self) -> str:
        """The study's name as an identifier of C."""
        return prefix_name(self.study.name)

    @property
    def precision(self) -> int:
        """Bits of a number."""
        return self.study.config.loop.precision


def sampled_controllers(study: Study) -> list[SampledController]:
    """Trace the controllers of a study, one for each channel; errors as for :func:`trace_controller`."""
    with arithmetic(study.config.loop.precision):
        return [trace_controller(study, index) for index in range(len(study.loop.channels))]


def trace_controller(study: Study, index: int) -> SampledController:
    """Trace the start, the step and, if it has one, the transfer of a channel's controller.

    Args:
        study: The study, without a sweep.
        index: Position of the channel in the loop.

    Raises:
        ConfigError: The controller is native code already, it keeps a state that is no real number, or one of its
            operations has no exact form in C.
    """
    loop = study.loop
    place = f"controller.{loop.channels[index]}".rstrip(".")
    native_description = loop.controller[index].native
    if native_description:
        raise ConfigError(place, f"is native code already: {native_description}")
    parameters = channel_parameters(study, index)
    keys = [parameter.key for parameter in parameters]

    # Generated C would repeat docstrings of these functions; SampledController tells what the last three compute.

    def params_of(numbers: tuple[Scalar, ...]) -> Any:
        return study.params(dict(zip(keys, numbers, strict=True)))

    def start(numbers: tuple[Scalar, ...], measurement: Measurement, reference: ReferencePoint) -> Any:
        return as_arrays(initial_control(loop, params_of(numbers), index, measurement, reference))

    def step(
        numbers: tuple[Scalar, ...], state: ControlState, measurement: Measurement, reference: ReferencePoint
    ) -> Any:
        params = params_of(numbers)
        after, controlled = control(loop, params, index, state, measurement, reference)
        return as_arrays((after, command_parts(controlled.command), controlled.info))

    def transfer(
        numbers: tuple[Scalar, ...], command: Scalar, measurement: Measurement, reference: ReferencePoint
    ) -> Any:
        params = params_of(numbers)
        state = transfer_control(loop, params, index, measurement, reference, command)
        assert state is not None  # traced only if the controller has a transfer
        _, controlled = control(loop, params, index, state, measurement, reference)
        return as_arrays((state, command_parts(controlled.command)))

    number: Any = jax.ShapeDtypeStruct((), jnp.result_type(float))
    numbers = (number,) * len(keys)
    channel_signals = measured_signals(study, index)
    further_signals = (number,) * (len(channel_signals) - len(OF_CHANNEL))  # beside y and y'
    signals = (Measurement(number, number, further_signals), ReferencePoint(number, number, number))
    traced_transfer = None
    require_real_numbers(loop.channels[index], jax.eval_shape(start, numbers, *signals))
    try:
        traced_start, state = traced_function(start, numbers, *signals)
        state = jax.tree.map(lambda leaf: number, state)
        traced_step, (_, _, info) = traced_function(step, numbers, state, *signals)
        if loop.controller[index].transfer is not None:
            traced_transfer, _ = traced_function(transfer, numbers, number, *signals)
    except Unsupported as problem:
        raise ConfigError(place, f"has no exact form in C: {problem}") from None
    label = channel_labels(loop.channels)[index]
    return SampledController(
        channel=loop.channels[index],
        index=index,
        prefix=f"{prefix_name(study.name)}_{label}" if label else prefix_name(study.name),
        parameters=parameters,
        states=leaf_names(state, root="controller"),
        infos=leaf_names(info),
        start=traced_start,
        step=traced_step,
        transfer=traced_transfer,
        precision=study.config.loop.precision,
        measured_signals=channel_signals,
    )


def require_real_numbers(channel: str, state: ControlState) -> None:
    """Require that every state of a channel's software is a real number, the only type that generated code keeps.

    Args:
        channel: Name of the channel; empty for a plant with one channel.
        state: Shapes and types of the state as the loop keeps it; the loop has already turned signed integers and flags
            into real numbers.

    Raises:
        ConfigError: A state is an array or an unsigned integer; the message has its field.
    """
    leaves, _ = tree_flatten_with_path(state)
    for path, leaf in leaves:
        if leaf.shape == () and jnp.issubdtype(leaf.dtype, jnp.floating):
            continue
        slot, _, field = keystr(path, simple=True, separator=".").partition(".")  # such as "controller", "z.value"
        if leaf.shape:
            kind = f"an array of shape {leaf.shape}"
            remedy = "keep its numbers in fields of their own, such as a tuple"
        else:
            kind = f"{leaf.dtype}, which wraps"
            remedy = "keep a counter as an int, and write where it begins again: jnp.where(n >= 255, 0, n + 1)"
        raise ConfigError(
            f"{slot}.{channel}".rstrip("."),
            f"keeps {field or 'its state'} as {kind}; generated code keeps single real numbers, which the loop makes "
            f"of float, int and bool: {remedy}",
        )


def command_parts(command: Command) -> tuple[Scalar, Scalar, Scalar]:
    """The parts of a command and their sum, in the order of :data:`COMMAND`."""
    return command.robust, command.nominal, command.total


def channel_parameters(study: Study, index: int) -> tuple[Parameter, ...]:
    """The parameters of a channel's code: the numbers of its differentiator and its controller.

    Args:
        study: The study.
        index: Position of the channel in the loop.
    """
    channel = study.loop.channels[index]

    def is_of_channel(path: str) -> bool:
        """Whether a number of the loop belongs to the channel; a path is SLOT.POSITION OF THE CHANNEL.FIELD."""
        slot, position, *_ = path.split(".")
        return slot in FLOWN_SLOTS and int(position) == index

    def name_in_c(key: str) -> str:
        """The name in C of a number: its path without slot and channel; only ``differentiator`` stays in front.

        The second part of the path may be the channel's name or position, which is left out, too.
        """
        slot, *fields = key.split(".")
        if fields[0] in {str(index), channel}:
            fields = fields[1:]
        return "_".join(fields if slot == "controller" else [slot, *fields])

    return loop_parameters(study, is_of_channel, name_in_c, study.units[index])


def leaf_names(tree: Any, root: str = "") -> tuple[str, ...]:
    """A name in C for each leaf of a tree: the fields of its path, without a first field that is ``root``.

    Args:
        tree: A tree of named tuples.
        root: A first field to leave out; the default leaves out none.
    """
    names = []
    leaves, _ = tree_flatten_with_path(tree)
    for path, _ in leaves:
        fields = keystr(path, simple=True, separator=".").split(".")
        names.append("_".join(fields[1:] if fields[0] == root else fields))
    return tuple(member_names(names))


def channel_labels(channels: tuple[str, ...]) -> list[str]:
    """The part of names in C for each channel, numbered where two would be equal; empty for an unnamed channel.

    Args:
        channels: Name of each channel in the study, which may have characters that C does not allow in names.
    """
    labels: list[str] = []
    for channel in channels:
        base = underscored(channel)
        if channel and not base:  # no character of its name may be in a name of C
            base = "channel"
        label = base
        count = 2
        while label in labels:
            label = f"{base}_{count}"
            count += 1
        labels.append(label)
    return labels


def study_values(controllers: Sequence[SampledController]) -> dict[str, float]:
    """The study's values of the parameters of all controllers, by key."""
    values = {}
    for controller in controllers:
        values |= {parameter.key: parameter.value for parameter in controller.parameters}
    return values
