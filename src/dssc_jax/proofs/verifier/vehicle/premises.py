"""Names of the vehicle's premises for what the verifier of a single axis rejects, whose parts the vehicle's uses."""

from dssc_jax.proofs.verifier.balls import Rejected


def with_premise(rejected: Rejected, premise: str, place: str = "") -> Rejected:
    """The same rejection under the name of another premise.

    Args:
        rejected: The rejection, whose message is a premise's name, a colon and the reason.
        premise: Name of the premise, such as ``V0``.
        place: Words for the place, which are added at the end.
    """
    _, reason = str(rejected).split(":", maxsplit=1)
    return Rejected(f"{premise}:{reason}{place}")
