"""Sample-size planning: the number of draws or flights that answers a question."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from dssc_jax.statistics.conformal import TAIL_SHARE, flights_to_confirm, flights_to_refute, least_flights
from dssc_jax.statistics.order import first_integer, wilks_draws
from dssc_jax.statistics.proportions import CONFIDENCE, clopper_pearson, require_share

LINE_DRAWS = 999  # draws of the study with which flights are compared
DEPARTING = 0.5  # share of flights beyond the line, for the plan of a verdict
ORDERS = {1: (1, 2, 3, 4, 5), 2: (1, 2, 3)}  # Wilks orders in a plan, by number of sides
NEGLIGIBLE = 1e-9  # total probability of the counts that a sum leaves out


class Answer(NamedTuple):
    """A row of a plan: the number of draws that answers a question.

    Args:
        question: Question, in words.
        draws: Number of draws, or of flights, that answers it.
        statement: Statement that holds after so many draws.
    """

    question: str
    draws: int
    statement: str


def chernoff_draws(error: float, confidence: float = CONFIDENCE) -> int:
    """Number of draws whose share of failures is within an error of the failure probability, for any such probability.

    With the error e and the confidence 1 - d, it is the least n >= ln(2/d)/(2 e^2).

    Args:
        error: Largest distance of the share from the failure probability, in (0, 1).
        confidence: Probability that the distance is at most the error, in (0, 1).

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
    """Number of draws whose worst value a further draw exceeds with a probability of at most ``error``.

    With the error e and the confidence 1 - d, it is the least n >= ln(1/d)/ln(1/(1-e)). If none of these draws fails,
    they also demonstrate a failure probability of at most e.

    Args:
        error: Largest probability that a further draw is worse, in (0, 1).
        confidence: Confidence of this statement, in (0, 1).

    Example:
        >>> worst_case_draws(0.01, 0.99)
        459

    Reference:
        R. Tempo, E. W. Bai, F. Dabbene, Systems and Control Letters 30 (1997) 237-242.
    """
    require_share(error=error, confidence=confidence)
    return math.ceil(math.log(1.0 - confidence) / math.log1p(-error))


def half_length(failures: ArrayLike, draws: ArrayLike, confidence: float = CONFIDENCE) -> np.ndarray:
    """Distance of the farther end of the exact interval from the share of failures, any shape.

    Args:
        failures: Number of failures, any shape.
        draws: Number of draws, broadcastable.
        confidence: Confidence of the interval.
    """
    share = np.asarray(failures) / np.asarray(draws)
    distances = np.abs(clopper_pearson(failures, draws, confidence) - share[..., None])
    return distances.max(-1)


def reach_probability(draws: int, error: float, probability: float, confidence: float = CONFIDENCE) -> float:
    """Probability that both ends of the exact interval lie within an error of the share of failures.

    Args:
        draws: Number of draws.
        error: Largest half-length of the interval.
        probability: True failure probability.
        confidence: Confidence of the interval.
    """
    smallest, largest = stats.binom.interval(1.0 - NEGLIGIBLE, draws, probability)
    failures = np.arange(smallest, largest + 1)
    is_short = half_length(failures, draws, confidence) <= error
    return float(stats.binom.pmf(failures, draws, probability)[is_short].sum())


def expected_draws(error: float, probability: float, confidence: float = CONFIDENCE) -> int:
    """Number of draws after which the exact interval reaches at most ``error``, if failures come as expected.

    The expected number of failures, probability times draws, need not be an integer here. In about half of all cases
    there are more failures and the interval reaches further; :func:`assured_draws` accounts for these.

    Args:
        error: Largest half-length of the interval, in (0, 1).
        probability: Expected failure probability, in (0, 1).
        confidence: Confidence of the interval, in (0, 1).

    Raises:
        ValueError: An argument is out of range.

    Example:
        >>> expected_draws(0.01, 0.05)
        2181
    """
    require_share(error=error, probability=probability, confidence=confidence)
    return first_integer(lambda draws: bool(half_length(probability * draws, draws, confidence) <= error))


