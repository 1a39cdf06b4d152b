"""The part of a loop that runs on a flight computer, traced by itself: differentiator and controller of one channel."""

from collections.abc import Sequence
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
COMMAND = ("u", "u_n", "u_p")
"""The command in its two parts and their sum (11)."""

OF_CHANNEL = ("y", "y_dot")
"""Names of the signals that every controller measures."""


class MeasuredSignal(NamedTuple):
    """A member of a controller's measurement."""

    name: str  # in C
    unit: str
    meaning: str
    signal: str = ""  # its name in the study, of one that is measured beside y and y'


def measured_signals(study: Study, index: int) -> tuple[MeasuredSignal, ...]:
    """The measurement of a channel's controller: y, y' and, if the controller takes some, the measured signals."""
    loop = study.loop
    units = study.units[index]
    y, y_dot = OF_CHANNEL
    signals = [MeasuredSignal(y, units.output, f"measured {units.output_meaning}")]
    signals.append(MeasuredSignal(y_dot, units.of("y/s"), f"derivative of measured {units.output_meaning}"))
    if takes_signals(study):
        names = member_names([*OF_CHANNEL, *(f"signal_{signal.name}" for signal in loop.measures)])
        for name, signal in zip(list(names)[len(OF_CHANNEL) :], loop.measures, strict=True):
            signals.append(MeasuredSignal(name, signal.unit or "1", f"measured {signal.quantity.meaning}", signal.name))
    return tuple(signals)


def takes_signals(study: Study) -> bool:
    """Whether a controller takes measured signals beside y and y'."""
    pairs = zip(study.loop.controller, study.template.controller, strict=True)
    return any(controller.takes(gains) for controller, gains in pairs)


class TracedFunction(NamedTuple):
    """A traced function of the controller; its inputs are parameters, states (of a step) and signals, in this order."""

    program: Program
    origins: dict[int, Origin]  # where the model computes each value


@dataclass(frozen=True)
class SampledController:
    """The controller of one channel.

    ``start`` is (parameters, signals) -> states before the first sample. ``step`` is (parameters, states, signals) ->
    states, command, telemetry. ``transfer`` is (parameters, command, signals) -> states whose first step gives the
    command, and the command that it gives; None if the controller's state cannot carry a command.
    """

    channel: str  # empty for a plant with one
    index: int  # position of the channel
    prefix: str  # of its functions and types in C
    parameters: tuple[Parameter, ...]
    states: tuple[str, ...]  # names in C
    infos: tuple[str, ...]  # names of its telemetry in C
    start: TracedFunction
    step: TracedFunction
    transfer: TracedFunction | None
    precision: int  # bits of a number
    measured_signals: tuple[MeasuredSignal, ...]  # the members of its measurement

    @property
    def signals(self) -> tuple[str, ...]:
        """Its inputs at each sample, in C."""
        measurement = (f"measurement.{signal.name}" for signal in self.measured_signals)
        return (*measurement, *(f"reference.{name}" for name in ReferencePoint._fields))

    @property
    def real(self) -> np.dtype:
        """The type of its numbers."""
        return np.dtype(f"float{self.precision}")

    @property
    def c_real(self) -> str:
        """The type of its numbers in C."""
        return c_type(self.real)

    @property
    def smallest_difference(self) -> np.floating:
        """The difference of two commands near 0, in the command's unit, up to which they count as equal."""
        return self.real.type(1e-6 if self.precision == 32 else 1e-9)


@dataclass(frozen=True)
class FlightCode:
    """The data from which all files of generated code are written."""

    study: Study  # without a sweep
    controllers: list[SampledController]  # one for each channel
    certificate: str  # the verdict of Theorem 1 on the study, in a sentence

    @property
    def name(self) -> str:
        """The study's name as an identifier of C."""
        return prefix_name(self.study.name)

    @property
    def precision(self) -> int:
        """Bits of a number."""
        return self.study.config.loop.precision


def sampled_controllers(study: Study) -> list[SampledController]:
    """The controllers of a study, one for each channel; refused if an operation has no exact form in C."""
    with arithmetic(study.config.loop.precision):
        return [trace_controller(study, index) for index in range(len(study.loop.channels))]


