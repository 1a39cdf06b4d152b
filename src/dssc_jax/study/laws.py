"""Probability laws of uncertain numbers: ``{ uniform = [0.8, 1.2] }`` in place of a number.

A law maps levels in the unit interval to values by its quantile function. So random, Sobol and Latin-hypercube points
can all be used.
"""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from typing import TypeGuard

import numpy as np
import scipy

from dssc_jax.core.errors import nearest
from dssc_jax.core.toml import TomlTable
from dssc_jax.study import densities
from dssc_jax.study.densities import Arguments


@dataclass(frozen=True)
class LawKind:
    """A family of laws. The functions take the arguments of a law.

    Args:
        signature: Arguments as text, such as ``[lo, hi]``.
        counts: Admissible numbers of arguments; None for one or more.
        rule: Rule that the arguments must satisfy, in words, and its test.
        support: Lowest and highest value.
        quantile: Inverse of the distribution function at levels in (0, 1), of the shape of the levels.
        roles: One letter for each argument: ``l`` for a location, ``s`` for a scale, ``.`` for a shape. Empty if the
            law can be neither moved nor widened.
        logarithmic: Whether values spread about the median on a logarithmic scale.
        log_density: Logarithm of the density at values; None if arguments may not be ranges.
        nominal: Nominal value; None for the median.
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
        """Names of the arguments, as many as the law can have."""
        return tuple(self.signature.rpartition("[")[2].rstrip("]").split(", "))


def truncated_quantile(a: Arguments, u: np.ndarray) -> np.ndarray:
    """Quantile of the normal law (mean, standard deviation) truncated to [lo, hi], at levels u.

    An interval above the mean is computed from the lower tail of the mirrored interval, which does not cancel.
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
    """Quantile of the triangular law on [lo, hi] with its peak at the mode, at levels u."""
    low, mode, high = a
    width = high - low
    rising = low + np.sqrt(u * width * (mode - low))
    falling = high - np.sqrt((1.0 - u) * width * (high - mode))
    return np.where(u * width < mode - low, rising, falling)


def beta_quantile(a: Arguments, u: np.ndarray) -> np.ndarray:
    """Quantile of the beta law with two shape parameters on [lo, hi], by default [0, 1], at levels u."""
    low, high = a[2:] or (0.0, 1.0)
    return low + (high - low) * scipy.special.betaincinv(a[0], a[1], u)


def choice_quantile(a: Arguments, u: np.ndarray) -> np.ndarray:
    """Quantile of the law in which each of the arguments is equally likely, at levels u."""
    return np.asarray(a)[np.minimum((u * len(a)).astype(int), len(a) - 1)]


LAWS: dict[str, LawKind] = {
    "uniform": LawKind(
        "[lo, hi]",
        (2,),
        ("lo must be below hi", lambda a: a[0] < a[1]),
        lambda a: (a[0], a[1]),
        lambda a, u: a[0] + (a[1] - a[0]) * u,
        roles="ll",
        log_density=densities.uniform,
    ),
    "loguniform": LawKind(
        "[lo, hi]",
        (2,),
        ("0 < lo < hi must hold", lambda a: 0.0 < a[0] < a[1]),
        lambda a: (a[0], a[1]),
        lambda a, u: np.clip(a[0] * np.exp(np.log(a[1] / a[0]) * u), a[0], a[1]),
        roles="ll",
        logarithmic=True,
        log_density=densities.loguniform,
    ),
    "normal": LawKind(
        "[mean, std]",
        (2,),
        ("std must be positive", lambda a: a[1] > 0.0),
        lambda a: (-math.inf, math.inf),
        lambda a, u: a[0] + a[1] * scipy.special.ndtri(u),
        roles="ls",
        log_density=densities.normal,
    ),
    "truncated_normal": LawKind(
        "[mean, std, lo, hi]",
        (4,),
        (
            "std must be positive, lo below hi, and [lo, hi] within 37 std of the mean",
            lambda a: a[1] > 0.0 and a[2] < a[3] and a[2] < a[0] + 37.0 * a[1] and a[3] > a[0] - 37.0 * a[1],
        ),
        lambda a: (a[2], a[3]),
        truncated_quantile,
        roles="lsll",
        log_density=densities.truncated_normal,
    ),
    "lognormal": LawKind(
        "[mean of the logarithm, std of the logarithm]",
        (2,),
        ("std must be positive", lambda a: a[1] > 0.0),
        lambda a: (math.ulp(0.0), math.inf),
        lambda a, u: np.exp(a[0] + a[1] * scipy.special.ndtri(u)),
        roles="ls",
        logarithmic=True,
        log_density=densities.lognormal,
    ),
    "beta": LawKind(
        "[a, b] or [a, b, lo, hi]",
        (2, 4),
        ("a and b must be positive and lo below hi", lambda a: min(a[:2]) > 0.0 and (len(a) == 2 or a[2] < a[3])),
        lambda a: (a[2], a[3]) if len(a) == 4 else (0.0, 1.0),
        beta_quantile,
        roles="..ll",
        log_density=densities.beta,
    ),
    "triangular": LawKind(
        "[lo, mode, hi]",
        (3,),
        ("lo <= mode <= hi and lo < hi must hold", lambda a: a[0] <= a[1] <= a[2] and a[0] < a[2]),
        lambda a: (a[0], a[2]),
        triangular_quantile,
        roles="lll",
        log_density=densities.triangular,
    ),
    "choice": LawKind(
        "[value, value, ...]",
        None,
        ("needs at least one value", lambda a: len(a) > 0),
        lambda a: (min(a), max(a)),
        choice_quantile,
        discrete=True,
    ),
    "point": LawKind(
        "[value, nominal value]",
        (2,),
        ("needs finite numbers", lambda a: all(map(math.isfinite, a))),
        lambda a: (a[0], a[0]),
        lambda a, u: np.full(np.shape(u), a[0]),
        nominal=lambda a: a[1],
        discrete=True,
    ),
}


