"""Probability laws of uncertain numbers: ``{ uniform = [0.8, 1.2] }`` in place of a number.

:mod:`dssc_jax.study.law_kinds` defines the families of laws.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import product
from typing import TypeGuard

import jax
import numpy as np

from dssc_jax.core.errors import nearest
from dssc_jax.core.signals import Params
from dssc_jax.core.toml import TomlTable
from dssc_jax.study.law_kinds import LAWS

SPREAD = "spread"
"""Stands for all laws together, in place of a number's dotted name, where a margin is the width of all laws."""


class UncertainValue(ABC):
    """A value that differs between draws: a law, or an expression of parameters with laws."""

    @property
    @abstractmethod
    def support(self) -> tuple[float, float]:
        """Lowest and highest value."""

    @property
    @abstractmethod
    def median(self) -> float:
        """Value if every law is at its median."""

    @property
    @abstractmethod
    def nominal(self) -> float:
        """Nominal value, which an inner loop or a fitted controller assumes in every draw."""


def nominal_params(params: Params) -> Params:
    """Parameters with the nominal value in place of each law and each expression."""
    return jax.tree.map(lambda leaf: leaf.nominal if isinstance(leaf, UncertainValue) else leaf, params)


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
        """Whether the law can be moved and widened; its family must define the role of each argument."""
        return LAWS[self.kind].roles != ""

    @property
    def logarithmic(self) -> bool:
        """Whether values spread about the median on a logarithmic scale."""
        return LAWS[self.kind].logarithmic

    @property
    def support(self) -> tuple[float, float]:
        """Lowest and highest value."""
        return LAWS[self.kind].support(*self.arguments)

    def quantile(self, u: np.ndarray) -> np.ndarray:
        """Quantiles of the law at the probabilities ``u`` in (0, 1), in the shape of ``u``."""
        return LAWS[self.kind].quantile(u, *self.arguments)

    @property
    def median(self) -> float:
        """Median, the quantile at the level 1/2."""
        return float(self.quantile(np.asarray(0.5)))

    @property
    def nominal(self) -> float:
        """Nominal value of a ``point`` law, or the median."""
        nominal = LAWS[self.kind].nominal
        return self.median if nominal is None else float(nominal(*self.arguments))

    def spread(self, values: np.ndarray, share: np.ndarray | float) -> np.ndarray:
        """Map values of the law to values of the widened law: the distance from the median is multiplied by ``share``.

        For a logarithmic law, the distance is that of the logarithms. The values of a law that cannot be widened stay.
        The result has the shape of the values.
        """
        if not self.movable:
            return np.asarray(values)
        if self.logarithmic:
            return self.median * np.power(np.asarray(values) / self.median, share)
        return self.median + share * (np.asarray(values) - self.median)

    def moved(self, median: float, share: float) -> "Law":
        """The law of the same family with another median and a scaled width.

        The width of a logarithmic law is the width of the logarithm's law.

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
        arguments = self.arguments
        if self.kind == "beta" and len(arguments) == 2:
            arguments = (*arguments, 0.0, 1.0)  # the ends of its default interval
        values = np.asarray(arguments, dtype=float)
        old_location = math.log(self.median) if self.logarithmic else self.median
        new_location = math.log(median) if self.logarithmic else median
        if self.kind == "loguniform":  # its arguments are values, the arguments of a lognormal law are logarithms
            values = np.log(values)
        new_values = []
        for role, value in zip(LAWS[self.kind].roles, values, strict=True):
            match role:
                case "l":  # a location
                    new_values.append(float(new_location + share * (value - old_location)))
                case "s":  # a scale
                    new_values.append(float(share * value))
                case _:  # a shape
                    new_values.append(float(value))
        if self.kind == "loguniform":
            new_values = np.exp(new_values).tolist()
        return Law(self.kind, tuple(new_values))

    def __str__(self) -> str:
        """Family and arguments, such as ``uniform(0.8, 1.2)``."""
        return f"{self.kind}({', '.join(f'{value:g}' for value in self.arguments)})"


@dataclass(frozen=True)
class RangedLaw(Law):
    """A law whose arguments may lie anywhere within ranges (a probability box).

    The ``arguments`` of the law are the middles of the ranges.

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
        """Lowest and highest value that the law can have with arguments within the ranges."""
        supports = [law.support for law in self.corners]
        return min(low for low, _ in supports), max(high for _, high in supports)

    @property
    def corners(self) -> list[Law]:
        """The laws whose arguments are ends of the ranges, in all combinations."""
        ends = [[low] if low == high else [low, high] for low, high in self.ranges]
        return [Law(self.kind, arguments) for arguments in product(*ends)]

    @property
    def middle(self) -> Law:
        """The law whose arguments are the middles of the ranges."""
        return Law(self.kind, self.arguments)

    def __str__(self) -> str:
        """Family, arguments and ranges, such as ``uniform([0.7, 0.8], 1.2)``."""
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
    """Whether a value of a study is a law: a table whose only key is the name of a law."""
    return isinstance(value, dict) and len(value) == 1 and next(iter(value)) in LAWS


def parse_law(table: TomlTable) -> Law:
    """Parse a law from its table; an argument that is a list of two numbers is a range.

    Raises:
        ValueError: The table is no law, or the arguments break the law's rule.
    """
    if len(table) != 1:
        raise ValueError(f"a law is one name with its arguments, e.g. {{ uniform = [0.8, 1.2] }}; got {table}")
    kind, arguments = next(iter(table.items()))
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
    ranges = tuple(ends_of_range(value) for value in arguments)
    ends = [[low] if low == high else [low, high] for low, high in ranges]
    corners = product(*ends)  # the rules are linear in the arguments, so that they hold in between
    if not all(law_kind.rule.holds(*corner) for corner in corners):
        raise ValueError(f"{kind} {law_kind.signature}: {law_kind.rule.text}, got {arguments}")
    middles = tuple(0.5 * low + 0.5 * high for low, high in ranges)
    return RangedLaw(kind, middles, ranges) if has_ranges else Law(kind, middles)


def is_range(value: object) -> TypeGuard[list[int | float]]:
    """Whether an argument of a law is a range: a list of two numbers."""
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