def trace_controller(study: Study, index: int) -> SampledController:
    """Trace the start, the step and, if it has one, the transfer of a channel's controller.

    Raises:
        ConfigError: A part has no exact form in C.
    """
    loop = study.loop
    place = f"controller.{loop.channels[index]}".rstrip(".")
    native_description = loop.controller[index].native
    if native_description:
        raise ConfigError(place, f"is native code already: {native_description}")
    parameters = channel_parameters(study, index)
    keys = [parameter.key for parameter in parameters]

    def start(numbers: tuple[Scalar, ...], measurement: Measurement, reference: ReferencePoint) -> Any:
        params = study.params(dict(zip(keys, numbers, strict=True)))
        return as_arrays(initial_control(loop, params, index, measurement, reference))

    def step(
        numbers: tuple[Scalar, ...], state: ControlState, measurement: Measurement, reference: ReferencePoint
    ) -> Any:
        params = study.params(dict(zip(keys, numbers, strict=True)))
        after, controlled = control(loop, params, index, state, measurement, reference)
        return as_arrays((after, command_parts(controlled.command), controlled.info))

    def transfer(
        numbers: tuple[Scalar, ...], command: Scalar, measurement: Measurement, reference: ReferencePoint
    ) -> Any:
        params = study.params(dict(zip(keys, numbers, strict=True)))
        state = transfer_control(loop, params, index, measurement, reference, command)
        assert state is not None  # traced only if the controller has a transfer
        _, controlled = control(loop, params, index, state, measurement, reference)
        return as_arrays((state, command_parts(controlled.command)))

    number: Any = jax.ShapeDtypeStruct((), jnp.result_type(float))
    numbers = (number,) * len(keys)
    channel_signals = measured_signals(study, index)
    further_shapes = (number,) * (len(channel_signals) - len(OF_CHANNEL))
    signals = (Measurement(number, number, further_shapes), ReferencePoint(number, number, number))
    transfer_function = None
    try:
        start_program, state, start_origins = translate_with_origins(start, numbers, *signals)
        state = jax.tree.map(lambda leaf: number, state)
        step_program, results, step_origins = translate_with_origins(step, numbers, state, *signals)
        if loop.controller[index].transfer is not None:
            transfer_program, _, transfer_origins = translate_with_origins(transfer, numbers, number, *signals)
            transfer_function = TracedFunction(transfer_program, transfer_origins)
    except Unsupported as problem:
        raise ConfigError(place, f"has no exact form in C: {problem}") from None
    return SampledController(
        channel=loop.channels[index],
        index=index,
        prefix="_".join(filter(None, (prefix_name(study.name), channel_labels(loop.channels)[index]))),
        parameters=parameters,
        states=leaf_names(state, root="controller"),
        infos=leaf_names(results[2]),
        start=TracedFunction(start_program, start_origins),
        step=TracedFunction(step_program, step_origins),
        transfer=transfer_function,
        precision=study.config.loop.precision,
        measured_signals=channel_signals,
    )


def command_parts(command: Command) -> tuple[Scalar, Scalar, Scalar]:
    """The command in the order of :data:`COMMAND`."""
    return command.robust, command.nominal, command.total


def channel_parameters(study: Study, index: int) -> tuple[Parameter, ...]:
    """The numbers of a channel's differentiator and controller."""
    channel = study.loop.channels[index]

    def belongs(path: str) -> bool:
        slot, place, *_ = path.split(".")
        return slot in FLOWN_SLOTS and int(place) == index

    def name(key: str) -> str:
        """The fields of a number behind the slot, its position or channel; those of a differentiator tell so."""
        slot, *fields = key.split(".")
        if fields[0] in {str(index), channel}:
            fields = fields[1:]
        return "_".join(fields if slot == "controller" else [slot, *fields])

    return loop_parameters(study, belongs, name, study.units[index])


def leaf_names(tree: Any, root: str = "") -> tuple[str, ...]:
    """A name in C for each leaf of a tree; those below ``root`` do not begin with it."""
    names = []
    for path, _ in tree_flatten_with_path(tree)[0]:
        fields = keystr(path, simple=True, separator=".").split(".")
        names.append("_".join(fields[1:] if fields[0] == root else fields))
    return tuple(member_names(names))


def channel_labels(channels: tuple[str, ...]) -> list[str]:
    """The part of a name in C for each channel; equal ones are numbered, and that of a single channel may be empty."""
    labels: list[str] = []
    for channel in channels:
        plain_label = underscored(channel) or ("channel" if channel else "")
        label = plain_label
        count = 2
        while label in labels:
            label = f"{plain_label}_{count}"
            count += 1
        labels.append(label)
    return labels


def study_values(controllers: Sequence[SampledController]) -> dict[str, float]:
    """The study's value of every number of the controllers, by key."""
    return {parameter.key: parameter.value for controller in controllers for parameter in controller.parameters}
