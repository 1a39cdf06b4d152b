"""``Quantity``: unit, meaning and admissible interval of a model's number."""

from dataclasses import dataclass
from typing import Any, get_type_hints


@dataclass(frozen=True)
class Quantity:
    """Unit, meaning and admissible interval of one number of a model.

    Args:
        unit: SI unit, with ``y`` and ``u`` for those of the plant's output and command (:mod:`dssc_jax.core.units`);
            ``"1"`` when dimensionless.
        meaning: The standard term, with the paper's symbol.
        above: Exclusive lower bound.
        at_least: Inclusive lower bound.
        below: Exclusive upper bound.
        at_most: Inclusive upper bound.
        law: Whether a probability law may replace the number.
        data: Whether it is one of many values of a record, which have no names in the study.
        leading: Whether it is among the few numbers with which the exploration of a vehicle begins.
        begins: Whether it is a time at which something begins, which has no effect after the end of the loop.
        ends: Whether it is a time at which something ends.
        periodic: Whether it is an angle that begins again after a turn.
        whole: Whether it is a whole number, whose law is a choice of whole numbers.
    """

    unit: str
    meaning: str
    above: float | None = None
    at_least: float | None = None
    below: float | None = None
    at_most: float | None = None
    law: bool = True
    data: bool = False
    leading: bool = False
    begins: bool = False
    ends: bool = False
    periodic: bool = False
    whole: bool = False

    def violated_by(self, low: float, high: float) -> str | None:
        """Return the rule that the interval [low, high] violates, or None."""
        if self.above is not None and not low > self.above:
            return f"must be > {self.above:g}"
        if self.at_least is not None and not low >= self.at_least:
            return f"must be >= {self.at_least:g}"
        if self.below is not None and not high < self.below:
            return f"must be < {self.below:g}"
        if self.at_most is not None and not high <= self.at_most:
            return f"must be <= {self.at_most:g}"
        return None

    @property
    def interval(self) -> str:
        """The admissible values, in words; empty if all are."""
        lower = f"> {self.above:g}" if self.above is not None else None
        lower = f">= {self.at_least:g}" if self.at_least is not None else lower
        upper = f"< {self.below:g}" if self.below is not None else None
        upper = f"<= {self.at_most:g}" if self.at_most is not None else upper
        return " and ".join(filter(None, (lower, upper)))


def quantities_of(kind: type | None) -> dict[str, Quantity]:
    """The quantity of each field of a NamedTuple type that declares one, by name; empty for None."""
    quantities = {}
    for name, hint in get_type_hints(kind, include_extras=True).items() if kind else ():
        for mark in getattr(hint, "__metadata__", ()):
            if isinstance(mark, Quantity):
                quantities[name] = mark
    return quantities


def extent(value: Any) -> tuple[float, float]:
    """Lowest and highest value of a number or of the law that replaces it."""
    support = getattr(value, "support", None)
    return support if support is not None else (float(value), float(value))


def nominal(value: Any) -> float:
    """A number, or the nominal value of the law that replaces it."""
    return float(getattr(value, "nominal", value))
