"""Show what a log holds."""

from functools import partial

from dssc_jax.console.terminal import output, show_table
from dssc_jax.flight_logs.clocks import ClockStep
from dssc_jax.flight_logs.contents import FieldValues, LogContents
from dssc_jax.flight_logs.resets import reset_list
from dssc_jax.flight_logs.ulog_scan import LogTopic

SYSTEM = ("sys_name", "ver_hw", "ver_sw")
"""What is shown of a log's system: name, hardware (PX4_SITL: PX4's simulation) and version of the software."""
NO_TIMES = "no column of times with numbers (t, or a name that begins with time, stamp or seconds)"
DERIVED_MARK = "*"
FAR = 1e6  # s; no log is as long


def show_log(log: LogContents) -> None:
    """Print span, segments and topics of a log, and the fields of the topics that were asked for."""
    say = partial(output().print, soft_wrap=True, markup=False)
    system = ", ".join(log.system[name] for name in SYSTEM if name in log.system)
    duration = NO_TIMES if log.lacks_times else f"{log.duration:.4g} s"
    say(f"{log.name}: {duration}{f', {system}' if system else ''}")
    for segment in log.segments:
        say(f"{segment.name}: {segment.begin:.4g} s to {segment.end:.4g} s")
    if log.topics and not log.segments:
        say("never armed, as far as the log tells")
    if not log.topics and not log.fields:
        say("it holds no message, and no column of numbers")
    for message in log.late:
        say(f"late: the last message of {message.topic} is at {message.time:.4g} s, long after those of all others")
    count, lost = log.dropouts
    if count:
        say(f"{count} dropouts of together {lost:.3g} s")
    if log.damaged is not None:
        say(f"damaged: byte {log.damaged} is no message; {log.lost:,} bytes at {places(log.damages)} are passed over")
    if log.text_columns:
        places_of_texts = f" ({'; '.join(log.text_cells)})" if log.text_cells else ""
        say(f"text in some cells, and so not shown: {', '.join(log.text_columns)}{places_of_texts}")
    if log.cut:
        say("cut off: the file ends within a message, and what was to come is not in it")
    for step in log.falls:
        number = "once" if step.falls == 1 else f"{step.falls:,} times"
        say(f"times fall {number}, first {span(step)}: {', '.join(step.topics)}")
    for step in log.gaps:
        usual = f"where {step.rate:.3g} a second are usual (messages are missing, or the clock jumps)"
        say(f"no message {span(step)}, {usual}: {', '.join(step.topics)}")
    for label in dict.fromkeys(reset.label for reset in log.resets):
        say(f"reset of the estimator {reset_list([reset for reset in log.resets if reset.label == label])}: {label}")
    for invalid in log.invalid:
        say(f"invalid: {', '.join(invalid.fields)}, as {invalid.text()}")
    if log.topics and not log.fields:
        head = ("topic", "messages", "a second", "first [s]", "last [s]")
        show_table(head, [topic_row(topic) for topic in log.topics])
    if log.fields:
        head = ("column", "values", "lowest", "median", "highest")
        show_table(head, [field_row(field) for field in log.fields])
    if any(field.derived for field in log.fields):
        say(f"{DERIVED_MARK} in the model's axes: east, north, up; a body's forward, left, up; SI units and radians")


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
