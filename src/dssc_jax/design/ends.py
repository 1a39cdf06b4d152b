"""Lowest and highest value of every number of a study's loop, over all draws, at each point of its sweep."""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from dssc_jax.core.intervals import Interval
from dssc_jax.design.arrays import Numeric
from dssc_jax.study import Study


class Ends(NamedTuple):
    """Parameters of a loop, or of one of its parts, with every number at its lowest and at its highest value.

    Each value is a number, or an array that broadcasts over the sweep's axes.
    """

    low: Numeric
    high: Numeric

    def largest(self, name: str) -> Numeric:
        """Largest magnitude that the number in a field has between its ends."""
        return np.maximum(np.abs(getattr(self.low, name)), np.abs(getattr(self.high, name)))

    def part(self, name: str, index: int | None = None) -> "Ends":
        """The ends of the part in a field; with an index, of that element in a field with a tuple of parts."""
        low = getattr(self.low, name)
        high = getattr(self.high, name)
        return Ends(low, high) if index is None else Ends(low[index], high[index])


def ends_of(study: Study) -> Ends:
    """The parameters of a study's loop at both ends of every law.

    A swept number has the values of its axis at both ends, as an array along the axis. The ends of a number that
    follows from parameters enclose all values of the number. So a statement about all numbers between their ends, each
    independent of the others, holds for every draw.
    """
    ends: dict[str, tuple[Numeric, Numeric]] = {name: law.support for name, law in study.written_laws.items()}
    for position, (name, values) in enumerate(study.axes.items()):
        shape = [1] * len(study.axes)
        shape[position] = len(values)
        axis = np.asarray(values).reshape(shape)
        ends[name] = (axis, axis)
    ends |= expression_ends(study, ends)
    return Ends(
        low=study.params({name: low for name, (low, _) in ends.items()}),
        high=study.params({name: high for name, (_, high) in ends.items()}),
    )


def expression_ends(study: Study, ends: Mapping[str, tuple[Numeric, Numeric]]) -> dict[str, tuple[Numeric, Numeric]]:
    """Lowest and highest value of every number that follows from uncertain or swept parameters, by name.

    The values are infinite where the expression is not defined everywhere between the ends of its parameters.

    Args:
        study: The study.
        ends: Lowest and highest value of every uncertain or swept number, by name.
    """
    ends_by_name = {}
    for name, number in study.numbers.items():
        if number.expression is None or ends.keys().isdisjoint(number.sources):
            continue
        if study.axes.keys().isdisjoint(number.sources):
            ends_by_name[name] = number.expression.support
            continue
        inputs = {source: Interval.of(*ends[source]) for source in number.sources if source in ends}
        interval = number.expression.between(inputs)
        low = np.where(interval.defined, interval.low, -np.inf)
        high = np.where(interval.defined, interval.high, np.inf)
        is_certain = np.array_equal(low, high)  # both ends are then the same array, as those of a swept number are
        ends_by_name[name] = (low, low) if is_certain else (low, high)
    return ends_by_name