def assured_draws(error: float, probability: float, confidence: float = CONFIDENCE) -> int:
    """Number of draws after which the exact interval reaches at most ``error`` with the probability ``confidence``.

    Let n_k be the least number of draws with which the interval is short enough at every number of failures up to k.
    From n_k to n_(k+1) - 1 draws, the probability of at most k failures falls. At n_(k+1) draws a further failure is
    allowed, so the probability jumps up. Over the draws, it is a sawtooth. The answer is the first n_k after which
    every tooth ends high enough. Some smaller numbers may also suffice.

    Args:
        error: Largest half-length of the interval, in (0, 1).
        probability: Expected failure probability, in (0, 1).
        confidence: Confidence of the interval, and probability that it is short enough, in (0, 1).

    Raises:
        ValueError: An argument is out of range.

    Example:
        >>> assured_draws(0.01, 0.05)
        2435
    """
    require_share(error=error, probability=probability, confidence=confidence)

    def draws_for(failures: int) -> int:
        """The number n_k of draws for k = ``failures``."""

        def is_short(draws: int) -> bool:
            """Whether the interval is short enough at every number of failures up to k."""
            margin = 4 * math.isqrt(draws) if 3 * failures > draws else 0  # near 1/2, fewer failures may be the worst
            counts = np.arange(max(failures - margin, 0), failures + 1)
            return bool(half_length(counts, draws, confidence).max() <= error)

        return first_integer(is_short, max(2 * failures, 1))

    def ends_high(failures: int) -> bool:
        """Whether the probability at the end of the tooth of n_k, its lowest point, is at least ``confidence``."""
        draws = draws_for(failures + 1) - 1
        return reach_probability(draws, error, rarer, confidence) >= confidence

    rarer = min(probability, 1.0 - probability)  # failures and passes have the same intervals
    return draws_for(first_integer(ends_high, 0))


def plan(error: float, confidence: float = CONFIDENCE, probability: float | None = None) -> list[Answer]:
    """Numbers of draws or flights that answer each of several types of questions.

    Args:
        error: Accuracy of a probability, or share of the law that may lie beyond a limit; in (0, 1).
        confidence: Confidence of each answer, in (0, 1).
        probability: Expected failure probability; None omits the questions that need it.

    Raises:
        ValueError: An argument is out of range.
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
    return [*answers, *tolerance_answers(error, confidence), *flight_answers(error, confidence)]


def tolerance_answers(error: float, confidence: float) -> list[Answer]:
    """Number of draws of which one or two extremes are tolerance limits, for several orders.

    Args:
        error: Share of the law that may lie beyond the limits, in (0, 1).
        confidence: Confidence of the limits, in (0, 1).
    """
    answers = []
    for sides, orders in ORDERS.items():
        for order in orders:
            extreme = {1: "largest", 2: "second largest", 3: "third largest"}.get(order, f"{order}-th largest")
            if sides == 1:
                limits = "tolerance limit"
                values_leave = f"the {extreme} value leaves"
            else:
                limits = "tolerance limits, two-sided"
                values_leave = f"the {extreme} and smallest values leave"
            answers.append(
                Answer(
                    f"{limits}, order {order} (Wilks)",
                    wilks_draws(1.0 - error, confidence, order, sides),
                    f"{values_leave} at most {error:g} of the law outside with confidence {confidence:g}",
                )
            )
    return answers


def flight_answers(error: float, confidence: float) -> list[Answer]:
    """Number of flights for a set that contains the next flight, and for a verdict of flights on the study.

    Args:
        error: Probability that the next flight leaves the set, in (0, 1).
        confidence: Confidence of the verdict, and probability that the flights reach it, in (0, 1).
    """
    sure = f"in {100 * confidence:g} % of all cases"
    line = f"{100 * TAIL_SHARE:g} % of {LINE_DRAWS} draws"
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
