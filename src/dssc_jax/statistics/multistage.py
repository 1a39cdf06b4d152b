"""Exact intervals of a failure probability after a multistage test.

Failures are counted at looks, after n_1 < n_2 < ... draws. The test stops at the first look with at most `lower` or at
least `upper` failures. These two boundaries are fixed in advance for every look. So the law of the stop is known for
every failure probability p, and its inversion gives an exact interval.

Stops are ordered from few failures to many. First come the stops at the lower boundary in the order of their looks,
then the stops at the upper boundary in the reverse order; stops at the same look are ordered by the number of failures.
If fewer draws fail, a test stops no later in this order. So the probability of stopping at or before a stop falls with
p, and both limits are unique.

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
NEGLIGIBLE = 1e-22  # probability of a count that is left out
RESOLUTION = 1e-9  # relative error of a limit
BRACKET = 0.05  # half-width of the first bracket around the single-look limit, in standard deviations


class Look(NamedTuple):
    """A look of a multistage test: a number of draws at which failures are counted, and its boundaries.

    Args:
        draws: Number of draws n at which failures are counted.
        lower: The test stops with at most this number of failures; -1: there is no lower boundary.
        upper: The test stops with at least this number of failures; n + 1: there is no upper boundary.
    """

    draws: int
    lower: int
    upper: int


class Counts(NamedTuple):
    """Law of a number of failures: the probabilities of consecutive numbers.

    The probabilities add up to less than 1 if some tests have stopped already, or if negligible ones are left out.

    Args:
        first: Smallest number of failures.
        probabilities: Probability of ``first``, ``first`` + 1, ... failures, shape (numbers,).
    """

    first: int
    probabilities: np.ndarray

    def part(self, low: int, high: int) -> "Counts":
        """The probabilities of ``low`` to ``high`` failures, both included."""
        start = max(low - self.first, 0)
        end = max(high + 1 - self.first, start)
        return Counts(self.first + start, self.probabilities[start:end])

    @property
    def total(self) -> float:
        """Sum of the probabilities."""
        return float(self.probabilities.sum())

    def plus(self, independent: "Counts") -> "Counts":
        """Law of the sum with an independent number of failures, without negligible ends."""
        probabilities = signal.convolve(self.probabilities, independent.probabilities)
        first = self.first + independent.first
        notable = np.flatnonzero(probabilities > NEGLIGIBLE)
        if not notable.size:
            return Counts(first, np.empty(0))
        start = int(notable[0])
        end = int(notable[-1]) + 1
        return Counts(first + start, probabilities[start:end])


def binomial(draws: int, probability: float) -> Counts:
    """Law of the failures in a number of draws: binomial, cut at :data:`REACH` standard deviations from the mean.

    Args:
        draws: Number of draws.
        probability: Failure probability of a draw.
    """
    mean = draws * probability
    half = REACH * math.sqrt(mean * (1.0 - probability)) + 2.0 * REACH  # the last term matters if the mean is small
    first = max(math.floor(mean - half), 0)
    largest = min(math.ceil(mean + half), draws)
    return Counts(first, stats.binom.pmf(np.arange(first, largest + 1), draws, probability))


def stops_by(looks: Sequence[Look], failures: int, probability: float) -> float:
    """Probability that the test stops at or before a given stop, in the order of stops from few failures to many.

    The given stop is at the last look, below its upper boundary. In the order it follows the stops at the lower
    boundary of all earlier looks. Stops at the last look come in the order of their failures, up to ``failures``.

    Args:
        looks: All looks up to and including the look of the stop.
        failures: Number of failures at the stop.
        probability: Failure probability of a draw, in (0, 1).
    """
    stopped = 0.0
    running = Counts(0, np.ones(1))  # failures of tests that go on; none before the first draw
    draws = 0
    for look in looks[:-1]:
        running = running.plus(binomial(look.draws - draws, probability))
        draws = look.draws
        stopped += running.part(0, look.lower).total
        running = running.part(look.lower + 1, look.upper - 1)
        if not running.probabilities.size:
            return stopped
    running = running.plus(binomial(looks[-1].draws - draws, probability))
    return stopped + running.part(0, failures).total


def multistage_interval(looks: Sequence[Look], failures: int, confidence: float) -> tuple[float, float]:
    """Exact interval of the failure probability after a multistage test.

    Args:
        looks: All looks up to the look at which the test stopped.
        failures: Number of failures at the last look.
        confidence: Coverage, in (0, 1).

    Returns:
        Lower and upper limit; with a single look the Clopper-Pearson interval.
    """
    tail = 0.5 * (1.0 - confidence)
    return lower_limit(looks, failures, tail), upper_limit(looks, failures, tail)


def upper_limit(looks: Sequence[Look], failures: int, tail: float) -> float:
    """Failure probability above which a stop at or before the observed stop is less probable than ``tail``.

    Stops are in the order of :func:`stops_by`.

    Args:
        looks: All looks up to the observed stop.
        failures: Number of failures at the last look.
        tail: Probability, half the error of the interval.
    """
    draws = looks[-1].draws
    if stopped_high(looks, failures):  # counted in passes, the stop is at the lower boundary
        return 1.0 - lower_limit(mirror(looks), draws - failures, tail)
    if failures == draws:
        return 1.0
    single_look_limit = float(special.betaincinv(failures + 1, draws - failures, 1.0 - tail))
    return zero_near(lambda p: stops_by(looks, failures, p) - tail, single_look_limit, draws)


def lower_limit(looks: Sequence[Look], failures: int, tail: float) -> float:
    """Failure probability below which a stop at or after the observed stop is less probable than ``tail``.

    Stops are in the order of :func:`stops_by`.

    Args:
        looks: All looks up to the observed stop.
        failures: Number of failures at the last look.
        tail: Probability, half the error of the interval.
    """
    draws = looks[-1].draws
    if stopped_high(looks, failures):  # counted in passes, the stop is at the lower boundary
        return 1.0 - upper_limit(mirror(looks), draws - failures, tail)
    if failures == 0:
        return 0.0
    single_look_limit = float(special.betaincinv(failures, draws - failures + 1, tail))
    return zero_near(lambda p: stops_by(looks, failures - 1, p) - (1.0 - tail), single_look_limit, draws)


def stopped_high(looks: Sequence[Look], failures: int) -> bool:
    """Whether the test stopped at the upper boundary of its last look.

    Where the boundaries meet, a number of failures on both counts as a stop at the lower boundary.
    """
    final = looks[-1]
    return failures >= final.upper and failures > final.lower


def mirror(looks: Sequence[Look]) -> list[Look]:
    """The looks of the same test if passes are counted instead of failures: the two boundaries change places."""
    return [Look(look.draws, lower=look.draws - look.upper, upper=look.draws - look.lower) for look in looks]


def zero_near(function: Callable[[float], float], probability: float, draws: int) -> float:
    """Zero of a falling function of a probability, from a bracket that grows around a first guess.

    Args:
        function: Function of a probability, positive at 0 and negative at 1.
        probability: First guess: the limit of a test with a single look.
        draws: Number of draws, which sets the width of the first bracket.
    """
    deviation = math.sqrt(probability * (1.0 - probability) / draws)
    smallest = RESOLUTION / draws  # the bracket stays that far from 0 and 1
    step = BRACKET * deviation
    while probability - step > smallest and function(probability - step) <= 0.0:
        step *= 4.0
    low = max(probability - step, smallest)
    step = BRACKET * deviation
    while probability + step < 1.0 - smallest and function(probability + step) >= 0.0:
        step *= 4.0
    high = min(probability + step, 1.0 - smallest)
    return optimize.root_scalar(function, bracket=(low, high), rtol=RESOLUTION, xtol=RESOLUTION * probability).root
