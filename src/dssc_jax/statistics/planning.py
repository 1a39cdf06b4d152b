"""How many draws a question needs, before any is simulated."""

import math
from typing import NamedTuple

from dssc_jax.statistics.order import wilks_draws
from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson, require_share

ORDERS = {1: (1, 2, 3, 4, 5), 2: (1, 2, 3)}  # Wilks orders worth naming, by number of sides


class Answer(NamedTuple):
    """A number of draws, the question that it answers, and the statement that one may make after them."""

    question: str
    draws: int
    statement: str


def chernoff_draws(error: float, confidence: float = CONFIDENCE) -> int:
    """Draws after which a share is within ``error`` of its probability, whatever that is: n >= ln(2/d)/(2 e^2).

    Example:
        >>> chernoff_draws(0.01, 0.99)
        26492

    Reference:
        R. Tempo, G. Calafiore, F. Dabbene, Randomized Algorithms for Analysis and Control of Uncertain Systems,
        2nd ed. (2013), section 8.3; the bound is Hoeffding's.
    """
    require_share(error=error, confidence=confidence)
    return math.ceil(math.log(2.0 / (1.0 - confidence)) / (2.0 * error**2))


def worst_case_draws(error: float, confidence: float = CONFIDENCE) -> int:
    """Draws whose worst one is exceeded with probability at most ``error``: n >= ln(1/d)/ln(1/(1-e)).

    The same number of draws without a failure demonstrates a failure probability of at most ``error``.

    Example:
        >>> worst_case_draws(0.01, 0.99)
        459

    Reference:
        R. Tempo, E. W. Bai, F. Dabbene, Systems and Control Letters 30 (1997) 237-242.
    """
    require_share(error=error, confidence=confidence)
    return math.ceil(math.log(1.0 - confidence) / math.log1p(-error))


def clopper_pearson_draws(error: float, probability: float, confidence: float = CONFIDENCE) -> int:
    """Draws after which the exact interval reaches at most ``error`` to either side of an expected probability.

    The count of failures is taken at its expectation, rounded up.

    Example:
        >>> clopper_pearson_draws(0.01, 0.05)
        2189
    """
    require_share(error=error, probability=probability, confidence=confidence)

    def reach(draws: int) -> float:
        share = math.ceil(probability * draws) / draws
        low, high = clopper_pearson(math.ceil(probability * draws), draws, confidence)
        return max(high - share, share - low)

    enough = 1
    while reach(enough) > error:
        enough *= 2
    short = enough // 2
    while enough - short > 1:
        middle = (short + enough) // 2
        short, enough = (middle, enough) if reach(middle) > error else (short, middle)
    return enough


def plan(error: float, confidence: float = CONFIDENCE, probability: float | None = None) -> list[Answer]:
    """How many draws, for each question that one may have.

    Args:
        error: e: the accuracy of a probability, or the share of the law that may lie beyond a limit; in (0, 1).
        confidence: In (0, 1).
        probability: The failure probability that one expects; None: no such question.

    Raises:
        ValueError: an argument is out of range.
    """
    sure = f"with confidence {confidence:g}"
    answers = [
        Answer(
            "failure probability, whatever it is (Chernoff)",
            chernoff_draws(error, confidence),
            f"the share of failed draws is within {error:g} of the probability {sure}",
        ),
        Answer(
            "worst case over draws, or no failure at all",
            worst_case_draws(error, confidence),
            f"the worst draw is exceeded, or a failure seen, with probability <= {error:g} {sure}",
        ),
    ]
    if probability is not None:
        answers.append(
            Answer(
                f"failure probability, expected at {probability:g} (Clopper-Pearson)",
                clopper_pearson_draws(error, probability, confidence),
                f"the exact interval reaches at most {error:g} to either side {sure}",
            )
        )
    for sides, orders in ORDERS.items():
        for order in orders:
            extreme = {1: "largest", 2: "second largest", 3: "third largest"}.get(order, f"{order}-th largest")
            limit = f"the {extreme} value" if sides == 1 else f"the {extreme} and smallest values"
            answers.append(
                Answer(
                    f"tolerance limit{'s, two-sided' if sides == 2 else ''}, order {order} (Wilks)",
                    wilks_draws(1.0 - error, confidence, order, sides),
                    f"{limit} leave{'s' if sides == 1 else ''} at most {error:g} of the law outside {sure}",
                )
            )
    return answers
