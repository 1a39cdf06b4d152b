"""The variables of the controllers as an FMU, and the C that connects them with the generated controllers."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.core.signals import Measurement, ReferencePoint
from dssc_jax.flight_code.controller import COMMAND, Parameter, SampledController
from dssc_jax.flight_code.names import identifier, prefix
from dssc_jax.lanes.c_names import c_string
from dssc_jax.lanes.c_operations import c_literal, c_type
from dssc_jax.study import Study

PARAMETER, INPUT, OUTPUT = "parameter", "input", "output"
"""Causalities of FMI, in the order of the value references."""


class FmuVariable(NamedTuple):
    """A variable of the FMU.

    Args:
        name: Its name, with dots.
        causality: :data:`PARAMETER`, :data:`INPUT` or :data:`OUTPUT`.
        unit: Its unit; empty for a flag, which is an integer.
        meaning: Its description.
        start: Its value before the first step; None for outputs, which are computed.
        least: Least admissible value, if there is one.
        most: Largest admissible value, if there is one.
    """

    name: str
    causality: str
    unit: str
    meaning: str
    start: float | None = None
    least: float | None = None
    most: float | None = None


def channel_variable(controller: SampledController, name: str) -> str:
    """The name of a channel's variable: that of ``compare-log`` and of trajectories begins with the channel, too."""
    return f"{controller.channel}.{name}" if controller.channel else name


def parameter_name(controller: SampledController, each: Parameter) -> str:
    """The name in the study; a number that the study computes has none, but one in C."""
    return each.key if each.quantity is not None else channel_variable(controller, f"computed.{each.name}")


def fmu_parameters(controllers: Sequence[SampledController]) -> dict[str, FmuVariable]:
    """The parameters by name; channels that share a number of the study share its parameter."""
    variables = {}
    for controller in controllers:
        for each in controller.parameters:
            name, start = parameter_name(controller, each), float(controller.real.type(each.value))
            if each.quantity is None:
                variables[name] = FmuVariable(name, PARAMETER, "1", "computed from the study", start)
                continue
            quantity = each.quantity
            bounds = [
                next((bound for bound in pair if bound is not None and math.isfinite(bound)), None)
                for pair in ((quantity.at_least, quantity.above), (quantity.at_most, quantity.below))
            ]
            median = ", median of its law" if each.uncertain else ""
            variables[name] = FmuVariable(name, PARAMETER, quantity.unit, quantity.meaning + median, start, *bounds)
    return variables


def fmu_inputs(study: Study, controller: SampledController) -> Iterator[FmuVariable]:
    """Measurement and reference of a channel."""
    own = study.units[controller.index]
    rates = [own.of(unit) for unit in ("y", "y/s", "y/s^2")]
    for group, members, word in (
        ("measurement", Measurement._fields, "measured"),
        ("reference", ReferencePoint._fields, "desired"),
    ):
        for member, unit, order in zip(members, rates, ("", "derivative of ", "second derivative of "), strict=False):
            meaning = f"{order}{word} {own.output_meaning}"
            yield FmuVariable(channel_variable(controller, f"{group}.{member}"), INPUT, unit, meaning, 0.0)


def fmu_outputs(study: Study, controller: SampledController) -> Iterator[FmuVariable]:
    """Command and telemetry of a channel."""
    own = study.units[controller.index]
    parts = ("robust part of the", "nominal part of the", "whole")
    for member, part in zip(COMMAND, parts, strict=True):
        meaning = f"{part} {own.command_meaning}"
        yield FmuVariable(channel_variable(controller, f"command.{member}"), OUTPUT, own.command, meaning)
    for info in controller.infos:
        yield FmuVariable(channel_variable(controller, f"telemetry.{info}"), OUTPUT, "", "what the controller reports")


def real_variables(study: Study, controllers: Sequence[SampledController]) -> list[FmuVariable]:
    """All real variables; the place of each is its value reference."""
    signals = [each for controller in controllers for each in fmu_inputs(study, controller)]
    results = [each for controller in controllers for each in fmu_outputs(study, controller)]
    return [*fmu_parameters(controllers).values(), *signals, *results]


def flag_variables(controllers: Sequence[SampledController]) -> list[FmuVariable]:
    """The flag of each channel."""
    meaning = "0, or 1 (an input is not finite) or 2 (the command or the state would not be finite); then both are held"
    return [FmuVariable(channel_variable(controller, "flag"), OUTPUT, "", meaning) for controller in controllers]


