"""The files of a monitor: header and source in C99 that is C++ as well, its bench, and its section of the README."""

from dssc_jax.flight_code.c_files import comment_lines, generated_by, header_file, joined_definitions, source_file
from dssc_jax.flight_code.premises import Premises
from dssc_jax.flight_code.replay_bench import ReplayBench, bench_files
from dssc_jax.flight_code.template_files import fill
from dssc_jax.flight_code.traced_monitor import TracedMonitor
from dssc_jax.lanes.c.operations import c_type
from dssc_jax.lanes.c.text import CText, comment
from dssc_jax.lanes.program import Value

LABEL = "monitor"
"""Name of the software in words."""
RECORDING = "monitored.bin"
"""Name of the file with the bench's recording."""
LOCAL_NAMES = {"monitor", "seen", "before", "memory", "current", "latched", "sample", "first"}
"""Names in the template files, which no computed variable may have."""
INPUT_MEANINGS = {
    "y": "the output, as the controller gets it",
    "y_dot": "its rate",
    "y_ref": "the reference",
    "y_ref_dot": "its rate",
    "u_p": "the command of the controller",
    "sliding_margin": "that of the controller's telemetry; NAN if its step returned a flag",
    "tilt": "rad: angle between body z and the vertical",
    "rotor": "N: commanded thrust of a rotor",
}
"""Meanings of the numbers of a sample, by the end of their names; a rotor's number follows its name."""


def monitor_texts(monitor: TracedMonitor, study: str) -> dict[str, str]:
    """Contents of the monitor's header, source, bench and makefile, by the file's name.

    Args:
        monitor: The monitor.
        study: Name of the study.
    """
    return {
        f"{monitor.prefix}.h": header_text(monitor, study),
        f"{monitor.prefix}.c": source_text(monitor, study),
        **bench_files(replay_bench(monitor), RECORDING),
    }


def file_comment(monitor: TracedMonitor, study: str) -> list[str]:
    """The lines of the first comment of header and source."""
    sentences = [
        f"Monitor of the study {study}. {generated_by('dssc-jax code --monitor')}",
        f"It compares a flight with a verified certificate: {monitor.premises.statement}.",
        f"Sample time: {monitor.premises.sample_time:g} s. Bounds are constants of the code, rounded outwards.",
        "A flag says that the flight is none that the certificate covers. No flag does not say that it is one.",
        monitor.premises.unwatched,
        "Compile without contraction and without fast arithmetic: cc -std=c99 -O2 -ffp-contract=off.",
    ]
    return comment_lines(filter(None, sentences))  # without an empty one


def flag_name(monitor: TracedMonitor, name: str) -> str:
    """Name of the constant in C with a flag's bit, from the flag's name.

    Args:
        monitor: The monitor, whose prefix comes first.
        name: Name of the flag, without the prefix.
    """
    return f"{monitor.prefix}_{name}".upper()


def header_text(monitor: TracedMonitor, study: str) -> str:
    """The header: a sentence for each flag, the sample, the state and the functions.

    Args:
        monitor: The monitor.
        study: Name of the study.
    """
    real = c_type(monitor.real)
    flags = monitor.premises.flags()
    lines = []
    for bit, flag in enumerate(flags):
        lines += comment(flag.sentence)
        lines.append(f"#define {flag_name(monitor, flag.name)} 0x{1 << bit:x}u")
    declarations = fill(
        "monitor.h",
        name=monitor.prefix,
        flags=lines,
        flag_count=flag_name(monitor, "flags"),
        count=str(len(flags)),
        inputs=[f"{real} {name};  /* {input_meaning(name)} */" for name in monitor.inputs],
        memories=[f"{real} {name};" for name in monitor.memories],
    )
    return header_file(monitor.prefix, file_comment(monitor, study), declarations)


def input_meaning(name: str) -> str:
    """The meaning of a number of the sample, by the longest key of :data:`INPUT_MEANINGS` that its name has."""
    endings = [ending for ending in INPUT_MEANINGS if name.endswith(ending) or name.startswith(f"{ending}_")]
    return INPUT_MEANINGS[max(endings, key=len)]


def source_text(monitor: TracedMonitor, study: str) -> str:
    """The source of the monitor: its start and its step.

    Args:
        monitor: The monitor.
        study: Name of the study.
    """
    flag_count = len(monitor.premises.flags())
    first_samples = [f"first[{bit}]" for bit in range(flag_count)]
    memories = [f"memory.{name}" for name in monitor.memories]
    members = ["latched", "sample", *first_samples, *memories]  # in the order of MonitorState's leaves
    inputs = [*(f"before.{member}" for member in members), *(f"seen->{name}" for name in monitor.inputs)]
    function = CText(monitor.step.program, monitor.step.origins, inputs, monitor.real, LOCAL_NAMES)
    outputs = [output for output in monitor.step.program.outputs if isinstance(output, Value)]
    function.compute(outputs)
    function.line("")
    for member, output in zip([*members, "current"], outputs, strict=True):
        function.line(f"monitor->{member} = {function.read(output)};")
    definitions = [*function.tables, *function.notation.helpers(), *function.functions.values()]
    body = fill(
        "monitor.c",
        name=monitor.prefix,
        definitions=joined_definitions(definitions),
        flag_count=flag_name(monitor, "flags"),
        begin=[f"monitor->{memory} = 0;" for memory in memories],
        computation=function.lines,
    )
    return source_file(LABEL, f"{monitor.prefix}.h", file_comment(monitor, study), body)


def replay_bench(monitor: TracedMonitor) -> ReplayBench:
    """The bench of the monitor, whose rows are samples."""
    name = monitor.prefix
    advance = [
        f"{name}_sample seen;",
        *(f"seen.{member} = row[{position}];" for position, member in enumerate(monitor.inputs)),
        "if (k == 0) {",
        f"    {name}_init(held);",
        "}",
        f"results[0] = (real){name}_step(held, &seen);",
        "results[1] = (real)held->latched;",
        *(f"results[{position}] = held->memory.{memory};" for position, memory in enumerate(monitor.memories, start=2)),
        "return held->latched;",
    ]
    results = ("current", "latched", *monitor.memories)
    return ReplayBench(
        label=LABEL,
        prefix=name,
        precision=monitor.precision,
        row="sample",
        inputs=len(monitor.inputs),
        results=results,
        advance=advance,
    )


def readme_lines(monitor: TracedMonitor) -> list[str]:
    """The section of the README on the monitor."""
    name = monitor.prefix
    premises: Premises = monitor.premises
    lines = [
        "## The monitor",
        "",
        f"`{name}.h`, `{name}.c` tell when a flight is none that the certificate covers: {premises.statement}. "
        f"{premises.unwatched}".rstrip(),
        "",
        f"Call `{name}_init` once, and `{name}_step` at every sample after the controllers, with what they got, gave "
        "and reported. What is not known is NAN: it raises no flag and clears none. `current` has the flags of the "
        "sample, `latched` those since the start, `first` the sample at which each was raised first.",
        "",
    ]
    lines += [f"* `{flag_name(monitor, flag.name)}`: {flag.sentence}" for flag in premises.flags()]
    return [*lines, ""]
