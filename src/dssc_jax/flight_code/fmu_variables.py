"""The variables of the controllers as an FMU, and the C that connects them with the generated controllers."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from dssc_jax.core.signals import ReferencePoint
from dssc_jax.flight_code.controller import COMMAND, FlightCode, SampledController
from dssc_jax.flight_code.parameters import Parameter
from dssc_jax.flight_code.template_files import fill
from dssc_jax.lanes.c.names import c_string
from dssc_jax.lanes.c.operations import c_literal
from dssc_jax.study import Study

# causalities of FMI, in the order of the value references
PARAMETER = "parameter"
INPUT = "input"
OUTPUT = "output"

FLAG_MEANING = (
    "0, or 1 (an input is not finite) or 2 (the command or the state would not be finite); then both are held"
)


class FmuVariable(NamedTuple):
    """A variable of the FMU.

    Args:
        name: Name, with dots.
        causality: ``parameter``, ``input`` or ``output``.
        unit: Unit; empty for numbers without a stated unit, such as flags and telemetry.
        meaning: Meaning in words.
        start: Value before the first step; None for outputs, which are computed.
        lower: Least admissible value; None: there is none.
        upper: Largest admissible value; None: there is none.
    """

    name: str
    causality: str
    unit: str
    meaning: str
    start: float | None = None
    lower: float | None = None
    upper: float | None = None


def channel_variable(controller: SampledController, name: str) -> str:
    """The name in the FMU of a channel's variable, with the channel in front as in trajectories.

    The only channel of a plant has no name, and adds none.
    """
    return f"{controller.channel}.{name}" if controller.channel else name


def parameter_name(controller: SampledController, parameter: Parameter) -> str:
    """The name in the FMU of a parameter: its name in the study, or ``computed.`` with its name in C.

    A parameter without a quantity is a number that the study computes, such as an entry of a matrix of gains.
    """
    if parameter.quantity is None:
        return channel_variable(controller, f"computed.{parameter.name}")
    return parameter.key


def fmu_parameters(code: FlightCode) -> list[FmuVariable]:
    """The parameters of the FMU; channels that share a number of the study share its parameter."""
    variables: dict[str, FmuVariable] = {}
    for controller in code.controllers:
        for parameter in controller.parameters:
            variable = parameter_variable(controller, parameter)
            variables[variable.name] = variable
    return list(variables.values())


def parameter_variable(controller: SampledController, parameter: Parameter) -> FmuVariable:
    """The variable of a parameter, with the study's value as its start, rounded to the controller's numbers.

    Lower and upper bounds are those of the parameter's quantity; a number that the study computes has none.
    """
    name = parameter_name(controller, parameter)
    start = float(controller.real.type(parameter.value))
    quantity = parameter.quantity
    if quantity is None:
        return FmuVariable(name, PARAMETER, "1", "computed from the study", start)
    median = ", median of its law" if parameter.uncertain else ""
    return FmuVariable(
        name=name,
        causality=PARAMETER,
        unit=quantity.unit,
        meaning=f"{quantity.meaning}{median}",
        start=start,
        lower=finite_bound(quantity.at_least, quantity.above),
        upper=finite_bound(quantity.at_most, quantity.below),
    )


def finite_bound(inclusive: float | None, exclusive: float | None) -> float | None:
    """The bound that is finite, the inclusive one first; None if neither is. FMI makes no difference between both.

    Args:
        inclusive: Bound that the value may reach; None: there is none.
        exclusive: Bound that the value must not reach; None: there is none.
    """
    for bound in (inclusive, exclusive):
        if bound is not None and math.isfinite(bound):
            return bound
    return None


def fmu_inputs(study: Study, controller: SampledController) -> list[FmuVariable]:
    """The inputs of a channel: measurement and reference.

    All inputs start at 0, until the simulator sets them.
    """
    units = study.units[controller.index]
    derivatives = (  # unit and order in words of each member of a reference
        (units.of("y"), ""),
        (units.of("y/s"), "derivative of "),
        (units.of("y/s^2"), "second derivative of "),
    )
    variables = []
    for signal in controller.measured_signals:
        name = channel_variable(controller, f"measurement.{signal.name}")
        variables.append(FmuVariable(name, INPUT, signal.unit, signal.meaning, start=0.0))
    for member, (unit, order) in zip(ReferencePoint._fields, derivatives, strict=True):
        name = channel_variable(controller, f"reference.{member}")
        variables.append(FmuVariable(name, INPUT, unit, f"{order}desired {units.output_meaning}", start=0.0))
    return variables


def fmu_outputs(study: Study, controller: SampledController) -> list[FmuVariable]:
    """The outputs of a channel: command and telemetry.

    Args:
        study: The study.
        controller: The controller of the channel.
    """
    units = study.units[controller.index]
    parts = ("robust part of the", "nominal part of the", "whole")
    variables = []
    for member, part in zip(COMMAND, parts, strict=True):
        name = channel_variable(controller, f"command.{member}")
        variables.append(FmuVariable(name, OUTPUT, units.command, f"{part} {units.command_meaning}"))
    for info in controller.infos:
        name = channel_variable(controller, f"telemetry.{info}")
        variables.append(FmuVariable(name, OUTPUT, "", "what the controller reports"))
    return variables


def real_variables(code: FlightCode) -> list[FmuVariable]:
    """All real variables of the FMU; the position of a variable is its value reference.

    Parameters come first, then the inputs of all channels, then their outputs.
    """
    variables = fmu_parameters(code)
    for controller in code.controllers:
        variables += fmu_inputs(code.study, controller)
    for controller in code.controllers:
        variables += fmu_outputs(code.study, controller)
    return variables


def flag_variables(code: FlightCode) -> list[FmuVariable]:
    """The integer variables of the FMU: the flag of each channel."""
    names = [channel_variable(controller, "flag") for controller in code.controllers]
    return [FmuVariable(name, OUTPUT, "", FLAG_MEANING) for name in names]


def variables_text(code: FlightCode, guid: str) -> str:
    """The text of ``fmu_variables.h``: the values of the variables, and their exchange with the controllers.

    Args:
        code: The controllers.
        guid: Identifier that binds the header to the description.
    """
    variables = real_variables(code)
    references = {variable.name: reference for reference, variable in enumerate(variables)}
    causalities = [variable.causality for variable in variables]
    names = [controller.prefix for controller in code.controllers]
    parameters: list[str] = []
    rules: list[str] = []
    checks: list[str] = []
    steps: list[str] = []
    for position, controller in enumerate(code.controllers):
        parameters += parameter_assignments(controller, references)
        steps.append(channel_step(controller, references, f"flag[{position}]"))
        if controller.parameters:
            rules += [*rule_table(controller), ""]  # with an empty line after it
            checks += parameter_check(controller.prefix)
    starts = [c_literal(np.float64(variable.start or 0.0), np.dtype(float)) for variable in variables]
    return fill(
        "fmu_variables.h",
        study=code.name,
        guid=guid,
        sample_time=repr(code.study.loop.sample_time),
        reals=str(len(variables)),
        first_output=str(causalities.index(OUTPUT)),
        flags=str(len(names)),
        controllers=[f"{name}_controller {name};" for name in names],
        starts=", ".join(starts),
        labels=", ".join(c_string(channel_label(controller)) for controller in code.controllers),
        prepare=[f"{name}_init(&all->{name});" for name in names],
        rules="".join(f"{line}\n" for line in rules),
        parameters=parameters,
        checks=checks,
        steps="".join(steps),
    )


def channel_label(controller: SampledController) -> str:
    """The beginning of messages about a channel; empty for the only channel."""
    return plain_message(f"channel {controller.channel}: ") if controller.channel else ""


def plain_message(text: str) -> str:
    """A message with ? in place of % and #, which simulators would replace by other texts.

    Args:
        text: The message, which may contain names from the study.
    """
    return text.replace("%", "?").replace("#", "?")


def rule_table(controller: SampledController) -> list[str]:
    """The table in C of messages for parameters outside of their ranges.

    The function ``check`` of a controller returns the number of the first inadmissible parameter, from 1 on. The table
    gives the message for that number.
    """
    messages = []
    for parameter in controller.parameters:
        interval = parameter.quantity.interval if parameter.quantity is not None else ""
        rule = f"must be finite and {interval}" if interval else "must be finite"
        message = plain_message(f"the parameter {parameter_name(controller, parameter)} {rule}")
        messages.append(f"    {c_string(message)},")
    return [f"static const char *const rules_of_{controller.prefix}[] = {{", *messages, "};"]


def parameter_check(name: str) -> list[str]:
    """The statements in C that check a channel's parameters; ``name`` is the controller's prefix."""
    return [
        f"const unsigned number_of_{name} = {name}_check(&all->{name}.parameters);",
        f"if (number_of_{name} != 0) {{",
        f"    return rules_of_{name}[number_of_{name} - 1];",
        "}",
    ]


def parameter_assignments(controller: SampledController, references: dict[str, int]) -> list[str]:
    """The statements in C that assign a channel's parameters.

    Args:
        controller: The controller of the channel.
        references: Value references by name.
    """
    lines = []
    for parameter in controller.parameters:
        value = f"{real_cast(controller)}value[{references[parameter_name(controller, parameter)]}]"
        lines.append(f"all->{controller.prefix}.parameters.{parameter.name} = {value};")
    return lines


def real_cast(controller: SampledController) -> str:
    """The cast in C from float64 to the controller's type of numbers; empty if that is float64."""
    return "" if controller.c_real == "double" else f"({controller.c_real})"


def channel_step(controller: SampledController, references: dict[str, int], flag: str) -> str:
    """The block in C that makes a step of a channel.

    Args:
        controller: The controller of the channel.
        references: Value references by name.
        flag: C's expression of the channel's flag.
    """

    def value(variable: str) -> str:
        """C's expression of the channel's variable of a name."""
        return f"value[{references[channel_variable(controller, variable)]}]"

    def inputs(group: str, members: Iterable[str]) -> str:
        """The initial values in C of a structure: the inputs of a group, ``measurement`` or ``reference``."""
        return ", ".join(real_cast(controller) + value(f"{group}.{member}") for member in members)

    results = [f"{value(f'command.{member}')} = command.{member};" for member in COMMAND]
    if controller.infos:
        results.append(f"if ({flag} == 0) {{")
        results += [f"    {value(f'telemetry.{info}')} = telemetry.{info};" for info in controller.infos]
        results.append("}")
    return fill(
        "fmu_channel.h",
        name=controller.prefix,
        measurement=inputs("measurement", [signal.name for signal in controller.measured_signals]),
        reference=inputs("reference", ReferencePoint._fields),
        flag=flag,
        results=results,
    )
