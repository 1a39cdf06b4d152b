"""Print what a log of a flight contains: its span, damage, topics and fields."""

import math

from dssc_jax.console.terminal import show_line, show_table
from dssc_jax.flight_logs.reading.clocks import ClockStep
from dssc_jax.flight_logs.reading.contents import FieldValues, LogContents
from dssc_jax.flight_logs.reading.resets import reset_list
from dssc_jax.flight_logs.reading.ulog_scan import LogTopic

SYSTEM = ("sys_name", "ver_hw", "ver_sw")
"""Entries of a log's system that are printed: name, hardware (PX4_SITL: simulated) and version of the software."""
NO_TIMES = "no column of times with numbers (t, or a name that begins with time, stamp or seconds)"
"""Printed in place of the duration of a log without times."""
DERIVED_MARK = "*"
"""Marks a field that was converted to the axes of the model."""
LONGEST_LOG = 1e6
"""Times beyond this [s] come from an absolute clock or from damage. They are printed with four digits only."""


def show_log(log: LogContents) -> None:
    """Print a log's span, segments and damage, and then the requested fields, or the topics if none are requested."""
    for line in (*span_lines(log), *damage_lines(log), *clock_lines(log), *validity_lines(log)):
        show_line(line)
    if log.topics and not log.fields:
        head = ("topic", "messages", "a second", "first [s]", "last [s]")
        show_table(head, [topic_row(topic) for topic in log.topics])
    if log.fields:
        head = ("column", "values", "lowest", "median", "highest")
        show_table(head, [field_row(field) for field in log.fields])
    if any(field.derived for field in log.fields):
        show_line(
            f"{DERIVED_MARK} in the model's axes: east, north, up; a body's forward, left, up; SI units and radians"
        )


def span_lines(log: LogContents) -> list[str]:
    """Lines on a log's duration, its system, and when the vehicle was armed."""
    system = ", ".join(log.system[name] for name in SYSTEM if name in log.system)
    duration = NO_TIMES if log.lacks_times else f"{log.duration:.4g} s"
    lines = [f"{log.name}: {', '.join(filter(None, (duration, system)))}"]
    for segment in log.segments:
        lines.append(f"{segment.name}: {segment.begin:.4g} s to {segment.end:.4g} s")
    if log.topics and not log.segments:
        lines.append("never armed, as far as the log tells")
    if not log.topics and not log.fields:
        lines.append("it holds no message, and no column of numbers")
    return lines


def damage_lines(log: LogContents) -> list[str]:
    """Lines on late messages, dropouts, damaged bytes, cells of text, and a missing end."""
    lines = []
    for message in log.late:
        lines.append(
            f"late: the last message of {message.topic} is at {message.time:.4g} s, long after those of all others"
        )
    count, lost = log.dropouts
    if count:
        lines.append(f"{count} dropouts of together {lost:.3g} s")
    if log.damaged is not None:
        places = "1 place" if log.damages == 1 else f"{log.damages:,} places"
        lines.append(f"damaged: byte {log.damaged} is no message; {log.lost:,} bytes at {places} are passed over")
    if log.text_columns:
        cells = f" ({'; '.join(log.text_cells)})" if log.text_cells else ""
        lines.append(f"text in some cells, and so not shown: {', '.join(log.text_columns)}{cells}")
    if log.cut:
        lines.append("cut off: the file ends within a message, and what was to come is not in it")
    return lines


def clock_lines(log: LogContents) -> list[str]:
    """Lines on the times at which a log's clock steps back, and on gaps between messages."""
    lines = []
    for step in log.falls:
        number = "once" if step.falls == 1 else f"{step.falls:,} times"
        lines.append(f"times fall {number}, first {step_text(step)}: {', '.join(step.topics)}")
    for step in log.gaps:
        usual = f"where {step.rate:.3g} a second are usual (messages are missing, or the clock jumps)"
        lines.append(f"no message {step_text(step)}, {usual}: {', '.join(step.topics)}")
    return lines


def validity_lines(log: LogContents) -> list[str]:
    """Lines on resets of the estimator, and on fields that are marked as invalid."""
    lines = []
    for label in dict.fromkeys(reset.label for reset in log.resets):
        resets = [reset for reset in log.resets if reset.label == label]
        lines.append(f"reset of the estimator {reset_list(resets)}: {label}")
    for invalid in log.invalid:
        lines.append(f"invalid: {', '.join(invalid.fields)}, as {invalid.text()}")
    return lines


def step_text(step: ClockStep) -> str:
    """Format the times before and after a step of the clock, to the millisecond."""
    texts = [f"{value:.3f}" if abs(value) < LONGEST_LOG else f"{value:.4g}" for value in step.stamps]
    return f"from {texts[0]} s to {texts[1]} s"


def topic_row(topic: LogTopic) -> tuple[str, ...]:
    """A row on a topic: name, number of messages, rate [1/s], first and last time [s]."""
    numbers = [four_digits(value) for value in (topic.rate, topic.first, topic.last)]
    return (topic.name, f"{topic.messages:,}", *numbers)


def field_row(field: FieldValues) -> tuple[str, ...]:
    """A row on a field: name, number of finite values, and lowest, median and highest value."""
    mark = DERIVED_MARK if field.derived else ""
    numbers = [four_digits(value) for value in (field.lowest, field.median, field.highest)]
    return (f"{field.name}{mark}", f"{field.finite:,}", *numbers)


def four_digits(value: float) -> str:
    """Format a number with four digits; empty for NaN."""
    return "" if math.isnan(value) else f"{value:.4g}"
