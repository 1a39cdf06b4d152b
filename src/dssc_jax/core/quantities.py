"""``Quantity``: unit, meaning and admissible interval of a model's number."""

from dataclasses import dataclass, replace
from typing import Any, get_type_hints


@dataclass(frozen=True)
class Quantity:
    """Unit, meaning and admissible interval of one number of a model, by which a study checks and describes it.

    Args:
        unit: SI unit, in which ``y`` and ``u`` stand for the units of the plant's output and command
            (:mod:`dssc_jax.core.units`); ``"1"``: dimensionless. For a list of numbers, units with commas between them
            are the units of the first elements, and the last unit is that of all further elements.
        meaning: The standard term, with the article's symbol.
        above: Exclusive lower bound.
        at_least: Inclusive lower bound.
        below: Exclusive upper bound.
        at_most: Inclusive upper bound.
        law: Whether a probability law may replace the number.
        data: Whether the number is one of many values of a record, which have no names in the study.
        leading: Whether the number is among the few for which an exploration shows sliders at first.
        begins: Whether the number is the time at which an effect begins; after the end of the loop it has no effect.
        ends: Whether the number is the time at which an effect ends.
        periodic: Whether the number is an angle that begins again after a turn.
        whole: Whether the number is a whole one, whose law is a choice of whole numbers.
        less_than: Name of another number of the same part. This number must lie below that one for all values of their
            laws. None: there is no such number.
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
        """Return the quantity of the element at an index of a list of numbers, with the unit of that element."""
        units = self.unit.split(", ")
        return self if len(units) == 1 else replace(self, unit=units[min(index, len(units) - 1)])

    def violated_by(self, low: float, high: float) -> str | None:
        """Return the first rule that some value in [low, high] violates, such as ``must be > 0``; None if none does.

        A NaN violates every bound.
        """
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
    """Return unit and meaning as attributes of a dataset's variable, under the names of the CF conventions."""
    return {"units": unit, "long_name": meaning}


def quantities_of(kind: type | None) -> dict[str, Quantity]:
    """Return the quantity that each field of a NamedTuple type declares, by the field's name.

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
    """Return the lowest and the highest value of a parameter: the support of a law, or a number twice."""
    support = getattr(value, "support", None)
    return support if support is not None else (float(value), float(value))


def nominal(value: Any) -> float:
    """Return the nominal value of a parameter: that of a law, or the number itself."""
    return float(getattr(value, "nominal", value))
