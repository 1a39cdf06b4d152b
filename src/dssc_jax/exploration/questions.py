"""Questions that a page answers on request, about the study at the sliders' positions: its margins, and its proof."""

from collections.abc import Callable

from dssc_jax.analyses.margins import margin
from dssc_jax.design.certification import NotCovered
from dssc_jax.exploration.live import LiveRun, Stale
from dssc_jax.exploration.sliders import Slider

PROOF_BOXES = 4
Question = Callable[[LiveRun, Callable[..., None]], str]
"""Answers for a run; calls its second argument now and then."""


class Superseded(Exception):
    """The answer is no longer wanted."""


def ending_when(stale: Stale) -> Callable[..., None]:
    """A progress callback that ends a computation when it is stale."""

    def check(*_: object) -> None:
        if stale():
            raise Superseded

    return check


def margins_of(slider: Slider, position: float) -> Question:
    """How far a number may go upwards and downwards before draws fail, within the ends of its slider.

    Args:
        slider: A slider of the number.
        position: Where it stands; the walk begins there, at the median of a law.
    """

    def answer(run: LiveRun, check: Callable[..., None]) -> str:
        answers = []
        for direction, end in (("upwards", slider.high), ("downwards", slider.low)):
            if end != position:
                walked = margin(run.study, over=slider.name, bounds=(position, end), log=slider.log, progress=check)
                answers.append(f"{direction} to {end:.4g}: {walked.headline}")
        return f"margin of {slider.name}, {run.failed.size:,} draws; " + "; ".join(answers)

    return answer


def proof(run: LiveRun, check: Callable[..., None]) -> str:
    """What can be proved of the sampled loop for all plants within the support of the laws."""
    try:
        from dssc_jax.proofs.prove import prove

        proved = prove(run.study, boxes=PROOF_BOXES, progress=check)
    except ImportError as absent:
        return f"a proof needs {absent.name}: pip install 'dssc_jax[proofs]'"
    except NotCovered as outside:
        return f"not proved: {outside}"
    return f"{'proved' if proved.complete else 'not proved for all plants'}: {proved.statement()}"