SPREAD = "spread"
"""Stands for all laws together, in place of a number's dotted name, where a margin widens laws."""


class UncertainValue(ABC):
    """A value that differs between draws: a law, or an expression of parameters with laws."""

    @property
    @abstractmethod
    def support(self) -> tuple[float, float]:
        """Lowest and highest value."""

    @property
    @abstractmethod
    def median(self) -> float:
        """Value when every law is at its median."""

    @property
    @abstractmethod
    def nominal(self) -> float:
        """Value that an inner loop, or a controller which is fitted to the plant, assumes in every draw."""


@dataclass(frozen=True)
class Law(UncertainValue):
    """Probability law of a number.

    Args:
        kind: Name of the family in :data:`LAWS`.
        arguments: Arguments in the order of the study file.
    """

    kind: str
    arguments: tuple[float, ...]

    @property
    def table(self) -> TomlTable:
        """Table of the law in a study file, such as ``{"uniform": [0.8, 1.2]}``."""
        return {self.kind: list(self.arguments)}

    @property
    def movable(self) -> bool:
        """Whether the law can be moved and widened."""
        return bool(LAWS[self.kind].roles)

    @property
    def logarithmic(self) -> bool:
        """Whether values spread about the median on a logarithmic scale."""
        return LAWS[self.kind].logarithmic

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value."""
        return LAWS[self.kind].support(self.arguments)

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """Inverse of the distribution function at levels ``u`` in (0, 1), of their shape."""
        return LAWS[self.kind].quantile(self.arguments, u)

    @property
    def median(self) -> float:
        """Value at the level 1/2."""
        return float(self.quantile(np.asarray(0.5)))

    @property
    def nominal(self) -> float:
        """Nominal value of a ``point`` law, or the median."""
        nominal = LAWS[self.kind].nominal
        return self.median if nominal is None else float(nominal(self.arguments))

    def spread(self, values: np.ndarray, share: np.ndarray | float) -> np.ndarray:
        """Scale the distance of values from the median by ``share``; a law that cannot be widened keeps its values.

        For logarithmic laws, the distance is that of the logarithms. The result has the shape of the values.
        """
        if not self.movable:
            return np.asarray(values)
        if self.logarithmic:
            return self.median * np.power(np.asarray(values) / self.median, share)
        return self.median + share * (np.asarray(values) - self.median)

    def moved(self, median: float, share: float) -> "Law":
        """The law of the same family with another median and a scaled width.

        For logarithmic laws, the width is that of the logarithms.

        Args:
            median: New median; positive for a logarithmic law.
            share: New width relative to the present one, > 0.

        Raises:
            ValueError: The law has no width, or an argument is out of range.

        Example:
            >>> Law("uniform", (0.0, 2.0)).moved(3.0, 0.5)
            Law(kind='uniform', arguments=(2.5, 3.5))
        """
        if not self.movable:
            raise ValueError(f"a {self.kind} has no width")
        if not share > 0.0 or (self.logarithmic and not median > 0.0):
            raise ValueError(f"needs share > 0, and median > 0 on a logarithmic scale, got {share:g} and {median:g}")
        arguments = (*self.arguments, 0.0, 1.0)[:4] if self.kind == "beta" else self.arguments
        old_location = self.median
        new_location = median
        values = np.asarray(arguments, dtype=float)
        if self.logarithmic:
            old_location = math.log(old_location)
            new_location = math.log(new_location)
        if self.kind == "loguniform":  # its arguments are values, those of a lognormal law are logarithms
            values = np.log(values)
        by_role = {"l": new_location + share * (values - old_location), "s": share * values, ".": values}
        new_arguments = [float(by_role[role][i]) for i, role in enumerate(LAWS[self.kind].roles)]
        if self.kind == "loguniform":
            new_arguments = np.exp(new_arguments).tolist()
        return Law(self.kind, tuple(new_arguments))

    def __str__(self) -> str:
        return f"{self.kind}({', '.join(f'{value:g}' for value in self.arguments)})"


@dataclass(frozen=True)
class RangedLaw(Law):
    """A law whose arguments may lie anywhere within ranges (a probability box).

    The ``arguments`` are the middles of the ranges.

    Args:
        ranges: Lowest and highest value of each argument; equal for an argument that is a plain number.
    """

    ranges: tuple[tuple[float, float], ...]

    @property
    def table(self) -> TomlTable:
        """Table of the law in a study file, such as ``{"uniform": [0.8, 1.2]}``."""
        return {self.kind: [low if low == high else [low, high] for low, high in self.ranges]}

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value under any arguments within the ranges."""
        lows, highs = zip(*(law.support for law in self.corners), strict=True)
        return min(lows), max(highs)

    @property
    def corners(self) -> list[Law]:
        """The laws at all combinations of ends of the ranges."""
        ends = [[low] if low == high else [low, high] for low, high in self.ranges]
        return [Law(self.kind, arguments) for arguments in product(*ends)]

    @property
    def middle(self) -> Law:
        """The law at the middles of the ranges."""
        return Law(self.kind, self.arguments)

    def __str__(self) -> str:
        texts = [f"{low:g}" if low == high else f"[{low:g}, {high:g}]" for low, high in self.ranges]
        return f"{self.kind}({', '.join(texts)})"


