"""What proofs claim, in words for figures, reports and consoles: what they cover, and which error they bound."""

from collections.abc import Mapping
from typing import NamedTuple

from dssc_jax.study import Study


class Claim(NamedTuple):
    """What the proofs of one kind of loop claim, in words.

    Args:
        covered: All that a proof holds for.
        error: The error that a proof bounds.
    """

    covered: str
    error: str


AXIS_CLAIM = Claim("every plant of the laws", "|e|")
VEHICLE_CLAIM = Claim("every wind and vehicle within the bounds", "|e| along x and y")
VEHICLE_BOUNDS = "bounds"
"""Name of an entry that the summary of a vehicle's proof has, and that of an axis has not."""


def claim_of_proof(summary: Mapping[str, object]) -> Claim:
    """What a proof claims, in words, from its summary."""
    return VEHICLE_CLAIM if VEHICLE_BOUNDS in summary else AXIS_CLAIM


def claim_of_study(study: Study) -> Claim:
    """What the proofs of a study claim, in words; of loops with several channels only the vehicle can be proved."""
    return VEHICLE_CLAIM if len(study.units) > 1 else AXIS_CLAIM


def not_proved_text(study: Study) -> str:
    """A note that names the requirements that are formulas, of which no proof speaks; empty if there are none."""
    labels = [requirement.label for requirement in study.requirements if requirement.formula]
    return f"proofs neither use nor prove formulas: {', '.join(labels)}" if labels else ""
