"""``Quantity``: unit, meaning and admissible interval of a model's number."""

from dataclasses import dataclass, replace
from typing import Any, get_type_hints


@dataclass(frozen=True)
class Quantity:
    """Unit, meaning and admissible interval of one number of a model, by which a study checks and describes it.

    Args:
        unit: SI unit, in which ``y`` and ``u`` stand for the units of the plant's output and command
            (:mod:`dssc_jax.core.units`); ``"1"``: dimensionless. Several with commas between them are those of the
            elements of a list, of which the last one is that of all further elements.
        meaning: The standard term, with the article's symbol.
        above: Exclusive lower bound.
        at_least: Inclusive lower bound.
        below: Exclusive upper bound.
        at_most: Inclusive upper bound.
        law: Whether a probability law may replace the number.
        data: Whether it is one of many values of a record, which have no names in the study.
        leading: Whether it is among the few numbers for which an exploration shows sliders at first.
        begins: Whether it is the time at which an effect begins: after the end of the loop it would have no effect.
        ends: Whether it is the time at which an effect ends.
        periodic: Whether it is an angle that begins again after a turn.
        whole: Whether it is a whole number, whose law is a choice of whole numbers.
        less_than: Name of the number of the same part below which it must lie, for all values of their laws; None: of
            none.
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
    less_than: str | None = None

    def element(self, index: int) -> "Quantity":
        """The quantity of an element of a list of numbers, with the unit of that element."""
        units = self.unit.split(", ")
        return self if len(units) == 1 else replace(self, unit=units[min(index, len(units) - 1)])

    def violated_by(self, low: float, high: float) -> str | None:
        """The rule that the values in [low, high] violate, such as ``must be > 0``; None if they violate none."""
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
        """The admissible values as text, such as ``> 0 and <= 1``; empty if all values are admissible."""
        bounds = []
        if self.at_least is not None:
            bounds.append(f">= {self.at_least:g}")
        elif self.above is not None:
            bounds.append(f"> {self.above:g}")
        if self.at_most is not None:
            bounds.append(f"<= {self.at_most:g}")
        elif self.below is not None:
            bounds.append(f"< {self.below:g}")
        return " and ".join(bounds)


def unit_and_meaning(unit: str, meaning: str) -> dict[str, str]:
    """Unit and meaning as attributes of a variable of a dataset, by the names of the CF conventions."""
    return {"units": unit, "long_name": meaning}


def quantities_of(kind: type | None) -> dict[str, Quantity]:
    """The quantities that the fields of a NamedTuple type declare, by field.

    Args:
        kind: The type, whose fields are annotated with a :class:`Quantity`; None: no type, so no quantities.
    """
    if kind is None:
        return {}
    quantities = {}
    for name, hint in get_type_hints(kind, include_extras=True).items():
        for mark in getattr(hint, "__metadata__", ()):
            if isinstance(mark, Quantity):
                quantities[name] = mark
    return quantities


def extent(value: Any) -> tuple[float, float]:
    """Lowest and highest value of a parameter, a law or a number; for a number both are the number itself."""
    support = getattr(value, "support", None)
    return support if support is not None else (float(value), float(value))


def nominal(value: Any) -> float:
    """Nominal value of a parameter: the law's nominal value, or the number itself."""
    return float(getattr(value, "nominal", value))