def is_number(value: object) -> TypeGuard[int | float]:
    """Whether a value is a finite int or float, and not a bool."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(float(value))
    except OverflowError:  # an integer of more than 308 digits
        return False


def is_law(value: object) -> TypeGuard[TomlTable]:
    """Whether a value is a table whose only key is the name of a law."""
    return isinstance(value, dict) and len(value) == 1 and next(iter(value)) in LAWS


def parse_law(table: TomlTable) -> Law:
    """Parse a law from its table; an argument that is a list of two numbers is a range.

    Raises:
        ValueError: The table is no law, or the arguments break the law's rule.
    """
    if len(table) != 1:
        raise ValueError(f"a law is one name with its arguments, e.g. {{ uniform = [0.8, 1.2] }}; got {table}")
    ((kind, arguments),) = table.items()
    if kind not in LAWS:
        raise ValueError(f"'{kind}' is not a law; {nearest(kind, LAWS)}")
    law_kind = LAWS[kind]
    if not isinstance(arguments, list) or not all(is_number(value) or is_range(value) for value in arguments):
        raise ValueError(f"{kind} takes finite numbers {law_kind.signature}, got {arguments}")
    has_ranges = any(is_range(value) for value in arguments)
    if has_ranges and law_kind.log_density is None:
        raise ValueError(f"the arguments of a {kind} may not be ranges, got {arguments}; give numbers")
    if law_kind.counts is not None and len(arguments) not in law_kind.counts:
        raise ValueError(f"{kind} takes {law_kind.signature}, got {len(arguments)} arguments {arguments}")
    rule, is_kept = law_kind.rule
    ranges = tuple(ends_of_range(value) for value in arguments)
    corners = product(*(dict.fromkeys(ends) for ends in ranges))  # the rules are linear, so that they hold in between
    if not all(is_kept(corner) for corner in corners):
        raise ValueError(f"{kind} {law_kind.signature}: {rule}, got {arguments}")
    middles = tuple(0.5 * low + 0.5 * high for low, high in ranges)
    return RangedLaw(kind, middles, ranges) if has_ranges else Law(kind, middles)


def is_range(value: object) -> TypeGuard[list[int | float]]:
    """Whether a value is a list of two numbers."""
    return isinstance(value, list) and len(value) == 2 and all(is_number(end) for end in value)


def ends_of_range(value: int | float | list[int | float]) -> tuple[float, float]:
    """Lowest and highest value of an argument of a law; equal for a plain number.

    Raises:
        ValueError: The ends are in the wrong order.
    """
    if not isinstance(value, list):
        return float(value), float(value)
    low, high = map(float, value)
    if not low < high:
        raise ValueError(f"a range of an argument is [lo, hi] with lo below hi, got {value}")
    return low, high
