"""The warnings of a comparison or a fit: what a user has to look at before the answer is trusted."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

from dssc_jax.core.quantities import Quantity


@dataclass(frozen=True)
class SignalWarning:
    """A reason to doubt what a log tells, with the signal that it concerns."""

    signal: Annotated[
        str, Quantity("", "signal of the log or number of the study that a warning concerns; empty: the answer as such")
    ]
    text: Annotated[str, Quantity("", "what is wrong, what follows from it, and what to do")]


@dataclass(frozen=True)
class FlightWarning(SignalWarning):
    """A warning of one flight among several."""

    log: Annotated[str, Quantity("", "name of the log that it concerns")]


def signal_warnings(hints: Mapping[str, str]) -> tuple[SignalWarning, ...]:
    """The warnings for hints, which say by signal or number what is wrong with it."""
    return tuple(SignalWarning(name, f"{name} {text}") for name, text in hints.items())
