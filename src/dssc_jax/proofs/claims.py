"""What a proof claims, in words for figures, reports and consoles: what it covers, and which error it bounds."""

from collections.abc import Mapping
from typing import NamedTuple

from dssc_jax.study import Study


class Claim(NamedTuple):
    """What the proofs of one kind of loop claim, in words.

    Args:
        covered: The plants, or the winds and vehicles, for all of which a proof holds.
        error: Symbol of the error that a proof bounds.
    """

    covered: str
    error: str


AXIS_CLAIM = Claim("every plant of the laws", "|e|")
VEHICLE_CLAIM = Claim("every wind and vehicle within the bounds", "|e| along x and y")
VEHICLE_BOUNDS = "bounds"
"""Name of an entry that only the summary of a vehicle's proof has; the summary of a loop (5)-(8) lacks it."""


def claim_of_proof(summary: Mapping[str, object]) -> Claim:
    """Return the claim of a proof from its summary, a table in JSON's types."""
    return VEHICLE_CLAIM if VEHICLE_BOUNDS in summary else AXIS_CLAIM


def claim_of_study(study: Study) -> Claim:
    """Return what a proof of a study would claim.

    A study with several channels counts as a vehicle, since no other loop with several channels can be proved.
    """
    return VEHICLE_CLAIM if len(study.units) > 1 else AXIS_CLAIM


def not_proved_text(study: Study) -> str:
    """A note that lists the study's requirements that are formulas; empty if there are none.

    A proof bounds |e| only. It neither assumes nor proves a formula.
    """
    labels = [requirement.label for requirement in study.requirements if requirement.formula]
    return f"proofs neither use nor prove formulas: {', '.join(labels)}" if labels else ""
