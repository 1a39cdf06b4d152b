"""What the numbers of an answer mean, by their keys in the JSON."""

from dataclasses import dataclass, field
from typing import Annotated

from dssc_jax.core.quantities import Quantity
from dssc_jax.results.fields import MERGED, field_meanings


@dataclass(frozen=True)
class Part:
    size: Annotated[float, Quantity("m", "size")]


@dataclass(frozen=True)
class Whole:
    count: Annotated[int, Quantity("1", "count")]
    part: Part = field(metadata={MERGED: True})
    parts: dict[str, Part] = field(metadata={MERGED: True})


@dataclass(frozen=True)
class Answer:
    wholes: list[Whole]
    whole: Whole = field(metadata={MERGED: True})


def test_merged_entries_stand_beside_the_other_fields():
    keys = [meaning.key for meaning in field_meanings(Answer)]
    assert keys == ["wholes[].count", "wholes[].size", "wholes[].NAME.size", "count", "size", "NAME.size"]
