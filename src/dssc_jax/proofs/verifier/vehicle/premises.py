"""The names of the vehicle's premises, in place of those of the theorem on one axis, whose parts it uses."""

from dssc_jax.proofs.verifier.balls import Rejected


def with_premise(rejected: Rejected, premise: str, place: str = "") -> Rejected:
    """The same rejection with the name of another premise, and the words for its place at the end."""
    reason = str(rejected)
    return Rejected(f"{premise}:{reason[reason.index(':') + 1 :]}{place}")
