"""Exact intervals of a failure probability after a multistage test.

Failures are counted at looks, after n_1 < n_2 < ... draws. The test stops at the first look with at most `lower` or at
least `upper` failures. These two boundaries are fixed in advance for every look, so the law of a stop is known for
every failure probability p, and its inversion gives an exact interval.

Stops are ordered from few failures to many: first the stops at the lower boundary in the order of their looks, then
those at the upper boundary in the reverse order; at one look by the number of failures. If fewer draws fail, a path
stops no later in this order. So the probability of stopping at or before a given stop falls with p, and both limits are
unique.

Reference:
    C. Jennison, B. W. Turnbull, "Confidence intervals for a binomial parameter following a multistage test with
    application to MIL-STD 105D and medical trials", Technometrics 25 (1983) 49-58.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy import optimize, signal, special, stats

REACH = 10.0  # standard deviations of a count beyond which its probability is below 1e-20
NEGLIGIBLE = 1e-22  # probability of a count
RESOLUTION = 1e-9  # relative error of a limit
BRACKET = 0.05  # standard deviations on either side of the limit of a test with a single look, at first


class Look(NamedTuple):
    """A number of draws, and the boundaries at which the test stops there.

    Args:
        draws: n.
        lower: The test stops with at most this number of failures; -1: it does not stop below.
        upper: The test stops with at least this number of failures; n + 1: it does not stop above.
    """

    draws: int
    lower: int
    upper: int


class Counts(NamedTuple):
    """Probabilities of consecutive numbers of failures.

    Args:
        first: The smallest number.
        probabilities: Shape (numbers,).
    """

    first: int
    probabilities: np.ndarray

    def between(self, low: int, high: int) -> "Counts":
        """The part from ``low`` to ``high``, both included."""
        start = max(low - self.first, 0)
        end = max(high + 1 - self.first, start)
        return Counts(self.first + start, self.probabilities[start:end])

    @property
    def total(self) -> float:
        """The sum of the probabilities."""
        return float(self.probabilities.sum())

    def plus(self, independent: "Counts") -> "Counts":
        """The law of the sum with an independent number, without negligible ends."""
        probabilities = signal.convolve(self.probabilities, independent.probabilities)
        (notable,) = np.nonzero(probabilities > NEGLIGIBLE)
        first = self.first + independent.first
        if not notable.size:
            return Counts(first, probabilities[:0])
        return Counts(first + int(notable[0]), probabilities[notable[0] : notable[-1] + 1])


def binomial(draws: int, probability: float) -> Counts:
    """The law of the failures in a number of draws, without negligible ends."""
    middle = draws * probability
    half = REACH * math.sqrt(middle * (1.0 - probability)) + 2.0 * REACH
    first = max(math.floor(middle - half), 0)
    largest = min(math.ceil(middle + half), draws)
    return Counts(first, stats.binom.pmf(np.arange(first, largest + 1), draws, probability))


def stops_by(looks: Sequence[Look], failures: int, probability: float) -> float:
    """Probability of a stop at the lower boundary before the last look, or at the last look with at most ``failures``.

    Args:
        looks: All looks up to the last.
        failures: A number of failures at the last look.
        probability: The failure probability of a draw, in (0, 1).
    """
    stopped = 0.0
    running = Counts(0, np.ones(1))
    draws = 0
    for look in looks[:-1]:
        running = running.plus(binomial(look.draws - draws, probability))
        draws = look.draws
        stopped += running.between(0, look.lower).total
        running = running.between(look.lower + 1, look.upper - 1)
        if not running.probabilities.size:
            return stopped
    running = running.plus(binomial(looks[-1].draws - draws, probability))
    return stopped + running.between(0, failures).total


def multistage_interval(looks: Sequence[Look], failures: int, confidence: float) -> tuple[float, float]:
    """Exact interval of the failure probability after a stop.

    Args:
        looks: All looks up to the one at which the test stopped, shape (looks,).
        failures: Number of failures at that look.
        confidence: Coverage, in (0, 1).

    Returns:
        Lower and upper limit. With a single look they are those of Clopper and Pearson.
    """
    tail = 0.5 * (1.0 - confidence)
    return lower_limit(looks, failures, tail), upper_limit(looks, failures, tail)


def upper_limit(looks: Sequence[Look], failures: int, tail: float) -> float:
    """The failure probability above which stops up to this one, in the module's order, are rarer than ``tail``."""
    draws = looks[-1].draws
    if stopped_high(looks, failures):
        return 1.0 - lower_limit(mirrored(looks), draws - failures, tail)
    if failures == draws:
        return 1.0
    single_look_limit = float(special.betaincinv(failures + 1, draws - failures, 1.0 - tail))
    return zero_near(lambda p: stops_by(looks, failures, p) - tail, single_look_limit, draws)


def lower_limit(looks: Sequence[Look], failures: int, tail: float) -> float:
    """The failure probability below which stops from this one on, in the module's order, are rarer than ``tail``."""
    draws = looks[-1].draws
    if stopped_high(looks, failures):
        return 1.0 - upper_limit(mirrored(looks), draws - failures, tail)
    if failures == 0:
        return 0.0
    single_look_limit = float(special.betaincinv(failures, draws - failures + 1, tail))
    return zero_near(lambda p: stops_by(looks, failures - 1, p) - (1.0 - tail), single_look_limit, draws)


def stopped_high(looks: Sequence[Look], failures: int) -> bool:
    """Whether a stop is at the upper boundary."""
    final = looks[-1]
    return failures >= final.upper and failures > final.lower


def mirrored(looks: Sequence[Look]) -> list[Look]:
    """The looks of the same test that counts successes in place of failures."""
    return [Look(look.draws, look.draws - look.upper, look.draws - look.lower) for look in looks]


def zero_near(function: Callable[[float], float], probability: float, draws: int) -> float:
    """The zero of a falling function of a probability.

    Args:
        function: Positive at 0, negative at 1.
        probability: The limit of a test with a single look, which is near the zero.
        draws: Number of draws, which tells how near.
    """
    deviation = math.sqrt(probability * (1.0 - probability) / draws)
    smallest = RESOLUTION / draws
    step = BRACKET * deviation
    while probability - step > smallest and function(probability - step) <= 0.0:
        step *= 4.0
    low = max(probability - step, smallest)
    step = BRACKET * deviation
    while probability + step < 1.0 - smallest and function(probability + step) >= 0.0:
        step *= 4.0
    high = min(probability + step, 1.0 - smallest)
    return optimize.root_scalar(function, bracket=(low, high), rtol=RESOLUTION, xtol=RESOLUTION * probability).root
