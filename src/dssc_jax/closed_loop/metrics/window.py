"""The window of a metric: the samples that it counts, and the bands within which a loop counts as settled.

The fields of :class:`Window` declare everything that a study can state about a window. The tables of the study file,
the names of measures, the words of requirements and copies of a study follow from them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple

import jax.numpy as jnp

from dssc_jax.core.signals import Scalar


class WindowEntry(NamedTuple):
    """How a field of a :class:`Window` appears in the study file, in names of results, and in texts.

    Args:
        key: Name in the study's tables ``[metrics]`` and ``[[requirement]]``.
        meaning: Meaning in words, with the unit.
        suffix: Format of the value in the name of a measure.
        words: Format of the value in the text of a requirement; ``{output}`` stands for the unit of the output.
        bounds: Admissible values, with pydantic's names of bounds.
        relative: Whether texts omit a value that equals the value in ``[metrics]``; False: they omit a value that
            equals the value of :data:`WHOLE_RUN`.
        absent: Meaning of an absent value in words; empty if the default is a value that a study can contain.
    """

    key: str
    meaning: str
    suffix: str
    words: str
    bounds: Mapping[str, float]
    relative: bool = True
    absent: str = ""


def entry_field(default: float, entry: WindowEntry) -> Any:
    """A dataclass field of a window, from its default value and the entry that sets it in a study."""
    return field(default=default, metadata={"entry": entry})


@dataclass(frozen=True)
class Window:
    """The samples that a metric counts, and the thresholds of metrics.

    Args:
        after: Start of the window [s]; samples at t >= ``after`` count.
        band: The error counts as settled if |e| is at most this, in the output's unit.
        percent: A step response counts as settled within this share of the step [%].
        until: End of the window [s]; samples at t <= ``until`` count.
        chattering: The command chatters above this frequency [Hz]; 0 stands for 1/(20 T_s).
    """

    after: float = entry_field(
        0.0,
        WindowEntry("after", "start of the window [s]", "_after_{:.12g}", " after {:g} s", {"ge": 0.0}, relative=False),
    )
    band: float = entry_field(
        0.05,
        WindowEntry(
            "settling_band",
            "|e| below which the loop counts as settled, in the output's unit",
            "_within_{:.12g}",
            " with a settling band of {:g} {output}",
            {"gt": 0.0},
        ),
    )
    percent: float = entry_field(
        2.0,
        WindowEntry(
            "settling_percent",
            "share of a step below which its response counts as settled [%]",
            "_within_{:.12g}_percent",
            " with {:g} % of a step counted as settled",
            {"gt": 0.0, "lt": 100.0},
        ),
    )
    until: float = entry_field(
        math.inf,
        WindowEntry(
            "until",
            "end of the window [s]",
            "_until_{:.12g}",
            " up to {:g} s",
            {"ge": 0.0},
            relative=False,
            absent="the flight's end",
        ),
    )
    chattering: float = entry_field(
        0.0,
        WindowEntry(
            "chattering_frequency",
            "frequency above which the command counts as chattering [Hz]",
            "_above_{:.12g}",
            " with chattering above {:g} Hz",
            {"gt": 0.0},
            absent="a tenth of the Nyquist frequency, 1/(20 T_s)",
        ),
    )

    @classmethod
    def of(cls, entries: Mapping[str, Any], default_window: "Window | None" = None) -> "Window":
        """The window that a table of a study describes.

        Args:
            entries: The table; names that belong to no field are ignored.
            default_window: The window whose values replace entries that are absent or None.
        """
        values = dict(vars(default_window or cls()))
        for name, entry in window_entries().items():
            value = entries.get(entry.key)
            if value is not None:
                values[name] = float(value)
        return cls(**values)

    def entries(self) -> dict[str, float]:
        """The window as a table of a study, the inverse of :meth:`of`.

        A value that a study cannot state, such as an infinite end, is left out.
        """
        written = {}
        for name, entry in window_entries().items():
            value = getattr(self, name)
            if not entry.absent or value != getattr(WHOLE_RUN, name):
                written[entry.key] = value
        return written

    def suffix(self, default_window: "Window") -> str:
        """The end of a measure's name that identifies its window, such as ``_after_2``.

        The end is empty for the study's default window. For any other window, the end has the window's start, and each
        other value that differs from the default.

        Args:
            default_window: The study's default window.
        """
        if self == default_window:
            return ""
        parts = []
        for name, entry in window_entries().items():
            value = getattr(self, name)
            if name == "after" or value != getattr(default_window, name):
                parts.append(entry.suffix.format(value))
        return "".join(parts)

    def words(self, default_window: "Window", output: str) -> str:
        """The window in the text of a requirement, such as `` after 2 s``; usual values are omitted.

        Args:
            default_window: The window of the study's ``[metrics]``.
            output: Unit of the output.
        """
        parts = []
        for name, entry in window_entries().items():
            value = getattr(self, name)
            usual_window = default_window if entry.relative else WHOLE_RUN
            if value != getattr(usual_window, name):
                parts.append(entry.words.format(value, output=output))
        return "".join(parts)


WHOLE_RUN = Window()
"""The window of a study that states none."""


def window_entries() -> dict[str, WindowEntry]:
    """The :class:`WindowEntry` of each field of a window, by the field's name."""
    return {window_field.name: window_field.metadata["entry"] for window_field in fields(Window)}


