"""Kinds of correlated noise, with the prior laws of their parameters.

Each parameter of a noise follows from a standard normal score of its own. In these scores the prior law is standard
normal.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import special

from dssc_jax.statistics.correlated_noise import Drift, FirstOrder, Noise, SecondOrder
from dssc_jax.statistics.simulated_noise import SimulatedNoise

SHARE_WIDTH = 2.0  # prior standard deviation of logit c: one deviation either side is 12 to 88 %
DAMPING_MIDDLE = 1.0  # prior mean of logit zeta
DAMPING_WIDTH = 1.5  # prior standard deviation of logit zeta: 14 to 92 %
TIME_WIDTHS = 6.0  # prior standard deviations of log T from the median gap to the whole span
LARGEST_LOGIT = 13.8  # bound of |logit c|: a share and its complement are at least 1e-6
LONGEST = 1000.0  # longest time constant of the second order in median gaps; longer time constants are lost in rounding
LEAST_DAMPING = 0.02
MOST_DAMPING = 0.98


def sigmoid(x: float) -> float:
    """The share with a given logit; logits beyond +-:data:`LARGEST_LOGIT` count as this limit."""
    return float(special.expit(np.clip(x, -LARGEST_LOGIT, LARGEST_LOGIT)))


def logit(share: float) -> float:
    """Logit ln(c/(1 - c)) of a share c, limited to +-:data:`LARGEST_LOGIT`."""
    return float(np.clip(special.logit(share), -LARGEST_LOGIT, LARGEST_LOGIT))


class TimeScale(NamedTuple):
    """Gap and span of the times of observation, which set the prior law of a time constant.

    Args:
        gap: Median gap between two times [s].
        span: Time from the first to the last observation [s].
    """

    gap: float
    span: float

    def time_constant_at(self, score: float) -> float:
        """Time constant [s] at a standard normal score of its prior law.

        The law is log-normal with its median at the geometric mean of gap and span. Values are limited to the range
        from 0.1 gap to 3 span.

        Args:
            score: The standard normal score; 0 gives the median.
        """
        middle = 0.5 * math.log(self.gap * self.span)
        width = math.log(self.span / self.gap) / TIME_WIDTHS
        shortest = math.log(0.1 * self.gap)
        longest = math.log(3.0 * self.span)
        return math.exp(min(max(middle + width * score, shortest), longest))


def first_order_noise(point: np.ndarray, scale: TimeScale) -> Noise:
    """First-order noise whose time constant and share have given scores of their prior laws.

    Args:
        point: Standard normal scores of the time constant and of the share, shape (2,).
        scale: Gap and span of the times of observation.
    """
    time_score, share_score = point
    return FirstOrder(sigmoid(SHARE_WIDTH * share_score), scale.time_constant_at(time_score))


def second_order_noise(point: np.ndarray, scale: TimeScale) -> Noise:
    """Second-order noise whose time constant, share and damping have given scores of their prior laws.

    Args:
        point: Standard normal scores of the time constant, of the share and of the damping ratio, shape (3,).
        scale: Gap and span of the times of observation.
    """
    time_score, share_score, damping_score = point
    damping = sigmoid(DAMPING_MIDDLE + DAMPING_WIDTH * damping_score)
    return SecondOrder(
        share=sigmoid(SHARE_WIDTH * share_score),
        time=min(scale.time_constant_at(time_score), LONGEST * scale.gap),
        damping=min(max(damping, LEAST_DAMPING), MOST_DAMPING),
    )


def drift_noise(point: np.ndarray, scale: TimeScale) -> Noise:
    """Drift whose time constant and share have given scores of their prior laws.

    Args:
        point: Standard normal scores of the time constant and of the share, shape (2,).
        scale: Gap and span of the times of observation.
    """
    time_score, share_score = point
    span = scale.span + scale.gap  # the drift starts a gap before the first time
    return Drift(sigmoid(SHARE_WIDTH * share_score), min(scale.time_constant_at(time_score), span), span)


class NoiseKind(NamedTuple):
    """A kind of correlated noise, whose parameters follow from standard normal scores.

    Args:
        noise_at: (scores, shape (k,); gap and span of the times of observation) -> the noise with these scores.
        scores: Number k of scores.
    """

    noise_at: Callable[[np.ndarray, TimeScale], Noise]
    scores: int


NOISE_KINDS = (NoiseKind(first_order_noise, 2), NoiseKind(second_order_noise, 3), NoiseKind(drift_noise, 2))
"""The kinds of correlated noise that need no simulations."""


def noise_of_share(simulated: SimulatedNoise, point: np.ndarray, scale: TimeScale) -> Noise:
    """A simulated noise whose share c has a given score of its prior law, in which logit c is normal.

    The median of that law is the share that the simulations have.

    Args:
        simulated: The noise of simulations.
        point: The standard normal score, shape (1,).
        scale: The time scale, a part of the contract of a kind of noise; a simulated shape does not depend on it.
    """
    (share_score,) = point
    return simulated._replace(share=sigmoid(logit(simulated.share) + SHARE_WIDTH * share_score))
