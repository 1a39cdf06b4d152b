"""The files of software on board: header and source in C99 that is C++ as well, its bench, and the README's section."""

from collections.abc import Sequence
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_code.c_files import (
    LENGTH_ERROR,
    finite_condition,
    finite_function,
    header_file,
    joined_definitions,
    source_file,
    unit_length_condition,
)
from dssc_jax.flight_code.controller import TracedFunction
from dssc_jax.flight_code.header import member_text
from dssc_jax.flight_code.onboard import TracedSoftware
from dssc_jax.flight_code.parameters import Parameter, assignment_lines, check_lines, parameter_comment
from dssc_jax.flight_code.replay_bench import ReplayBench, bench_files
from dssc_jax.flight_code.template_files import fill
from dssc_jax.lanes.c.operations import c_type
from dssc_jax.lanes.c.text import CText, comment
from dssc_jax.lanes.passes.liveness import read_inputs
from dssc_jax.lanes.program import Value

LABEL = "inner loop"
RECORDING = "inner_loop.bin"
CARRIED = "carried"
LOCAL_NAMES = {"inner_loop", "seen", "wanted", "held", "updated", "kept", "driven", "parameters", "p", "flag", CARRIED}
"""Names in the template files, which no computed variable may have."""


class FunctionLines(NamedTuple):
    """The body of a function of the software in C.

    Args:
        lines: Lines of the body.
        parameters: Names of the parameters that it reads.
        readings: Names of the readings that it reads.
        definitions: Definitions of the tables and functions that it uses.
    """

    lines: list[str]
    parameters: list[str]
    readings: list[str]
    definitions: list[str]


def write_function(
    software: TracedSoftware, function: TracedFunction, arguments: Sequence[str], extra_outputs: Sequence[str] = ()
) -> FunctionLines:
    """Write the body of one function.

    Args:
        software: The software.
        function: The function.
        arguments: C's expressions of its inputs after parameters, laws and readings.
        extra_outputs: Names of its outputs after the states.

    Raises:
        ConfigError: The function reads a number that has a law.
    """
    read_positions = read_inputs(function.program)
    first_law = len(software.parameters)
    first_reading = first_law + len(software.laws)
    for place, name in enumerate(software.laws, start=first_law):
        if place in read_positions:
            rule = "has a law, and is a constant in the inner loop's C"
            raise ConfigError(name, f"{rule}; give it a number (--set {name}=NUMBER)")
    members = [f"p->{parameter.name}" for parameter in software.parameters]
    readings = [f"seen->{name}" for name in software.readings]
    inputs = [*members, *software.laws, *readings, *arguments]
    text = CText(function.program, function.origins, inputs, software.real, LOCAL_NAMES)
    outputs = [output for output in function.program.outputs if isinstance(output, Value)]
    text.compute(outputs)
    text.line("")
    count = len(software.state_names)
    for name, output in zip(software.state_names, outputs[:count], strict=True):
        text.line(f"updated.{name} = {text.read(output)};")
    for name, output in zip(extra_outputs, outputs[count:], strict=True):
        text.line(f"const {c_type(software.real)} {name} = {text.read(output)};")
    parameters = [parameter.name for place, parameter in enumerate(software.parameters) if place in read_positions]
    needed_readings = [
        name for place, name in enumerate(software.readings, start=first_reading) if place in read_positions
    ]
    definitions = [*text.tables, *text.notation.helpers(), *text.functions.values()]
    return FunctionLines(text.lines, parameters, needed_readings, definitions)


