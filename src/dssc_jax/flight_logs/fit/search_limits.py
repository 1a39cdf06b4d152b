"""The limits of the search for the best fit of a log, and the count of its simulations."""

import time
from typing import NamedTuple

from dssc_jax.core.signals import ProgressCallback

MOST_SIMULATIONS = 2000


class SearchLimits(NamedTuple):
    """When the search for the minimum ends with the best one so far.

    Args:
        simulations: Most simulations, each with the derivatives by all numbers.
        seconds: Longest time [s]; None: no limit.
    """

    simulations: int = MOST_SIMULATIONS
    seconds: float | None = None


USUAL_LIMITS = SearchLimits()


class SearchCount:
    """The simulations of a fit so far, and whether its search has to end.

    Args:
        limits: When the search ends.
        progress: Called with the number of simulations done, and the largest number allowed.
    """

    def __init__(self, limits: SearchLimits = USUAL_LIMITS, progress: ProgressCallback | None = None) -> None:
        self.limits = limits
        self.progress = progress
        self.simulations = 0
        self.begin = time.monotonic()
        self.interrupted = False

    def add(self) -> None:
        """Count a simulation."""
        self.simulations += 1
        if self.progress is not None:
            self.progress(min(self.simulations, self.limits.simulations), self.limits.simulations)

    @property
    def is_stopped(self) -> bool:
        """Whether the user has stopped the search, or its time is over: no further fit may follow."""
        seconds = self.limits.seconds
        is_late = seconds is not None and time.monotonic() - self.begin >= seconds
        return self.interrupted or is_late

    @property
    def reason(self) -> str:
        """Why the search ended before it was complete; empty: it need not end."""
        if self.interrupted:
            return "interrupted"
        if self.simulations >= self.limits.simulations:
            return f"after {self.limits.simulations} simulations"
        seconds = self.limits.seconds
        if seconds is not None and time.monotonic() - self.begin >= seconds:
            return f"after {seconds:g} s"
        return ""
