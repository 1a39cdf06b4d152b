"""Show what a log holds."""

from functools import partial

from dssc_jax.console.terminal import output, show_table
from dssc_jax.flight_logs.reading.clocks import ClockStep
from dssc_jax.flight_logs.reading.contents import FieldValues, LogContents
from dssc_jax.flight_logs.reading.resets import reset_list
from dssc_jax.flight_logs.reading.ulog_scan import LogTopic

SYSTEM = ("sys_name", "ver_hw", "ver_sw")
"""What is shown of a log's system: name, hardware (PX4_SITL: PX4's simulation) and version of the software."""
NO_TIMES = "no column of times with numbers (t, or a name that begins with time, stamp or seconds)"
DERIVED_MARK = "*"
FAR = 1e6  # s; no log is as long


def show_log(log: LogContents) -> None:
    """Print span, segments and topics of a log, and the fields of the topics that were asked for."""
    say = partial(output().print, soft_wrap=True, markup=False)
    for line in (*span_lines(log), *damage_lines(log), *clock_lines(log), *validity_lines(log)):
        say(line)
    if log.topics and not log.fields:
        head = ("topic", "messages", "a second", "first [s]", "last [s]")
        show_table(head, [topic_row(topic) for topic in log.topics])
    if log.fields:
        head = ("column", "values", "lowest", "median", "highest")
        show_table(head, [field_row(field) for field in log.fields])
    if any(field.derived for field in log.fields):
        say(f"{DERIVED_MARK} in the model's axes: east, north, up; a body's forward, left, up; SI units and radians")


def span_lines(log: LogContents) -> list[str]:
    """How long a log is, from what system, and when it was armed."""
    system = ", ".join(log.system[name] for name in SYSTEM if name in log.system)
    duration = NO_TIMES if log.lacks_times else f"{log.duration:.4g} s"
    lines = [f"{log.name}: {duration}{f', {system}' if system else ''}"]
    for segment in log.segments:
        lines.append(f"{segment.name}: {segment.begin:.4g} s to {segment.end:.4g} s")
    if log.topics and not log.segments:
        lines.append("never armed, as far as the log tells")
    if not log.topics and not log.fields:
        lines.append("it holds no message, and no column of numbers")
    return lines


def damage_lines(log: LogContents) -> list[str]:
    """What a log lacks: late messages, dropouts, damaged bytes, cells of text, and its end."""
    lines = []
    for message in log.late:
        lines.append(
            f"late: the last message of {message.topic} is at {message.time:.4g} s, long after those of all others"
        )
    count, lost = log.dropouts
    if count:
        lines.append(f"{count} dropouts of together {lost:.3g} s")
    if log.damaged is not None:
        passed_over = f"{log.lost:,} bytes at {places(log.damages)} are passed over"
        lines.append(f"damaged: byte {log.damaged} is no message; {passed_over}")
    if log.text_columns:
        places_of_texts = f" ({'; '.join(log.text_cells)})" if log.text_cells else ""
        lines.append(f"text in some cells, and so not shown: {', '.join(log.text_columns)}{places_of_texts}")
    if log.cut:
        lines.append("cut off: the file ends within a message, and what was to come is not in it")
    return lines


def clock_lines(log: LogContents) -> list[str]:
    """Where a log's times fall, and where messages are missing."""
    lines = []
    for step in log.falls:
        number = "once" if step.falls == 1 else f"{step.falls:,} times"
        lines.append(f"times fall {number}, first {span(step)}: {', '.join(step.topics)}")
    for step in log.gaps:
        usual = f"where {step.rate:.3g} a second are usual (messages are missing, or the clock jumps)"
        lines.append(f"no message {span(step)}, {usual}: {', '.join(step.topics)}")
    return lines


def validity_lines(log: LogContents) -> list[str]:
    """Where an estimator was reset, and which fields are marked as invalid."""
    lines = []
    for label in dict.fromkeys(reset.label for reset in log.resets):
        resets = [reset for reset in log.resets if reset.label == label]
        lines.append(f"reset of the estimator {reset_list(resets)}: {label}")
    for invalid in log.invalid:
        lines.append(f"invalid: {', '.join(invalid.fields)}, as {invalid.text()}")
    return lines


def span(step: ClockStep) -> str:
    """Both ends of a step, to the millisecond."""
    texts = [f"{value:.3f}" if abs(value) < FAR else f"{value:.4g}" for value in step.stamps]
    return f"from {texts[0]} s to {texts[1]} s"


def places(count: int) -> str:
    """A number of places in words."""
    return "1 place" if count == 1 else f"{count:,} places"


def topic_row(topic: LogTopic) -> tuple[str, ...]:
    """A topic as a row."""
    numbers = (topic.rate, topic.first, topic.last)
    return (topic.name, f"{topic.messages:,}", *(number(value) for value in numbers))


def field_row(field: FieldValues) -> tuple[str, ...]:
    """A field as a row."""
    values = (field.lowest, field.median, field.highest)
    mark = DERIVED_MARK if field.derived else ""
    return (field.name + mark, f"{field.finite:,}", *(number(value) for value in values))


def number(value: float) -> str:
    """A number with four digits; nothing for NaN."""
    return "" if value != value else f"{value:.4g}"