def variables_text(study: Study, controllers: Sequence[SampledController], guid: str) -> str:
    """``fmu_variables.h``: the values of the variables, and how they reach the controllers."""
    variables = real_variables(study, controllers)
    places = {each.name: place for place, each in enumerate(variables)}
    first = next(place for place, each in enumerate(variables) if each.causality == OUTPUT)
    names = [prefix(study, each) for each in controllers]
    starts = ", ".join(c_literal(np.float64(each.start or 0.0), np.dtype(float)) for each in variables)
    labels = ", ".join(c_string(channel_label(each)) for each in controllers)
    lines = [
        "/* The variables of the FMU, and how they reach the controllers. */",
        f'#include "{identifier(study.name)}_controller.h"',
        "",
        f'#define GUID "{guid}"',
        f"#define SAMPLE_TIME {study.loop.sample_time!r}  /* s */",
        f"#define REALS {len(variables)}u",
        f"#define FIRST_OUTPUT {first}u",
        f"#define FLAGS {len(controllers)}u",
        "",
        "typedef struct {",
        *(f"    {name}_controller {name};" for name in names),
        "} controllers;",
        "",
        f"static const double start_values[REALS] = {{{starts}}};",
        f"static const char *const labels[FLAGS] = {{{labels}}};",
        "",
        "static void prepare(controllers *all)",
        "{",
        *(f"    {name}_init(&all->{name});" for name in names),
        "}",
        "",
    ]
    for controller in controllers:
        lines += rules_text(study, controller)
    lines += ["static void set_parameters(controllers *all, const double *value)", "{"]
    for controller in controllers:
        lines += parameters_text(study, controller, places)
    lines += [
        "    (void)all;",
        "    (void)value;",
        "}",
        "",
        "static const char *broken_rule(const controllers *all)  /* NULL: parameters are within their ranges */",
        "{",
    ]
    for controller in controllers:
        lines += check_text(study, controller)
    lines += [
        "    (void)all;",
        "    return NULL;",
        "}",
        "",
        "static void advance(controllers *all, double *value, int *flag)",
        "{",
    ]
    for i, controller in enumerate(controllers):
        lines += channel_step_text(study, controller, places, f"flag[{i}]")
    return "\n".join([*lines, "}", ""])


def channel_label(controller: SampledController) -> str:
    """What begins a message about a channel; simulators expand % and #."""
    label = f"channel {controller.channel}: " if controller.channel else ""
    return label.replace("%", "?").replace("#", "?")


def rules_text(study: Study, controller: SampledController) -> list[str]:
    """The messages for parameters outside of their ranges."""
    if not controller.parameters:
        return []
    messages = []
    for parameter in controller.parameters:
        interval = parameter.quantity.interval if parameter.quantity is not None else ""
        wanted = "must be finite" + (f" and {interval}" if interval else "")
        text = f"the parameter {parameter_name(controller, parameter)} {wanted}"
        messages.append(f"    {c_string(text.replace('%', '?').replace('#', '?'))},")
    name = prefix(study, controller)
    return [f"static const char *const rules_of_{name}[] = {{", *messages, "};", ""]


def parameters_text(study: Study, controller: SampledController, places: dict[str, int]) -> list[str]:
    """The statements that give a channel its parameters."""
    name, cast = prefix(study, controller), real_cast(controller)
    return [
        f"    all->{name}.parameters.{parameter.name} = {cast}value[{places[parameter_name(controller, parameter)]}];"
        for parameter in controller.parameters
    ]


def check_text(study: Study, controller: SampledController) -> list[str]:
    """The statements that check a channel's parameters."""
    if not controller.parameters:
        return []
    name = prefix(study, controller)
    return [
        f"    const unsigned number_of_{name} = {name}_check(&all->{name}.parameters);",
        f"    if (number_of_{name} != 0) {{",
        f"        return rules_of_{name}[number_of_{name} - 1];",
        "    }",
    ]


def real_cast(controller: SampledController) -> str:
    """The cast from the FMU's numbers to the controller's."""
    kind = c_type(controller.real)
    return "" if kind == "double" else f"({kind})"


def channel_step_text(study: Study, controller: SampledController, places: dict[str, int], flag: str) -> list[str]:
    """The block that steps a channel."""
    name, cast = prefix(study, controller), real_cast(controller)

    def value(variable: str) -> str:
        return f"value[{places[channel_variable(controller, variable)]}]"

    def given(group: str, members: Sequence[str]) -> str:
        read = ", ".join(cast + value(f"{group}.{member}") for member in members)
        return f"        const {name}_{group} {group} = {{{read}}};"

    lines = ["    {", given("measurement", Measurement._fields), given("reference", ReferencePoint._fields)]
    lines += [f"        {name}_command command;", f"        {name}_telemetry telemetry = {{0}};"]
    lines.append(f"        {flag} = (int){name}_step(&all->{name}, measurement, reference, &command, &telemetry);")
    lines += [f"        {value(f'command.{member}')} = command.{member};" for member in COMMAND]
    if controller.infos:
        lines.append(f"        if ({flag} == 0) {{")
        lines += [f"            {value(f'telemetry.{info}')} = telemetry.{info};" for info in controller.infos]
        lines.append("        }")
    return [*lines, "    }"]
