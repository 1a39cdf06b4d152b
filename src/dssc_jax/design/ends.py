"""Lowest and highest value of every number of a study's loop."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dssc_jax.core.intervals import Interval
from dssc_jax.design.arrays import Numeric
from dssc_jax.study import Study


class Ends(NamedTuple):
    """Lowest and highest value of every number of a loop, each an array over the sweep's axes or a number."""

    low: Numeric
    high: Numeric

    def largest(self, name: str) -> Numeric:
        """Largest magnitude of a field between its ends."""
        return np.maximum(np.abs(getattr(self.low, name)), np.abs(getattr(self.high, name)))

    def part(self, name: str, index: int | None = None) -> "Ends":
        """The ends of a part, or of its element at an index."""
        low = getattr(self.low, name)
        high = getattr(self.high, name)
        return Ends(low, high) if index is None else Ends(low[index], high[index])


def ends_of(study: Study) -> Ends:
    """The loop's parameters at both ends of every law; swept values lie along their axes.

    A number that follows from parameters lies between the ends of an interval that holds all its values, whatever the
    other numbers are: what holds for all numbers between their ends holds for every draw.
    """
    ends: dict[str, tuple[Numeric, Numeric]] = {name: law.support for name, law in study.written_laws.items()}
    for position, (name, values) in enumerate(study.axes.items()):
        shape = [1] * len(study.axes)
        shape[position] = -1
        axis = np.asarray(values).reshape(shape)
        ends[name] = (axis, axis)
    ends |= expression_ends(study, ends)
    low, high = (study.params({name: pair[end] for name, pair in ends.items()}) for end in (0, 1))
    return Ends(low, high)


def expression_ends(study: Study, ends: Mapping[str, tuple[Numeric, Numeric]]) -> dict[str, tuple[Numeric, Numeric]]:
    """Lowest and highest value of every number whose expression names a parameter of ``ends``, by name.

    They are infinite where the expression is not defined between the ends.
    """
    ends_by_name = {}
    for name, number in study.numbers.items():
        if number.expression is None or not ends.keys() & set(number.sources):
            continue
        if not study.axes.keys() & set(number.sources):
            ends_by_name[name] = number.expression.support
            continue
        inputs = {source: Interval.of(*ends[source]) for source in number.sources if source in ends}
        interval = number.expression.between(inputs)
        low = np.where(interval.defined, interval.low, -np.inf)
        high = np.where(interval.defined, interval.high, np.inf)
        ends_by_name[name] = (low, low) if np.array_equal(low, high) else (low, high)
    return ends_by_name
