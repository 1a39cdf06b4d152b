"""The families of probability laws, such as ``uniform`` and ``normal``, by the name in a study.

A law maps levels in the unit interval to values by its quantile function. So random, Sobol and Latin-hypercube points
can all be used.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy

from dssc_jax.study import densities
from dssc_jax.study.densities import Arguments


@dataclass(frozen=True)
class LawKind:
    """A family of laws, such as the uniform laws on all intervals.

    Each function takes the arguments ``a`` of a law, in the order of the study file.

    Args:
        signature: Arguments as text, such as ``[lo, hi]``.
        counts: Admissible numbers of arguments; None: one or more.
        rule: Rule that the arguments must satisfy, in words, and its test.
        support: Lowest and highest value.
        quantile: Inverse of the distribution function at levels ``u`` in (0, 1), in the shape of the levels.
        roles: One letter for each argument: ``l`` for a location, ``s`` for a scale, ``.`` for a shape. Empty if the
            law can be neither moved nor widened.
        logarithmic: Whether values spread about the median on a logarithmic scale.
        log_density: Logarithm of the density at values; None if arguments may not be ranges.
        nominal: Nominal value; None: the median is nominal.
        discrete: Whether all values of the law are among its arguments.
    """

    signature: str
    counts: tuple[int, ...] | None
    rule: tuple[str, Callable[[Arguments], bool]]
    support: Callable[[Arguments], tuple[float, float]]
    quantile: Callable[[Arguments, np.ndarray], np.ndarray]
    roles: str = ""
    logarithmic: bool = False
    log_density: Callable[[Arguments, np.ndarray], np.ndarray] | None = None
    nominal: Callable[[Arguments], float] | None = None
    discrete: bool = False

    @property
    def argument_names(self) -> tuple[str, ...]:
        """Names of the arguments, as many as the law can have: the last list in the signature."""
        _, _, names = self.signature.rpartition("[")
        return tuple(names.removesuffix("]").split(", "))


def truncated_quantile(a: Arguments, u: np.ndarray) -> np.ndarray:
    """Quantile of a normal law (mean, standard deviation) truncated to [lo, hi].

    An interval above the mean is mirrored: its probabilities, which are near 1, would cancel.
    """
    mean, std, low, high = a
    low_score = (low - mean) / std
    high_score = (high - mean) / std
    if low_score > 0.0:
        lower = scipy.special.ndtr(-high_score)
        upper = scipy.special.ndtr(-low_score)
        standard = -scipy.special.ndtri(upper - u * (upper - lower))
    else:
        lower = scipy.special.ndtr(low_score)
        upper = scipy.special.ndtr(high_score)
        standard = scipy.special.ndtri(lower + u * (upper - lower))
    return np.clip(mean + std * standard, low, high)


def triangular_quantile(a: Arguments, u: np.ndarray) -> np.ndarray:
    """Quantile of the triangular law on [lo, hi] with its peak at the mode."""
    low, mode, high = a
    width = high - low
    rising = low + np.sqrt(u * width * (mode - low))
    falling = high - np.sqrt((1.0 - u) * width * (high - mode))
    return np.where(u * width < mode - low, rising, falling)


def beta_quantile(a: Arguments, u: np.ndarray) -> np.ndarray:
    """Quantile of the beta law with two shape parameters on [lo, hi], by default [0, 1]."""
    low, high = a[2:] if len(a) == 4 else (0.0, 1.0)
    return low + (high - low) * scipy.special.betaincinv(a[0], a[1], u)


def choice_quantile(a: Arguments, u: np.ndarray) -> np.ndarray:
    """Quantile of the law in which each of the arguments is equally likely."""
    count = len(a)
    index = np.minimum((u * count).astype(int), count - 1)  # count u may round up to count
    return np.asarray(a)[index]


LAWS: dict[str, LawKind] = {
    "uniform": LawKind(
        signature="[lo, hi]",
        counts=(2,),
        rule=("lo must be below hi", lambda a: a[0] < a[1]),
        support=lambda a: (a[0], a[1]),
        quantile=lambda a, u: a[0] + (a[1] - a[0]) * u,
        roles="ll",
        log_density=densities.uniform,
    ),
    "loguniform": LawKind(
        signature="[lo, hi]",
        counts=(2,),
        rule=("0 < lo < hi must hold", lambda a: 0.0 < a[0] < a[1]),
        support=lambda a: (a[0], a[1]),
        quantile=lambda a, u: np.clip(a[0] * np.exp(np.log(a[1] / a[0]) * u), a[0], a[1]),
        roles="ll",
        logarithmic=True,
        log_density=densities.loguniform,
    ),
    "normal": LawKind(
        signature="[mean, std]",
        counts=(2,),
        rule=("std must be positive", lambda a: a[1] > 0.0),
        support=lambda a: (-math.inf, math.inf),
        quantile=lambda a, u: a[0] + a[1] * scipy.special.ndtri(u),
        roles="ls",
        log_density=densities.normal,
    ),
    "truncated_normal": LawKind(
        signature="[mean, std, lo, hi]",
        counts=(4,),
        rule=(
            "std must be positive, lo below hi, and [lo, hi] within 37 std of the mean",
            lambda a: a[1] > 0.0 and a[2] < a[3] and a[2] < a[0] + 37.0 * a[1] and a[3] > a[0] - 37.0 * a[1],
        ),
        support=lambda a: (a[2], a[3]),
        quantile=truncated_quantile,
        roles="lsll",
        log_density=densities.truncated_normal,
    ),
    "lognormal": LawKind(
        signature="[mean of the logarithm, std of the logarithm]",
        counts=(2,),
        rule=("std must be positive", lambda a: a[1] > 0.0),
        support=lambda a: (math.ulp(0.0), math.inf),
        quantile=lambda a, u: np.exp(a[0] + a[1] * scipy.special.ndtri(u)),
        roles="ls",
        logarithmic=True,
        log_density=densities.lognormal,
    ),
    "beta": LawKind(
        signature="[a, b] or [a, b, lo, hi]",
        counts=(2, 4),
        rule=("a and b must be positive and lo below hi", lambda a: min(a[:2]) > 0.0 and (len(a) == 2 or a[2] < a[3])),
        support=lambda a: (a[2], a[3]) if len(a) == 4 else (0.0, 1.0),
        quantile=beta_quantile,
        roles="..ll",
        log_density=densities.beta,
    ),
    "triangular": LawKind(
        signature="[lo, mode, hi]",
        counts=(3,),
        rule=("lo <= mode <= hi and lo < hi must hold", lambda a: a[0] <= a[1] <= a[2] and a[0] < a[2]),
        support=lambda a: (a[0], a[2]),
        quantile=triangular_quantile,
        roles="lll",
        log_density=densities.triangular,
    ),
    "choice": LawKind(
        signature="[value, value, ...]",
        counts=None,
        rule=("needs at least one value", lambda a: len(a) > 0),
        support=lambda a: (min(a), max(a)),
        quantile=choice_quantile,
        discrete=True,
    ),
    "point": LawKind(
        signature="[value, nominal value]",
        counts=(2,),
        rule=("needs finite numbers", lambda a: all(map(math.isfinite, a))),
        support=lambda a: (a[0], a[0]),
        quantile=lambda a, u: np.full(np.shape(u), a[0]),
        nominal=lambda a: a[1],
        discrete=True,
    ),
}
"""The families by the name of the law in a study."""
