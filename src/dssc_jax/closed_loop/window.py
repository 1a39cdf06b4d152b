"""The samples that a metric counts, and when it takes a loop for settled: read, written and compared in one place.

Everything that a study says of a window is declared on the fields of :class:`Window`. The tables of the study file, the
names of measures, the words of requirements and copies of a study follow from them.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, NamedTuple


class WindowEntry(NamedTuple):
    """How a study writes a field of a window.

    Args:
        key: Its name in ``[metrics]`` and ``[[requirement]]``.
        meaning: In words, with the unit.
        suffix: Added to a measure's name, with the value.
        words: Said of a requirement, with the value.
        bounds: Admissible values, as pydantic's ``Field`` names bounds.
        relative: Whether the value of ``[metrics]`` is left unsaid; if not, the default is.
        absent: What holds where no value is written, in words; empty if the default is a value that can be written.
    """

    key: str
    meaning: str
    suffix: str
    words: str
    bounds: Mapping[str, float]
    relative: bool = True
    absent: str = ""


def entry_field(default: float, entry: WindowEntry) -> Any:
    """A field of a window with its entry in a study."""
    return field(default=default, metadata={"entry": entry})


@dataclass(frozen=True)
class Window:
    """Samples at ``after`` <= t <= ``until`` [s].

    The error that counts as settled is ``band``, in the output's unit; for a step response, ``percent`` of the step.
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
            " with a settling band of {:g}",
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
        """The window that entries of a study give.

        Args:
            entries: Values by the names of the study file; others are ignored.
            default_window: Its values stand for entries that are absent or None.
        """
        defaults = vars(default_window or cls())
        values = {name: entries.get(entry.key) for name, entry in window_entries().items()}
        return cls(**{name: defaults[name] if value is None else float(value) for name, value in values.items()})

    def entries(self) -> dict[str, float]:
        """The window as a study's ``[metrics]`` or ``[[requirement]]`` has it: the inverse of :meth:`of`."""
        written = {}
        for name, entry in window_entries().items():
            value = getattr(self, name)
            if not entry.absent or value != getattr(WHOLE_RUN, name):
                written[entry.key] = value
        return written

    def suffix(self, default_window: "Window") -> str:
        """The suffix of a measure's name over another window than the study's default: the start, and what differs."""
        if self == default_window:
            return ""
        parts = []
        for name, entry in window_entries().items():
            value = getattr(self, name)
            if name == "after" or value != getattr(default_window, name):
                parts.append(entry.suffix.format(value))
        return "".join(parts)

    def words(self, default_window: "Window") -> str:
        """The window in words, as far as a requirement needs them."""
        parts = []
        for name, entry in window_entries().items():
            value = getattr(self, name)
            if value != getattr(default_window if entry.relative else WHOLE_RUN, name):
                parts.append(entry.words.format(value))
        return "".join(parts)


WHOLE_RUN = Window()
"""The window of a study that gives none."""


def window_entries() -> dict[str, WindowEntry]:
    """The entries in a study by the window's fields."""
    return {window_field.name: window_field.metadata["entry"] for window_field in fields(Window)}


def window_defaults() -> dict[str, float]:
    """Values of a window that a study does not give, by the names of the study file."""
    return WHOLE_RUN.entries()
