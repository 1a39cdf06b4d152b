"""Rename the premise in a rejection: the vehicle's verifier uses functions of the verifier of loops (5)-(8)."""

from dssc_jax.proofs.verifier.balls import Rejected


def with_premise(rejected: Rejected, premise: str, place: str = "") -> Rejected:
    """Return a rejection with the same reason under the name of another premise.

    Args:
        rejected: The rejection, whose message is the name of a premise, a colon and the reason.
        premise: The new name of the premise, such as ``V0``.
        place: Words for the place, which are added at the message's end.
    """
    _, reason = str(rejected).split(":", maxsplit=1)
    return Rejected(f"{premise}:{reason}{place}")
