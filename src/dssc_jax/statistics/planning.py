"""Sample-size planning: the number of draws that a question needs."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from dssc_jax.statistics.conformal import BEYOND, flights_to_confirm, flights_to_refute, least_flights
from dssc_jax.statistics.order import first, wilks_draws
from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson, require_share

LINE_DRAWS = 999  # of a study that flights are compared with
DEPARTING = 0.5  # share of the flights that depart far
ORDERS = {1: (1, 2, 3, 4, 5), 2: (1, 2, 3)}  # Wilks orders worth naming, by number of sides
NEGLIGIBLE = 1e-9  # probability of the counts that a sum leaves out


class Answer(NamedTuple):
    """A number of draws, the question it answers, and the statement that it permits."""

    question: str
    draws: int
    statement: str


def chernoff_draws(error: float, confidence: float = CONFIDENCE) -> int:
    """Draws after which a share is within ``error`` of any probability: n >= ln(2/d)/(2 e^2).

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
    """Number of draws whose worst value is exceeded with probability at most ``error``: n >= ln(1/d)/ln(1/(1-e)).

    If none of these draws fails, they demonstrate a failure probability of at most ``error``.

    Example:
        >>> worst_case_draws(0.01, 0.99)
        459

    Reference:
        R. Tempo, E. W. Bai, F. Dabbene, Systems and Control Letters 30 (1997) 237-242.
    """
    require_share(error=error, confidence=confidence)
    return math.ceil(math.log(1.0 - confidence) / math.log1p(-error))


def half_length(failures: ArrayLike, draws: ArrayLike, confidence: float = CONFIDENCE) -> np.ndarray:
    """Distance of the exact interval's farther end from the share of failures; shape of the arguments."""
    share = np.asarray(failures) / np.asarray(draws)
    return np.abs(clopper_pearson(failures, draws, confidence) - share[..., None]).max(-1)


def reach_probability(draws: int, error: float, probability: float, confidence: float = CONFIDENCE) -> float:
    """Probability that both ends of the exact interval lie within ``error`` of the share of failures (binomial sum)."""
    from scipy import stats

    smallest, largest = stats.binom.interval(1.0 - NEGLIGIBLE, draws, probability)
    failures = np.arange(smallest, largest + 1)
    return float(stats.binom.pmf(failures, draws, probability)[half_length(failures, draws, confidence) <= error].sum())


def expected_draws(error: float, probability: float, confidence: float = CONFIDENCE) -> int:
    """Draws after which the exact interval reaches at most ``error``, for the expected number of failures.

    The expected number, probability times draws, need not be an integer here. In about half of all cases there are
    more failures and the interval reaches further; :func:`assured_draws` accounts for them.

    Raises:
        ValueError: an argument is out of range.

    Example:
        >>> expected_draws(0.01, 0.05)
        2181
    """
    require_share(error=error, probability=probability, confidence=confidence)
    return first(lambda draws: bool(half_length(probability * draws, draws, confidence) <= error))


def assured_draws(error: float, probability: float, confidence: float = CONFIDENCE) -> int:
    """Number of draws after which the exact interval reaches at most ``error`` with probability ``confidence``.

    With n_k draws, and not with fewer, the interval is short enough at every number of failures up to k. From n_k to
    n_(k+1) - 1 draws the probability of such a number falls, and at n_(k+1) it jumps up, like a sawtooth. The answer
    is the first n_k after which every tooth ends high enough. (Some smaller numbers of draws may also suffice.)

    Args:
        error: In (0, 1).
        probability: The expected failure probability, in (0, 1).
        confidence: Confidence of the interval and of its reach, in (0, 1).

    Raises:
        ValueError: an argument is out of range.

    Example:
        >>> assured_draws(0.01, 0.05)
        2435
    """
    require_share(error=error, probability=probability, confidence=confidence)

    def tooth(failures: int) -> int:
        """Return n_k; near one half the longest interval is that of slightly fewer failures."""

        def short(draws: int) -> bool:
            margin = 4 * math.isqrt(draws) if 3 * failures > draws else 0
            counts = np.arange(max(failures - margin, 0), failures + 1)
            return bool(half_length(counts, draws, confidence).max() <= error)

        return first(short, max(2 * failures, 1))

    rarer = min(probability, 1.0 - probability)
    return tooth(first(lambda k: reach_probability(tooth(k + 1) - 1, error, rarer, confidence) >= confidence, 0))


def plan(error: float, confidence: float = CONFIDENCE, probability: float | None = None) -> list[Answer]:
    """Number of draws for each type of question.

    Args:
        error: e: the accuracy of a probability, or the share of the law that may lie beyond a limit; in (0, 1).
        confidence: In (0, 1).
        probability: The expected failure probability; None: omit these questions.

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
        question = f"failure probability, expected at {probability:g} (Clopper-Pearson)"
        draws = expected_draws(error, probability, confidence)
        success_share = reach_probability(draws, error, probability, confidence)
        interval = f"the {100 * confidence:g} % interval reaches at most {error:g} to either side"
        answers += [
            Answer(
                f"{question}, at the expected count",
                draws,
                f"{interval} if failures come at their expected number: in {100 * success_share:.0f} % of all cases",
            ),
            Answer(
                f"{question}, assured",
                assured_draws(error, probability, confidence),
                f"{interval} in {100 * confidence:g} % of all cases or more; so it does after any more draws",
            ),
        ]
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
    return [*answers, *flight_answers(error, confidence)]


def flight_answers(error: float, confidence: float) -> list[Answer]:
    """Number of flights for a set in which the next one lies, and for a verdict on the study.

    Args:
        error: Probability that the next flight leaves the set.
        confidence: Confidence of the verdict, and probability that it is reached.
    """
    sure = f"in {100 * confidence:g} % of all cases"
    line = f"{100 * BEYOND:g} % of {LINE_DRAWS} draws"
    answers = [
        Answer(
            "flights for a set of the next one (conformal)",
            least_flights(1.0 - error),
            f"the next flight is beyond the largest of so many with probability <= {error:g}, whatever its law",
        )
    ]
    refute = flights_to_refute(DEPARTING, LINE_DRAWS, confidence)
    confirm = flights_to_confirm(DEPARTING, LINE_DRAWS, confidence)
    share = f"{100 * DEPARTING:g} % of the flights"
    if refute is not None:
        statement = f"if {share} depart farther than all but {line}, that refutes the study {sure}"
        answers.append(Answer("flights that refute a study", refute, statement))
    if confirm is not None:
        statement = (
            f"if the study is right, they show {sure} that fewer than {share} depart farther than all but {line}"
        )
        answers.append(Answer("flights that confirm a study", confirm, statement))
    return answers
