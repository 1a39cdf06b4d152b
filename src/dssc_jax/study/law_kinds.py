"""The families of probability laws, such as ``uniform`` and ``normal``, by the name in a study.

The quantile function of a law maps levels in the unit interval to values. So random, Sobol and Latin-hypercube points
can all be used as levels.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from dssc_jax.study import densities


class ArgumentRule(NamedTuple):
    """A rule that the arguments of a law must satisfy, in words and as a test ``(*arguments)`` -> whether it holds."""

    text: str
    holds: Callable[..., bool]


@dataclass(frozen=True)
class LawKind:
    """A family of laws, such as the uniform laws on all intervals.

    Each function takes the arguments of a law in the order of the study file. Levels or values precede them.

    Args:
        signature: Arguments as text, such as ``[lo, hi]``.
        counts: Admissible numbers of arguments; None: at least one argument.
        rule: Rule that the arguments must satisfy.
        support: ``(*arguments)`` -> lowest and highest value.
        quantile: ``(probability, *arguments)`` -> inverse of the distribution function at probabilities in (0, 1), in
            the shape of the probabilities.
        roles: One letter for each argument: ``l`` for a location, ``s`` for a scale, ``.`` for a shape. Empty if the
            law can be neither moved nor widened.
        logarithmic: Whether values spread about the median on a logarithmic scale.
        log_density: ``(x, *arguments)`` -> logarithm of the density at values x. None: the law has no density, and its
            arguments may not be ranges.
        nominal: ``(*arguments)`` -> nominal value; None: the nominal value is the median.
        discrete: Whether all values of the law are among its arguments.
    """

    signature: str
    counts: tuple[int, ...] | None
    rule: ArgumentRule
    support: Callable[..., tuple[float, float]]
    quantile: Callable[..., np.ndarray]
    roles: str = ""
    logarithmic: bool = False
    log_density: Callable[..., np.ndarray] | None = None
    nominal: Callable[..., float] | None = None
    discrete: bool = False

    @property
    def argument_names(self) -> tuple[str, ...]:
        """Names of all arguments that the law can have, from the last list in the signature."""
        _, _, names = self.signature.rpartition("[")
        return tuple(names.removesuffix("]").split(", "))


def truncated_quantile(probability: np.ndarray, mean: float, std: float, low: float, high: float) -> np.ndarray:
    """Compute quantiles of a normal law with a mean and a standard deviation, truncated to [low, high].

    An interval above the mean is mirrored at the mean. Its probabilities are near 1, so that their difference would
    lose digits by cancellation.
    """
    low_score = (low - mean) / std
    high_score = (high - mean) / std
    if low_score > 0.0:
        p_low = scipy.special.ndtr(-high_score)
        p_high = scipy.special.ndtr(-low_score)
        standard = -scipy.special.ndtri(p_high - probability * (p_high - p_low))
    else:
        p_low = scipy.special.ndtr(low_score)
        p_high = scipy.special.ndtr(high_score)
        standard = scipy.special.ndtri(p_low + probability * (p_high - p_low))
    return np.clip(mean + std * standard, low, high)  # rounding may step over the ends


def triangular_quantile(probability: np.ndarray, low: float, mode: float, high: float) -> np.ndarray:
    """Compute quantiles of the triangular law on [low, high] with its peak at the mode."""
    width = high - low
    rising = low + np.sqrt(probability * width * (mode - low))
    falling = high - np.sqrt((1.0 - probability) * width * (high - mode))
    return np.where(probability * width < mode - low, rising, falling)


def beta_quantile(probability: np.ndarray, a: float, b: float, low: float = 0.0, high: float = 1.0) -> np.ndarray:
    """Compute quantiles of the beta law with shape parameters a and b on [low, high]."""
    return low + (high - low) * scipy.special.betaincinv(a, b, probability)


def choice_quantile(probability: np.ndarray, *values: float) -> np.ndarray:
    """Compute quantiles of the law in which each of the values is equally likely."""
    count = len(values)
    index = np.minimum((probability * count).astype(int), count - 1)  # the product may round up to count
    return np.asarray(values)[index]


def truncates_within_37_deviations(mean: float, std: float, low: float, high: float) -> bool:
    """Whether std > 0, low < high, and [low, high] comes within 37 std of the mean; beyond, probabilities underflow."""
    return std > 0.0 and low < high and low < mean + 37.0 * std and high > mean - 37.0 * std


LAWS: dict[str, LawKind] = {
    "uniform": LawKind(
        signature="[lo, hi]",
        counts=(2,),
        rule=ArgumentRule("lo must be below hi", lambda low, high: low < high),
        support=lambda low, high: (low, high),
        quantile=lambda probability, low, high: low + (high - low) * probability,
        roles="ll",
        log_density=densities.uniform,
    ),
    "loguniform": LawKind(
        signature="[lo, hi]",
        counts=(2,),
        rule=ArgumentRule("0 < lo < hi must hold", lambda low, high: 0.0 < low < high),
        support=lambda low, high: (low, high),
        quantile=lambda probability, low, high: np.clip(low * np.exp(np.log(high / low) * probability), low, high),
        roles="ll",
        logarithmic=True,
        log_density=densities.loguniform,
    ),
    "normal": LawKind(
        signature="[mean, std]",
        counts=(2,),
        rule=ArgumentRule("std must be positive", lambda mean, std: std > 0.0),
        support=lambda mean, std: (-math.inf, math.inf),
        quantile=lambda probability, mean, std: mean + std * scipy.special.ndtri(probability),
        roles="ls",
        log_density=densities.normal,
    ),
    "truncated_normal": LawKind(
        signature="[mean, std, lo, hi]",
        counts=(4,),
        rule=ArgumentRule(
            "std must be positive, lo below hi, and [lo, hi] within 37 std of the mean", truncates_within_37_deviations
        ),
        support=lambda mean, std, low, high: (low, high),
        quantile=truncated_quantile,
        roles="lsll",
        log_density=densities.truncated_normal,
    ),
    "lognormal": LawKind(
        signature="[mean of the logarithm, std of the logarithm]",
        counts=(2,),
        rule=ArgumentRule("std must be positive", lambda mean, std: std > 0.0),
        support=lambda mean, std: (math.ulp(0.0), math.inf),
        quantile=lambda probability, mean, std: np.exp(mean + std * scipy.special.ndtri(probability)),
        roles="ls",
        logarithmic=True,
        log_density=densities.lognormal,
    ),
    "beta": LawKind(
        signature="[a, b] or [a, b, lo, hi]",
        counts=(2, 4),
        rule=ArgumentRule(
            "a and b must be positive and lo below hi",
            lambda a, b, low=0.0, high=1.0: min(a, b) > 0.0 and low < high,
        ),
        support=lambda a, b, low=0.0, high=1.0: (low, high),
        quantile=beta_quantile,
        roles="..ll",
        log_density=densities.beta,
    ),
    "triangular": LawKind(
        signature="[lo, mode, hi]",
        counts=(3,),
        rule=ArgumentRule(
            "lo <= mode <= hi and lo < hi must hold", lambda low, mode, high: low <= mode <= high and low < high
        ),
        support=lambda low, mode, high: (low, high),
        quantile=triangular_quantile,
        roles="lll",
        log_density=densities.triangular,
    ),
    "choice": LawKind(
        signature="[value, value, ...]",
        counts=None,
        rule=ArgumentRule("needs at least one value", lambda *values: len(values) > 0),
        support=lambda *values: (min(values), max(values)),
        quantile=choice_quantile,
        discrete=True,
    ),
    "point": LawKind(
        signature="[value, nominal value]",
        counts=(2,),
        rule=ArgumentRule("needs finite numbers", lambda *values: all(map(math.isfinite, values))),
        support=lambda value, nominal: (value, value),
        quantile=lambda probability, value, nominal: np.full(np.shape(probability), value),
        nominal=lambda value, nominal: nominal,
        discrete=True,
    ),
}
"""The families of laws, by the name of the law in a study."""
