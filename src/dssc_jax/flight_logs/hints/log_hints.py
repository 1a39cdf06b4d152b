"""All hints about a log, by what they concern."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from dssc_jax.flight_logs.signal_warnings import Hint


class LogHints(NamedTuple):
    """Why a log may contradict its study, in words for each signal or number.

    Args:
        conversions: Signals that are the study's in another unit, sign or column.
        shifts: References that are the study's at another time, or by another clock.
        slopes: Rates that are not the slope of the study's reference.
        starts: Numbers at which the study starts while the flight cannot have.
        attitudes: Numbers of the attitude at which the study starts while the log has another.
        estimator: Counters of resets of the estimator, and flags that call its values invalid.
        factors: Outputs that stick, or are not the integrals of their derivatives by a factor that names no unit;
            commands that are not the analysed controller's; times ``t`` that repeat.
        jumps: Outputs that jump while their derivatives do not.
        others: References that are not the study's, for no reason that is known.
    """

    conversions: Mapping[str, Hint]
    shifts: Mapping[str, Hint]
    slopes: Mapping[str, Hint] = MappingProxyType({})
    starts: Mapping[str, Hint] = MappingProxyType({})
    attitudes: Mapping[str, Hint] = MappingProxyType({})
    estimator: Mapping[str, Hint] = MappingProxyType({})
    factors: Mapping[str, Hint] = MappingProxyType({})
    jumps: Mapping[str, Hint] = MappingProxyType({})
    others: Mapping[str, Hint] = MappingProxyType({})

    def all(self) -> dict[str, Hint]:
        """All of them, by signal or number."""
        numbers = (self.starts, self.attitudes)
        references = (self.shifts, self.others, self.slopes)
        parts = (self.factors, self.jumps, self.conversions, *references, *numbers, self.estimator)
        return {name: hint for part in parts for name, hint in part.items()}