def window_defaults() -> dict[str, float]:
    """The values of a window that hold if a study leaves them out, by their names in the study file."""
    return WHOLE_RUN.entries()


class Span(NamedTuple):
    """The length of a window in samples, from which the final value of a metric follows.

    Args:
        steps: Number of samples up to the end of the window.
        sample_count: Number of samples in the window.
        sample_time: Sample time T_s [s].
    """

    steps: Scalar
    sample_count: Scalar
    sample_time: float


def periods_lasting(duration: float, sample_time: float) -> int:
    """The least number of sample periods that together last at least a duration [s].

    If rounding has made a duration of k T_s slightly longer, the number is still k.
    """
    return math.ceil(duration / sample_time - ROUNDING)


def first_sample(after: float, sample_time: float) -> int:
    """Index of the first sample at t >= ``after`` [s]."""
    return max(0, periods_lasting(after, sample_time))


MOST_SAMPLES = 2**31 - 1  # of a run
ROUNDING = 1e-9  # share of a sample within which a time counts as that of the sample


def samples_before_end(window: Window, sample_time: float, steps: Scalar) -> Scalar:
    """Number of samples up to the end of a window, at t <= until, in a run of ``steps`` samples.

    A sample at k T_s counts even if rounding has made its time slightly later than the end.

    Args:
        window: The window, which ends at ``window.until`` [s].
        sample_time: Sample time T_s [s].
        steps: Number of samples of the run, which may be traced.
    """
    if math.isinf(window.until):
        return steps
    count = min(MOST_SAMPLES, math.floor(window.until / sample_time + ROUNDING) + 1)
    return min(steps, count) if isinstance(steps, int) else jnp.minimum(steps, count)


def span_of(window: Window, steps: Scalar, sample_time: float) -> Span:
    """The length of a window in samples, in a run of ``steps`` samples.

    Args:
        window: The window.
        steps: Number of samples of the run, which may be traced.
        sample_time: Sample time T_s [s].
    """
    end = samples_before_end(window, sample_time, steps)
    return Span(end, end - first_sample(window.after, sample_time), sample_time)


def in_window(window: Window, k: Scalar, sample_time: float) -> Scalar | None:
    """Whether sample k lies in the window; None if all samples do, so that the compiled program needs no test.

    Args:
        window: The window.
        k: Index of the sample, which is within the run.
        sample_time: Sample time T_s [s].
    """
    start = first_sample(window.after, sample_time)
    if math.isinf(window.until):
        return None if start == 0 else k >= start
    return (k >= start) & (k < samples_before_end(window, sample_time, MOST_SAMPLES))
