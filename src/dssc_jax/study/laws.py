"""Probability laws of uncertain numbers: ``{ uniform = [0.8, 1.2] }`` in place of a number.

A law maps the unit interval to its values, so that random, Sobol and Latin-hypercube points serve alike.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from dssc_jax.errors import meant


@dataclass(frozen=True)
class LawKind:
    """Arguments of a law, its rule, and its distribution.

    Args:
        signature: The arguments as one writes them.
        counts: How many arguments it takes; None for one or more.
        rule: The rule that arguments must keep, in words, and its test.
        frozen: The scipy distribution of the arguments.
    """

    signature: str
    counts: tuple[int, ...] | None
    rule: tuple[str, Callable[[tuple[float, ...]], bool]]
    frozen: Callable[[tuple[float, ...]], Any] | None


def increasing(a: tuple[float, ...]) -> bool:
    """Lo < hi."""
    return a[0] < a[1]


def truncated(a: tuple[float, ...]) -> Any:
    """Normal (mean a[0], deviation a[1]) truncated to [a[2], a[3]]."""
    mean, std, low, high = a
    return stats.truncnorm((low - mean) / std, (high - mean) / std, mean, std)


def scaled_beta(a: tuple[float, ...]) -> Any:
    """Beta on [lo, hi], by default [0, 1]."""
    low, high = a[2:] or (0.0, 1.0)
    return stats.beta(a[0], a[1], low, high - low)


LAWS: dict[str, LawKind] = {
    "uniform": LawKind("[lo, hi]", (2,), ("lo must be below hi", increasing), lambda a: stats.uniform(a[0], a[1] - a[0])),
    "loguniform": LawKind(
        "[lo, hi]", (2,), ("0 < lo < hi must hold", lambda a: 0.0 < a[0] < a[1]), lambda a: stats.loguniform(*a)
    ),
    "normal": LawKind(
        "[mean, std]", (2,), ("std must be positive", lambda a: a[1] > 0.0), lambda a: stats.norm(*a)
    ),
    "truncated_normal": LawKind(
        "[mean, std, lo, hi]",
        (4,),
        ("std must be positive and lo below hi", lambda a: a[1] > 0.0 and a[2] < a[3]),
        truncated,
    ),
    "lognormal": LawKind(
        "[mean of the logarithm, std of the logarithm]",
        (2,),
        ("std must be positive", lambda a: a[1] > 0.0),
        lambda a: stats.lognorm(a[1], scale=math.exp(a[0])),
    ),
    "beta": LawKind(
        "[a, b] or [a, b, lo, hi]",
        (2, 4),
        ("a and b must be positive and lo below hi", lambda a: min(a[:2]) > 0.0 and (len(a) == 2 or a[2] < a[3])),
        scaled_beta,
    ),
    "triangular": LawKind(
        "[lo, mode, hi]",
        (3,),
        ("lo <= mode <= hi and lo < hi must hold", lambda a: a[0] <= a[1] <= a[2] and a[0] < a[2]),
        lambda a: stats.triang((a[1] - a[0]) / (a[2] - a[0]), a[0], a[2] - a[0]),
    ),
    "choice": LawKind("[value, value, ...]", None, ("needs at least one value", lambda a: len(a) > 0), None),
}


@dataclass(frozen=True)
class Law:
    """A law that stands for a number.

    Args:
        kind: Name in :data:`LAWS`.
        arguments: Its arguments, as the study file gives them.
    """

    kind: str
    arguments: tuple[float, ...]

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value."""
        make = LAWS[self.kind].frozen
        if make is None:
            return min(self.arguments), max(self.arguments)
        low, high = make(self.arguments).support()
        return float(low), float(high)

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """Values at the levels ``u`` in (0, 1): the inverse of the distribution function."""
        make = LAWS[self.kind].frozen
        if make is None:
            values = np.asarray(self.arguments)
            return values[np.minimum((u * len(values)).astype(int), len(values) - 1)]
        return np.asarray(make(self.arguments).ppf(u))

    @property
    def median(self) -> float:
        """The value at level 1/2."""
        return float(self.quantile(np.asarray(0.5)))

    def __str__(self) -> str:
        return f"{self.kind}({', '.join(f'{value:g}' for value in self.arguments)})"


def is_number(value: Any) -> bool:
    """A finite int or float, and not a bool."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def is_law(value: Any) -> bool:
    """A table of one known law."""
    return isinstance(value, dict) and len(value) == 1 and next(iter(value)) in LAWS


def parse_law(table: dict[str, Any]) -> Law:
    """A law from its table.

    Raises:
        ValueError: the rule that is broken, and the value found.
    """
    if len(table) != 1:
        raise ValueError(f"a law is one name with its arguments, e.g. {{ uniform = [0.8, 1.2] }}; got {table}")
    ((kind, arguments),) = table.items()
    if kind not in LAWS:
        raise ValueError(f"'{kind}' is not a law; {meant(kind, LAWS)}")
    spec = LAWS[kind]
    if not isinstance(arguments, list) or not all(is_number(value) for value in arguments):
        raise ValueError(f"{kind} takes finite numbers {spec.signature}, got {arguments}")
    if spec.counts is not None and len(arguments) not in spec.counts:
        raise ValueError(f"{kind} takes {spec.signature}, got {len(arguments)} arguments {arguments}")
    values = tuple(float(value) for value in arguments)
    rule, holds = spec.rule
    if not holds(values):
        raise ValueError(f"{kind} {spec.signature}: {rule}, got {arguments}")
    return Law(kind, values)
