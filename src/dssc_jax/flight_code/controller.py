"""The part of a loop that runs on a flight computer, traced by itself: differentiator and controller of one channel."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import keystr, tree_flatten_with_path

from dssc_jax.closed_loop.control import ControlState, control, initial_control, transfer_control
from dssc_jax.closed_loop.sample import as_arrays
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Command, Measurement, ReferencePoint
from dssc_jax.lanes.c_names import member_names
from dssc_jax.lanes.origins import Origin, translate_with_origins
from dssc_jax.lanes.program import Program
from dssc_jax.lanes.unsupported import Unsupported
from dssc_jax.study import Law, Study

FLOWN_SLOTS = ("controller", "differentiator")
COMMAND = ("u", "u_n", "u_p")
"""The command in its two parts and their sum (11)."""


class Parameter(NamedTuple):
    """A number of the controller that may be changed in flight.

    Args:
        key: Its name in the study, or its path if the study computes it: the key of :meth:`Study.params`.
        name: Its name in C.
        quantity: Unit, meaning and range; None if the study computes it.
        value: The study's value, or the median of its law.
        uncertain: Whether the study has a law for it.
    """

    key: str
    name: str
    quantity: Quantity | None
    value: float
    uncertain: bool


@dataclass(frozen=True)
class Traced:
    """A traced function of the controller.

    Args:
        program: Its program; one input for each parameter, each state (for a step) and each signal, in this order.
        origins: Where the model computes each value.
    """

    program: Program
    origins: dict[int, Origin]


@dataclass(frozen=True)
class SampledController:
    """The controller of one channel.

    Args:
        channel: Name of the channel; empty for a plant with one.
        index: Its position among the channels.
        parameters: Its numbers.
        states: Names of its states.
        infos: Names of what it reports.
        start: (parameters, signals) -> states before the first sample.
        step: (parameters, states, signals) -> states, command, infos.
        transfer: (parameters, command, signals) -> states whose first step gives the command, and the command that it
            gives; None if the controller's state cannot carry a command.
        precision: Bits of a number.
    """

    channel: str
    index: int
    parameters: tuple[Parameter, ...]
    states: tuple[str, ...]
    infos: tuple[str, ...]
    start: Traced
    step: Traced
    transfer: Traced | None
    precision: int

    @property
    def real(self) -> np.dtype:
        """The type of its numbers."""
        return np.dtype(f"float{self.precision}")


SAMPLED_SIGNALS = (
    *(f"measurement.{name}" for name in Measurement._fields),
    *(f"reference.{name}" for name in ReferencePoint._fields),
)
"""What a controller gets at each sample."""


def sampled_controllers(study: Study) -> list[SampledController]:
    """The controllers of a study, one for each channel.

    Raises:
        ConfigError: A controller contains an operation that has no exact form in C.
    """
    with arithmetic(study.config.loop.precision):
        return [sampled_controller(study, index) for index in range(len(study.loop.channels))]


def sampled_controller(study: Study, index: int) -> SampledController:
    """The controller of a channel by its position."""
    parameters, loop = parameters_of(study, index), study.loop
    number: Any = jax.ShapeDtypeStruct((), jnp.result_type(float))

    def start(numbers: tuple[Any, ...], measurement: Measurement, reference: ReferencePoint) -> Any:
        params = study.params(dict(zip(keys, numbers, strict=True)))
        return as_arrays(initial_control(loop, params, index, measurement, reference))

    def step(numbers: tuple[Any, ...], state: ControlState, measurement: Measurement, reference: ReferencePoint) -> Any:
        params = study.params(dict(zip(keys, numbers, strict=True)))
        after, controlled = control(loop, params, index, state, measurement, reference)
        return as_arrays((after, command_parts(controlled.command), controlled.info))

    def transfer(numbers: tuple[Any, ...], command: Any, measurement: Measurement, reference: ReferencePoint) -> Any:
        params = study.params(dict(zip(keys, numbers, strict=True)))
        state = transfer_control(loop, params, index, measurement, reference, command)
        assert state is not None  # asked for only where the controller declares it
        _, controlled = control(loop, params, index, state, measurement, reference)
        return as_arrays((state, command_parts(controlled.command)))

    keys = [parameter.key for parameter in parameters]
    numbers = (number,) * len(keys)
    signals = Measurement(number, number), ReferencePoint(number, number, number)
    place = f"controller.{loop.channels[index]}".rstrip(".")
    carries = loop.controller[index].transfer is not None
    try:
        start_program, state, start_origins = translate_with_origins(start, numbers, *signals)
        state = jax.tree.map(lambda leaf: number, state)
        step_program, results, step_origins = translate_with_origins(step, numbers, state, *signals)
        carried = translate_with_origins(transfer, numbers, number, *signals) if carries else None
    except Unsupported as problem:
        raise ConfigError(place, f"has no exact form in C: {problem}") from None
    return SampledController(
        loop.channels[index],
        index,
        parameters,
        leaf_names(state, prefix=("controller",)),
        leaf_names(results[2]),
        Traced(start_program, start_origins),
        Traced(step_program, step_origins),
        Traced(carried[0], carried[2]) if carried else None,
        study.config.loop.precision,
    )


def command_parts(command: Command) -> tuple[Any, Any, Any]:
    """The command in the order of :data:`COMMAND`."""
    return command.robust, command.nominal, command.total


def parameters_of(study: Study, index: int) -> tuple[Parameter, ...]:
    """The numbers of a channel's differentiator and controller, in the order of their fields.

    Numbers that decide the shape of the program (choices, counts) stay constants.
    """
    names = {path: name for name, number in study.numbers.items() for path in number.paths}
    flat, _ = tree_flatten_with_path(study.template, is_leaf=lambda leaf: isinstance(leaf, Law))
    parameters: dict[str, Parameter] = {}
    for path, leaf in flat:
        dotted = keystr(path, simple=True, separator=".")
        slot, place, *rest = dotted.split(".")
        if slot not in FLOWN_SLOTS or int(place) != index or not isinstance(leaf, float | Law):
            continue
        number = study.numbers.get(names.get(dotted, ""))
        if number is not None and not number.quantity.law:
            continue
        own = number.name.split(".")[1:] if number is not None else rest
        own = own[1:] if own and own[0] == study.loop.channels[index] else own
        label = "_".join([*([] if slot == "controller" else [slot]), *own])
        value = float(leaf.median) if isinstance(leaf, Law) else leaf
        key = number.name if number is not None else dotted
        parameters[key] = Parameter(key, label, number and number.quantity, value, isinstance(leaf, Law))
    names = member_names(parameter.name for parameter in parameters.values())
    return tuple(parameter._replace(name=name) for parameter, name in zip(parameters.values(), names, strict=True))


def leaf_names(tree: Any, prefix: tuple[str, ...] = ()) -> tuple[str, ...]:
    """A name in C for each leaf; a leading part in ``prefix`` is left out."""
    names = []
    for path, _ in tree_flatten_with_path(tree)[0]:
        parts = keystr(path, simple=True, separator=".").split(".")
        names.append("_".join(parts[1:] if parts[0] in prefix else parts))
    return tuple(member_names(names))


def numbers_by_key(controllers: list[SampledController]) -> Mapping[str, float]:
    """The study's value of every number of the controllers."""
    return {each.key: each.value for controller in controllers for each in controller.parameters}
