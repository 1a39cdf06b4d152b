"""Intervals of failure probabilities, for each sampling design and stopping rule."""

import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, special

from dssc_jax.statistics.multistage import Look, multistage_interval

CONFIDENCE = 0.95


def require_share(**shares: float) -> None:
    """Refuse a share outside (0, 1).

    Args:
        shares: Shares by name, for the message.

    Raises:
        ValueError: A share lies outside.
    """
    for name, value in shares.items():
        if not 0.0 < value < 1.0:
            raise ValueError(f"{name} must lie in (0, 1), got {value!r}")


def clopper_pearson(failures: ArrayLike, draws: ArrayLike, confidence: float = CONFIDENCE) -> np.ndarray:
    """Exact two-sided interval of a failure probability from independent, identically distributed draws.

    With a = 1 - confidence, the lower bound is the quantile of the beta law (k, n-k+1) at a/2, and the upper bound the
    quantile of the beta law (k+1, n-k) at 1-a/2. Exceptions are the lower bound 0 at k = 0 and the upper bound 1 at
    k = n.

    Args:
        failures: Number k of failures, any shape.
        draws: Number n of draws, >= 1, broadcastable.
        confidence: Coverage, in (0, 1).

    Returns:
        Shape (..., 2): lower and upper bound.

    Raises:
        ValueError: k or n is out of range.

    Example:
        >>> clopper_pearson(10, 100).round(6)
        array([0.049005, 0.176223])

    Reference:
        C. J. Clopper, E. S. Pearson, Biometrika 26 (1934) 404-413.
    """
    k, n = np.broadcast_arrays(np.asarray(failures), np.asarray(draws))
    if np.any(n < 1) or np.any(k < 0) or np.any(k > n):
        raise ValueError(f"needs 0 <= failures <= draws and draws >= 1, got {failures} of {draws}")
    tail = 0.5 * (1.0 - confidence)
    lower = np.where(k > 0, special.betaincinv(np.maximum(k, 1), n - k + 1, tail), 0.0)
    upper = np.where(k < n, special.betaincinv(k + 1, np.maximum(n - k, 1), 1.0 - tail), 1.0)
    return np.stack([lower, upper], axis=-1)


def unseen(draws: ArrayLike, confidence: float = CONFIDENCE) -> np.ndarray:
    """Upper limit ln(2/a)/n of the probability of an event that none of n independent draws has shown.

    Args:
        draws: Number n of draws, any shape.
        confidence: Confidence 1 - a of a two-sided interval, whose upper end this limit is.
    """
    return math.log(2.0 / (1.0 - confidence)) / np.asarray(draws)


class FixedCount(NamedTuple):
    """Confidence intervals of probabilities for independent draws of a number fixed in advance: Clopper-Pearson."""

    @property
    def independent(self) -> bool:
        """Whether the draws are independent."""
        return True

    @property
    def name(self) -> str:
        """Name of the interval in results."""
        return "Clopper-Pearson"

    def confidence_per_look(self, confidence: float) -> float:
        """The confidence itself: draws whose number was fixed in advance have a single look."""
        return confidence

    def interval(self, happened: np.ndarray, confidence: float = CONFIDENCE) -> np.ndarray:
        """Compute the interval of the probability of an event, shape (..., 2).

        Args:
            happened: Whether each draw has the event, shape (..., n).
            confidence: Coverage, in (0, 1).
        """
        return clopper_pearson(np.count_nonzero(happened, axis=-1), happened.shape[-1], confidence)

    def failure_interval(self, failed: np.ndarray, confidence: float = CONFIDENCE) -> np.ndarray:
        """Compute the interval of the failure probability; a failure is an event like any other."""
        return self.interval(failed, confidence)


FIXED = FixedCount()


