"""The answer of `falsify`: the worst draw found, and of all failures found the one nearest to the median draw."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from dssc_jax.closed_loop.metrics.requirements import Requirement
from dssc_jax.core.quantities import Quantity
from dssc_jax.results.fields import MERGED
from dssc_jax.statistics import Likelihood


@dataclass(frozen=True)
class LikelihoodAnswer:
    """How likely a draw is: its distance from the median draw, the density there, and the probability within."""

    distance: Annotated[float, Quantity("1", "distance from the median draw in standard normal scores")]
    log_density: Annotated[float, Quantity("1", "logarithm of the scores' density relative to the mode")]
    mass: Annotated[float, Quantity("1", "probability of a draw at most this far")]


@dataclass(frozen=True)
class PointAnswer:
    """The answer for a simulated draw: its slack, how and when it fails, its uncertain numbers and its likelihood."""

    slack: Annotated[float, Quantity("1", "slack of the worst requirement, relative to its bound")]
    worst_requirement: Annotated[str | None, Quantity("", "the worst requirement; None if the draw ends early")]
    worst_value: Annotated[str | None, Quantity("", "metric of that requirement, with unit; None if it ends early")]
    ending: Annotated[str | None, Quantity("", "how the draw ends early; None if it runs to its end")]
    ended_at: Annotated[float | None, Quantity("s", "time at which it ends early")]
    first_violated: Annotated[str | None, Quantity("", "requirement that it violates first, before it ends")]
    violated_at: Annotated[float | None, Quantity("s", "time at which that violation is certain")]
    witness: Annotated[dict[str, float], Quantity("that of the number", "value of each uncertain number")]
    likelihood: LikelihoodAnswer


@dataclass(frozen=True)
class FalsifiedAnswer:
    """The worst draw found, and the failure found nearest to the median draw.

    ``within`` is the distance from the median draw within which the search stayed; None: it searched the whole
    support. ``nearest_failure`` is None if no draw failed. In JSON the fields of ``worst`` are merged into this object.
    """

    within: LikelihoodAnswer | None
    requirements: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    failed: Annotated[bool, Quantity("", "whether the worst draw fails")]
    worst: PointAnswer = field(metadata={MERGED: True})
    units: Annotated[dict[str, str], Quantity("", "unit of each uncertain number")]
    nearest_failure: PointAnswer | None
    worst_seen: Annotated[dict[str, str], Quantity("", "worst value of each requirement, of all complete draws")]
    simulations: Annotated[int, Quantity("1", "simulations spent")]
    stopped: Annotated[str, Quantity("", "why the search stopped before its budget was spent; empty if it spent it")]
    first_failure: Annotated[int | None, Quantity("1", "simulations until the first failure; None if there was none")]
    seconds: Annotated[float, Quantity("s", "computing time")]


def value_text(requirement: Requirement, slack: float) -> str:
    """Format the value of a required metric with its unit, computed from its slack.

    Args:
        requirement: The requirement.
        slack: Signed distance of the metric from the bound, in the metric's unit.
    """
    value = requirement.bound + slack
    if requirement.maximum is not None:
        value = requirement.bound - slack
    if np.isnan(value):
        return "no number"
    number, unit = requirement.shown(value)
    return f"{number:.4g}" if unit == "1" else f"{number:.4g} {unit}"


def likelihood_answer(likelihood: Likelihood) -> LikelihoodAnswer:
    """Convert a likelihood to an answer: distance from the median draw, log density, and probability within."""
    return LikelihoodAnswer(likelihood.distance, likelihood.log_density, likelihood.mass)
