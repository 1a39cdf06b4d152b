"""The collection of all hints about a log, grouped by what they concern."""

from collections.abc import Mapping
from dataclasses import dataclass, field

from dssc_jax.flight_logs.reading.reader import log_signals
from dssc_jax.flight_logs.signal_warnings import Hint


@dataclass(frozen=True)
class LogHints:
    """Why a log may contradict its study, in words for each signal or number.

    Args:
        conversions: Signals that are the study's in another unit, sign or column, or each other's.
        shifts: References that are the study's at another time, or by another clock.
        slopes: Rates that are not the slope of the study's reference.
        starts: Numbers at which the study starts while the flight cannot have.
        attitudes: Numbers of the attitude at which the study starts while the log has another.
        estimator: Counters of resets of the estimator, and flags that call its values invalid.
        factors: Outputs that stick, were at another time, or are not the integrals of their derivatives by a factor
            that names no unit; commands that are not the analysed controller's; times ``t`` that repeat.
        jumps: Outputs that jump while their derivatives do not.
        others: References that are not the study's, for no reason that is known.
    """

    conversions: dict[str, Hint] = field(default_factory=dict)
    shifts: dict[str, Hint] = field(default_factory=dict)
    slopes: dict[str, Hint] = field(default_factory=dict)
    starts: dict[str, Hint] = field(default_factory=dict)
    attitudes: dict[str, Hint] = field(default_factory=dict)
    estimator: dict[str, Hint] = field(default_factory=dict)
    factors: dict[str, Hint] = field(default_factory=dict)
    jumps: dict[str, Hint] = field(default_factory=dict)
    others: dict[str, Hint] = field(default_factory=dict)

    def replace_columns(self, channel: str, hints: Mapping[str, Hint]) -> None:
        """Put hints about the columns of a channel in place of all others about its signals."""
        for gathered in (self.conversions, self.factors, self.jumps, self.shifts, self.others, self.slopes):
            for name in log_signals((channel,)):
                gathered.pop(name, None)
        self.conversions.update(hints)

    def all(self) -> dict[str, Hint]:
        """All hints, by signal or number; of several about the same signal, that of the last kind in ``parts``."""
        numbers = (self.starts, self.attitudes)
        references = (self.shifts, self.others, self.slopes)
        parts = (self.factors, self.jumps, self.conversions, *references, *numbers, self.estimator)
        return {name: hint for part in parts for name, hint in part.items()}
