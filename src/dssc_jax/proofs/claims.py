"""The claim of a proof in words, for figures, reports and consoles: what it covers, and which error it bounds."""

from collections.abc import Mapping
from typing import NamedTuple

from dssc_jax.study import Study


class Claim(NamedTuple):
    """The words for the proofs of a kind of loop.

    Args:
        covered: What a proof is for.
        error: The error of which a proof gives the bound.
    """

    covered: str
    error: str


AXIS_CLAIM = Claim("every plant of the laws", "|e|")
VEHICLE_CLAIM = Claim("every wind and vehicle within the bounds", "|e| along x and y")
VEHICLE_BOUNDS = "bounds"
"""Entry that only the summary of a vehicle's proof has."""


def claim_of_proof(summary: Mapping[str, object]) -> Claim:
    """The words for a proof, from its summary."""
    return VEHICLE_CLAIM if VEHICLE_BOUNDS in summary else AXIS_CLAIM


def claim_of_study(study: Study) -> Claim:
    """The words for the proofs of a study: of loops with several channels they cover the vehicle only."""
    return VEHICLE_CLAIM if len(study.units) > 1 else AXIS_CLAIM


def not_proved_text(study: Study) -> str:
    """The requirements of which no proof speaks, since they are formulas; empty if there are none."""
    labels = [requirement.label for requirement in study.requirements if requirement.formula]
    return f"proofs neither use nor prove formulas: {', '.join(labels)}" if labels else ""