class IntervalsAfterStop(NamedTuple):
    """Confidence intervals of probabilities when a stopping rule decided the number of independent draws.

    The interval of the failure probability is exact after a multistage test.

    Args:
        looks: Looks up to the look at which the rule stopped.
        possible_stops: Number of looks at which the rule can stop.
    """

    looks: tuple[Look, ...]
    possible_stops: int

    @property
    def independent(self) -> bool:
        """Whether the draws are independent."""
        return True

    @property
    def name(self) -> str:
        """Name of the interval in results."""
        return f"exact interval after a data-driven stop at look {len(self.looks)}"

    def confidence_per_look(self, confidence: float) -> float:
        """Confidence of a statement on anything but failure: the error is divided among all looks."""
        return 1.0 - (1.0 - confidence) / self.possible_stops

    def interval(self, happened: np.ndarray, confidence: float = CONFIDENCE) -> np.ndarray:
        """Compute the interval of the probability of an event, shape (..., 2).

        The rule did not watch this event, so each look could have been the last. The error is divided among all looks.

        Args:
            happened: Whether each draw has the event, shape (..., n).
            confidence: Coverage, in (0, 1).
        """
        return FIXED.interval(happened, self.confidence_per_look(confidence))

    def failure_interval(self, failed: np.ndarray, confidence: float = CONFIDENCE) -> np.ndarray:
        """Compute the interval of the failure probability, which the rule watched, shape (..., 2).

        Args:
            failed: Whether each draw failed, shape (..., n).
            confidence: Coverage, in (0, 1).
        """
        counts = np.count_nonzero(failed, axis=-1)
        intervals = [multistage_interval(self.looks, int(count), confidence) for count in np.ravel(counts)]
        return np.reshape(intervals, (*np.shape(counts), 2))


class Replicated(NamedTuple):
    """Confidence intervals of probabilities for independent replicates of dependent draws: Student's t over replicates.

    Draw i belongs to replicate i mod R.

    Args:
        replicates: Number R of replicates, >= 2.
        design: Name of the design.
    """

    replicates: int
    design: str

    @property
    def independent(self) -> bool:
        """Whether the draws are independent."""
        return False

    @property
    def name(self) -> str:
        """Name of the interval in results."""
        return f"Student's t over {self.replicates} {self.design} replicates"

    def interval(self, happened: np.ndarray, confidence: float = CONFIDENCE) -> np.ndarray:
        """Compute the interval of the probability of an event, shape (..., 2).

        Student's t over the replicates' shares is widened on both sides by :func:`unseen`. Otherwise its width would be
        0 if all replicates agree, for example if no draw fails.

        Args:
            happened: Whether each draw has the event, shape (..., n).
            confidence: Coverage, in (0, 1).
        """
        low, high = np.moveaxis(replicate_interval(happened, self.replicates, confidence), -1, 0)
        widening = unseen(happened.shape[-1], confidence)
        return np.stack([np.maximum(low - widening, 0.0), np.minimum(high + widening, 1.0)], axis=-1)

    def failure_interval(self, failed: np.ndarray, confidence: float = CONFIDENCE) -> np.ndarray:
        """Compute the interval of the failure probability; a failure is an event like any other."""
        return self.interval(failed, confidence)


Method: TypeAlias = FixedCount | IntervalsAfterStop | Replicated
"""Confidence intervals of probabilities for a kind of sampling."""


def replicate_interval(values: np.ndarray, replicates: int, confidence: float = CONFIDENCE) -> np.ndarray:
    """Compute the Student's t interval of a mean, from the means of independent replicates.

    Args:
        values: Values, shape (..., n) with n a multiple of R; value i belongs to replicate i mod R.
        replicates: Number R of replicates, >= 2.
        confidence: Coverage, in (0, 1).

    Returns:
        Shape (..., 2): lower and upper bound.

    Raises:
        ValueError: n is not a multiple of R.
    """
    if replicates < 2 or values.shape[-1] % replicates:
        raise ValueError(f"{values.shape[-1]} values cannot be shared out over {replicates} replicates")
    means = values.reshape(*values.shape[:-1], -1, replicates).mean(-2)
    middle = means.mean(-1)
    spread = means.std(-1, ddof=1)
    half = special.stdtrit(replicates - 1, 0.5 * (1.0 + confidence)) * spread / math.sqrt(replicates)
    return np.stack([middle - half, middle + half], axis=-1)


class DesignEffect(NamedTuple):
    """Gain of a replicated design over independent draws, for the probability of an event.

    Args:
        variance_ratio: Variance of the estimate, divided by the variance from as many independent draws.
        ratio_interval: Interval of ``variance_ratio``, if the replicates' shares are normal.
        plain_draws: Number of independent draws whose exact interval would be as wide.
    """

    variance_ratio: float
    ratio_interval: tuple[float, float]
    plain_draws: int


def draws_as_narrow(share: float, width: float) -> int:
    """Count the independent draws whose exact 95 % interval has a given width, if a given share of them fails.

    Args:
        share: Share of the draws that fail, in (0, 1).
        width: Upper minus lower limit of the interval, in (0, 1).
    """

    def excess_width(log_count: float) -> float:
        """Width of the interval less the wanted width, from the logarithm of the number of draws."""
        count = math.exp(log_count)
        low, high = clopper_pearson(share * count, count)
        return float(high - low) - width

    log_count = optimize.root_scalar(excess_width, bracket=(0.0, math.log(1e15))).root
    return math.ceil(math.exp(log_count))


