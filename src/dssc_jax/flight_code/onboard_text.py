"""The files of software on board: header and source in C99 that is C++ as well, its bench, and the README's section."""

from collections.abc import Sequence, Set
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_code.c_files import (
    LENGTH_ERROR,
    comment_lines,
    finite_condition,
    finite_function,
    generated_by,
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
from dssc_jax.lanes.c.operations import c_literal, c_type
from dssc_jax.lanes.c.text import CText
from dssc_jax.lanes.passes.liveness import read_inputs
from dssc_jax.lanes.program import Value

LABEL = "inner loop"
"""Name of the software in words."""
RECORDING = "inner_loop.bin"
"""Name of the file with the bench's recording."""
CARRIED = "carried"
"""Name in C of the number that tells whether a takeover is possible: 1, or 0 if limits forbid it."""
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
    """Write the body of one function of the software in C.

    Args:
        software: The software.
        function: The function.
        arguments: C's expressions of its inputs after parameters, laws and readings.
        extra_outputs: Names of its outputs after the states.

    Raises:
        ConfigError: The function reads a number that has a law.
    """
    first_law = len(software.parameters)
    first_reading = first_law + len(software.laws)
    read_positions = read_inputs(function.program)
    read_parameters = names_of_read_inputs(
        read_positions, [parameter.name for parameter in software.parameters], first=0
    )
    read_laws = names_of_read_inputs(read_positions, software.laws, first_law)
    read_readings = names_of_read_inputs(read_positions, software.readings, first_reading)
    if read_laws:
        name = read_laws[0]
        rule = "has a law, and is a constant in the inner loop's C"
        raise ConfigError(name, f"{rule}; give it a number (--set {name}=NUMBER)")
    members = [f"p->{parameter.name}" for parameter in software.parameters]
    readings = [f"seen->{name}" for name in software.readings]
    inputs = [*members, *software.laws, *readings, *arguments]
    text = CText(function.program, function.origins, inputs, software.real, LOCAL_NAMES)
    outputs = [output for output in function.program.outputs if isinstance(output, Value)]
    text.compute(outputs)
    text.line("")
    state_count = len(software.state_names)
    for name, output in zip(software.state_names, outputs[:state_count], strict=True):
        text.line(f"updated.{name} = {text.read(output)};")
    for name, output in zip(extra_outputs, outputs[state_count:], strict=True):
        text.line(f"const {c_type(software.real)} {name} = {text.read(output)};")
    definitions = [*text.tables, *text.notation.helpers(), *text.functions.values()]
    return FunctionLines(lines=text.lines, parameters=read_parameters, readings=read_readings, definitions=definitions)


def names_of_read_inputs(read_positions: Set[int], names: Sequence[str], first: int) -> list[str]:
    """Select the names of a function's inputs that the function reads.

    Args:
        read_positions: Positions of the inputs that it reads, among all its inputs.
        names: Names of some consecutive inputs.
        first: Position of the input with the first of these names.
    """
    return [name for position, name in enumerate(names, start=first) if position in read_positions]


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
        needed_names: list[str] = []
        for function in self.functions:
            needed_names += function.readings
        return [name for name in self.software.readings if name in needed_names]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters that at least one function reads."""
        needed_names: list[str] = []
        for function in self.functions:
            needed_names += function.parameters
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
    name = files.software.prefix
    remarks = file_comment(files.software, study)
    return {
        f"{name}.h": header_file(name, remarks, declarations(files)),
        f"{name}.c": source_file(LABEL, f"{name}.h", remarks, source_body(files)),
        **bench_files(replay_bench(files), RECORDING),
    }


def file_comment(software: TracedSoftware, study: str) -> list[str]:
    """Write the lines of the first comment of header and source; ``study`` is the study's name."""
    sentences = [
        f"Inner loop and mixer of the study {study}. {generated_by('dssc-jax code')}",
        f"A tick every {software.period:g} s, {software.ticks} in a sample. Gains are parameters.",
        "All other numbers of the study are constants here.",
        "Compile without contraction and without fast arithmetic: cc -std=c99 -O2 -ffp-contract=off.",
    ]
    sentences += [sentence.replace("`", "") for sentence in software.outputs]
    return comment_lines(sentences)


def declarations(files: SoftwareFiles) -> str:
    """Write the declarations of the header: the structures and functions of the software."""
    software = files.software
    real = c_type(software.real)
    parameters = []
    for number, parameter in enumerate(files.parameters, start=1):
        parameters.append(member_text(real, parameter.name, parameter_comment(number, parameter)))
    return fill(
        "inner_loop.h",
        name=software.prefix,
        parameters=parameters or f"{real} unused;",
        readings=[f"{real} {reading};" for reading in files.readings],
        commands=[f"{real} {command};" for command in software.commands],
        held=[f"{real} {member};" for member in software.state_names],
        ticks=str(software.ticks),
        length_error=f"{100.0 * LENGTH_ERROR:g}",  # in per cent
        transfer="" if files.transfer is None else transfer_declaration(software),
    )


def source_body(files: SoftwareFiles) -> str:
    """Write the definitions of the source: tables, helpers and the functions of the software."""
    software = files.software
    name = software.prefix
    definitions = dict.fromkeys(text for function in files.functions for text in function.definitions)  # each once
    zero = c_literal(software.real.type(0.0), software.real)
    return fill(
        "inner_loop.c",
        name=name,
        is_finite=finite_function(software.real),
        definitions=joined_definitions(definitions),
        readings_valid=valid_readings_condition(files),
        commands_finite=finite_condition([f"wanted->{command}" for command in software.commands]),
        held_finite=finite_condition([f"updated.{member}" for member in software.state_names]),
        parameters=assignment_lines("inner_loop->parameters", files.parameters, software.real),
        cleared=[f"inner_loop->{member} = {zero};" for member in software.state_names],
        checks=check_lines(files.parameters, software.real),
        start=body_lines(files.start, name),
        sample=body_lines(files.sample, name),
        tick=body_lines(files.tick, name),
        transfer="" if files.transfer is None else transfer_definition(files.transfer, software),
    )


def valid_readings_condition(files: SoftwareFiles) -> str:
    """Write the condition in C that all readings are finite, and that vectors of length 1 have this length."""
    conditions = [finite_condition([f"seen->{reading}" for reading in files.readings])]
    for direction in files.software.directions:
        if set(direction) <= set(files.readings):
            components = [f"seen->{reading}" for reading in direction]
            conditions.append(unit_length_condition(components, files.software.real))
    return "\n        && ".join(conditions)


def body_lines(function: FunctionLines, name: str) -> list[str]:
    """Write the lines of a function's body with their first lines, which C needs: the pointer p, and a use of ``seen``.

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
    """Write the declaration in C of the function for a takeover in flight."""
    real = c_type(software.real)
    members = [f"{real} {name};" for name in software.drive_names]
    return fill("inner_loop_transfer.h", name=software.prefix, driven=members)


def transfer_definition(function: FunctionLines, software: TracedSoftware) -> str:
    """Write the definition in C of the function for a takeover in flight.

    Args:
        function: The body of the function.
        software: The software.
    """
    return fill(
        "inner_loop_transfer.c",
        name=software.prefix,
        driven_finite=finite_condition([f"driven->{name}" for name in software.drive_names]),
        transfer=body_lines(function, software.prefix),
    )


def replay_bench(files: SoftwareFiles) -> ReplayBench:
    """Make the bench of the software, whose rows are ticks.

    A row has the inputs readings, commands and uncertain parameters, also those that no function reads; then the
    results.
    """
    software = files.software
    uncertain = [parameter.name for parameter in software.parameters if parameter.uncertain]
    disturbance_lines = [
        "real *const numbers = (real *)&held->parameters;",
        "numbers[random_bits() % (sizeof held->parameters / sizeof(real))] = hostile_number();",
    ]
    return ReplayBench(
        label=LABEL,
        prefix=software.prefix,
        precision=software.precision,
        row="tick",
        inputs=len(software.readings) + len(software.commands) + len(uncertain),
        results=("flags", *software.state_names),
        advance=advance_lines(files, uncertain),
        disturb=disturbance_lines,
        stays_finite=True,
        shows_arithmetic=True,
    )


def advance_lines(files: SoftwareFiles, uncertain: Sequence[str]) -> list[str]:
    """Statements in C that call the software for a row of the bench, which begins with its start.

    Args:
        files: The software.
        uncertain: Names of the parameters that a row has.
    """
    software = files.software
    name = software.prefix
    first_command = len(software.readings)
    first_parameter = first_command + len(software.commands)
    read_parameters = {parameter.name for parameter in files.parameters}
    readings = [f"seen.{reading}" if reading in files.readings else "" for reading in software.readings]
    commands = [f"wanted.{command}" for command in software.commands]
    parameters = [f"held->parameters.{parameter}" if parameter in read_parameters else "" for parameter in uncertain]
    return [
        f"{name}_readings seen;",
        f"{name}_commands wanted;",
        "uint32_t flags = 0;",
        *row_assignments(readings, first=0),
        *row_assignments(commands, first_command),
        "if (k == 0) {",
        f"    {name}_init(held);",
        *(f"    {line}" for line in row_assignments(parameters, first_parameter)),
        f"    flags |= {name}_start(held, &seen);",
        "}",
        f"if (k % {software.ticks} == 0) {{",
        f"    flags |= {name}_sample(held, &seen, &wanted);",
        "}",
        f"flags |= {name}_tick(held, &seen);",
        "results[0] = (real)flags;",
        *(f"results[{position}] = held->{member};" for position, member in enumerate(software.state_names, start=1)),
        "return flags;",
    ]


def row_assignments(members: Sequence[str], first: int) -> list[str]:
    """Statements in C that assign consecutive numbers of a row.

    Args:
        members: What gets each number; empty: nothing gets it.
        first: Position of the first number in the row.
    """
    return [f"{member} = row[{position}];" for position, member in enumerate(members, start=first) if member]


def readme_lines(files: SoftwareFiles) -> list[str]:
    """Write the section of the README on the software on board."""
    software = files.software
    section = fill(
        "inner_loop_readme.md",
        name=software.prefix,
        period=f"{software.period:g}",
        ticks=str(software.ticks),
        outputs=[f"* {sentence}" for sentence in software.outputs],
    )
    return section.split("\n")