class SoftwareFiles(NamedTuple):
    """The data from which all files of the software are written: the traced software and its functions in C."""

    software: TracedSoftware
    start: FunctionLines
    sample: FunctionLines
    tick: FunctionLines
    transfer: FunctionLines | None

    @property
    def functions(self) -> list[FunctionLines]:
        """Start, sample, tick and, if there is one, transfer."""
        functions = [self.start, self.sample, self.tick]
        return functions if self.transfer is None else [*functions, self.transfer]

    @property
    def readings(self) -> list[str]:
        """Names of the readings that at least one function reads."""
        needed_names = {name for function in self.functions for name in function.readings}
        return [name for name in self.software.readings if name in needed_names]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that at least one function reads."""
        needed_names = {name for function in self.functions for name in function.parameters}
        return tuple(parameter for parameter in self.software.parameters if parameter.name in needed_names)


def software_files(software: TracedSoftware) -> SoftwareFiles:
    """Write all functions of the software in C; raises ConfigError as :func:`write_function`."""
    state_members = [f"held.{name}" for name in software.state_names]
    commands = [f"wanted->{name}" for name in software.commands]
    transfer = None
    if software.transfer is not None:
        drives = [f"driven->{name}" for name in software.drive_names]
        transfer = write_function(software, software.transfer, drives, [CARRIED])
    return SoftwareFiles(
        software=software,
        start=write_function(software, software.start, []),
        sample=write_function(software, software.sample, [*state_members, *commands]),
        tick=write_function(software, software.tick, state_members),
        transfer=transfer,
    )


def software_texts(files: SoftwareFiles, study: str) -> dict[str, str]:
    """Contents of header, source, bench and makefile of the software, by the file's name.

    Args:
        files: The software.
        study: Name of the study.
    """
    software = files.software
    real = c_type(software.real)
    name = software.prefix
    sentences = [
        f"Inner loop and mixer of the study {study}, generated by dssc-jax code. Do not edit: generate it again.",
        f"A tick every {software.period:g} s, {software.ticks} in a sample. Gains are parameters.",
        "All other numbers of the study are constants here.",
        "Compile without contraction and without fast arithmetic: cc -std=c99 -O2 -ffp-contract=off.",
    ]
    sentences += [sentence.replace("`", "") for sentence in software.outputs]
    remarks = [line for sentence in sentences for line in comment(sentence)]
    definitions = dict.fromkeys(text for function in files.functions for text in function.definitions)
    readings = [f"seen->{reading}" for reading in files.readings]
    commands = [f"wanted->{command}" for command in software.commands]
    lengths = []
    for direction in software.directions:
        if set(direction) <= set(files.readings):
            lengths.append(unit_length_condition([f"seen->{reading}" for reading in direction], software.real))
    comments = [parameter_comment(number, parameter) for number, parameter in enumerate(files.parameters, start=1)]
    members = zip(files.parameters, comments, strict=True)
    declarations = fill(
        "inner_loop.h",
        name=name,
        parameters=[member_text(real, parameter.name, text) for parameter, text in members] or f"{real} unused;",
        readings=[f"{real} {reading};" for reading in files.readings],
        commands=[f"{real} {command};" for command in software.commands],
        held=[f"{real} {member};" for member in software.state_names],
        ticks=str(software.ticks),
        length_error=f"{100.0 * LENGTH_ERROR:g}",
        transfer="" if files.transfer is None else transfer_declaration(software),
    )
    body = fill(
        "inner_loop.c",
        name=name,
        is_finite=finite_function(software.real),
        definitions=joined_definitions(definitions),
        readings_valid="\n        && ".join([finite_condition(readings), *lengths]),
        commands_finite=finite_condition(commands),
        held_finite=finite_condition([f"updated.{member}" for member in software.state_names]),
        parameters=assignment_lines("inner_loop->parameters", files.parameters, software.real),
        checks=check_lines(files.parameters, software.real),
        start=body_lines(files.start, name),
        sample=body_lines(files.sample, name),
        tick=body_lines(files.tick, name),
        transfer="" if files.transfer is None else transfer_definition(files.transfer, software),
    )
    return {
        f"{name}.h": header_file(name, remarks, declarations),
        f"{name}.c": source_file(LABEL, f"{name}.h", remarks, body),
        **bench_files(replay_bench(files), RECORDING),
    }


def body_lines(function: FunctionLines, name: str) -> list[str]:
    """The body of a function, with the pointer to its parameters; the argument ``seen`` may be unused.

    Args:
        function: The function.
        name: Prefix of the software in C.
    """
    lines = list(function.lines)
    if not function.readings:
        lines.insert(0, "    (void)seen;")
    if function.parameters:
        lines.insert(0, f"    const {name}_parameters *const p = &inner_loop->parameters;")
    return lines


def transfer_declaration(software: TracedSoftware) -> str:
    """The declaration in C of the function for a takeover in flight."""
    real = c_type(software.real)
    members = [f"{real} {name};" for name in software.drive_names]
    return fill("inner_loop_transfer.h", name=software.prefix, driven=members)


def transfer_definition(function: FunctionLines, software: TracedSoftware) -> str:
    """The definition in C of the function for a takeover in flight."""
    return fill(
        "inner_loop_transfer.c",
        name=software.prefix,
        driven_finite=finite_condition([f"driven->{name}" for name in software.drive_names]),
        transfer=body_lines(function, software.prefix),
    )


def replay_bench(files: SoftwareFiles) -> ReplayBench:
    """The bench of the software, whose rows are ticks; a row has all readings, even those that no function reads."""
    software = files.software
    name = software.prefix
    count = len(software.readings)
    needed_readings = [(place, reading) for place, reading in enumerate(software.readings) if reading in files.readings]
    reading_assignments = [f"seen.{reading} = row[{place}];" for place, reading in needed_readings]
    uncertain = [parameter.name for parameter in software.parameters if parameter.uncertain]
    inputs = count + len(software.commands) + len(uncertain)
    needed_parameters = {parameter.name for parameter in files.parameters}
    parameter_assignments = [
        f"held->parameters.{parameter} = row[{place}];"
        for place, parameter in enumerate(uncertain, start=count + len(software.commands))
        if parameter in needed_parameters
    ]
    advance = [
        f"{name}_readings seen;",
        f"{name}_commands wanted;",
        "uint32_t flags = 0;",
        *reading_assignments,
        *(f"wanted.{command} = row[{place}];" for place, command in enumerate(software.commands, start=count)),
        "if (k == 0) {",
        f"    {name}_init(held);",
        *(f"    {line}" for line in parameter_assignments),
        f"    flags |= {name}_start(held, &seen);",
        "}",
        f"if (k % {software.ticks} == 0) {{",
        f"    flags |= {name}_sample(held, &seen, &wanted);",
        "}",
        f"flags |= {name}_tick(held, &seen);",
        "results[0] = (real)flags;",
        *(f"results[{place}] = held->{member};" for place, member in enumerate(software.state_names, start=1)),
        "return flags;",
    ]
    disturbance_lines = [
        "real *const numbers = (real *)&held->parameters;",
        "numbers[random_bits() % (sizeof held->parameters / sizeof(real))] = hostile_number();",
    ]
    results = ("flags", *software.state_names)
    return ReplayBench(
        label=LABEL,
        prefix=name,
        precision=software.precision,
        row="tick",
        inputs=inputs,
        results=results,
        advance=advance,
        disturb=disturbance_lines,
        stays_finite=True,
        shows_arithmetic=True,
    )


def readme_lines(files: SoftwareFiles) -> list[str]:
    """The section of the README on the software on board."""
    software = files.software
    name = software.prefix
    return [
        "## The inner loop and the mixer",
        "",
        f"`{name}.h`, `{name}.c`: call `{name}_init` once; it gives `parameters` the study's values, which may be "
        f"changed between two ticks (`{name}_check` tells whether they are admissible). Call `{name}_start` with "
        "the first readings before each take-off; it sets all integrals to 0, to which `velocity_integral` of the"
        f" study adds. Where it takes over in flight, call `{name}_transfer` instead, with the thrusts of the "
        f"rotors until then. At every sample, after the controllers, call `{name}_sample` with their commands. "
        f"Call `{name}_tick` every {software.period:g} s, {software.ticks} times in a sample; the first one "
        f"follows `{name}_sample`. The members `rotor_..` are the commanded thrusts [N]. `inner_loop_bench.c` "
        "compares every bit with recorded "
        "flights, which begin as `_start` does; `make` builds and runs it.",
        "",
        *(f"* {sentence}" for sentence in software.outputs),
        "",
    ]