def design_effect(happened: np.ndarray, replicates: int) -> DesignEffect | None:
    """Estimate the gain of a replicated design over independent draws, from its own draws.

    Args:
        happened: Whether each draw has the event, shape (n,), n a multiple of R; draw i belongs to replicate i mod R.
        replicates: Number R of replicates, >= 2.

    Returns:
        None if all draws have the event, or none has.
    """
    share = float(happened.mean())
    if not 0.0 < share < 1.0:
        return None
    draws = len(happened)
    replicate_shares = happened.reshape(-1, replicates).mean(0)
    variance = float(replicate_shares.var(ddof=1)) / replicates
    ratio = variance * draws / (share * (1.0 - share))
    freedom = replicates - 1
    tail = 0.5 * (1.0 - CONFIDENCE)
    ratio_low, ratio_high = ratio * freedom / special.chdtri(freedom, [tail, 1.0 - tail])
    low, high = Replicated(replicates, design="").interval(happened, CONFIDENCE)  # the name does not matter
    return DesignEffect(
        variance_ratio=ratio,
        ratio_interval=(float(ratio_low), float(ratio_high)),
        plain_draws=draws_as_narrow(share, float(high - low)),
    )


def lognormal_interval(values: np.ndarray, confidence: float = CONFIDENCE) -> tuple[float, float]:
    """Compute the interval of the mean of independent estimates that are 0 or follow a lognormal law.

    If the logarithms have the mean m and the variance s^2, the law has the mean exp(m + s^2/2). Student's t limits of m
    and chi-square limits of s^2/2 are combined: the squares of their distances from the estimates add up. Zeros widen
    the interval: the lower end is multiplied by the lower limit of the share of positive estimates.

    Args:
        values: Independent estimates >= 0, shape (n,).
        confidence: Coverage, in (0, 1).

    Returns:
        Lower and upper end; 0 and infinity with fewer than two estimates above 0.

    Reference:
        G. Y. Zou, C. Y. Huo, J. Taleban, Environmetrics 20 (2009) 172-180, with Student's t for the normal law.
    """
    positive = values[values > 0.0]
    count = len(positive)
    if count < 2:
        return 0.0, math.inf
    logarithms = np.log(positive)
    variance = logarithms.var(ddof=1)
    tail = 0.5 * (1.0 - confidence)
    mean_distance = special.stdtrit(count - 1, 1.0 - tail) * math.sqrt(variance / count)  # of each limit of m
    variance_distances = 0.5 * variance * ((count - 1) / special.chdtri(count - 1, [tail, 1.0 - tail]) - 1.0)
    below, above = np.hypot(mean_distance, variance_distances)
    log_mean = logarithms.mean() + 0.5 * variance
    positive_share = 1.0
    if count < len(values):
        positive_share, _ = clopper_pearson(count, len(values), confidence)
    with np.errstate(over="ignore"):
        return float(positive_share * np.exp(log_mean - below)), float(np.exp(log_mean + above))


def rounded_probability(probability: float) -> str:
    """A probability as text with three digits.

    Near 1, two digits of its complement are given instead, so that a probability below 1 does not read 1.

    Example:
        >>> rounded_probability(0.12345), rounded_probability(0.99996)
        ('0.123', '0.99996')
    """
    short = f"{probability:.3g}"
    if short != "1" or probability >= 1.0:
        return short
    complement = float(f"{1.0 - probability:.2g}")
    return f"{1.0 - complement:.12g}"


def describe_probability(failed: np.ndarray, method: Method = FIXED, confidence: float = CONFIDENCE) -> str:
    """A line on a failure probability and its interval, for reports; no failure in n draws gives a bound, never 0.

    Args:
        failed: Whether each draw failed, shape (n,).
        method: Method of the interval.
        confidence: Coverage of the interval.
    """
    failures = int(np.count_nonzero(failed))
    draws = failed.size
    low, high = method.failure_interval(failed, confidence)
    level = f"{100 * confidence:g} % {method.name}"
    if failures == 0:
        return f"no failure in {draws} draws: failure probability <= {high:.3g} ({level})"
    estimate = rounded_probability(failures / draws)
    ends = f"[{rounded_probability(low)}, {rounded_probability(high)}]"
    return f"{failures} failures in {draws} draws: failure probability {estimate} in {ends} ({level})"
