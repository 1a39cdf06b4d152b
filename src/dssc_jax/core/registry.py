"""Registries: the kinds of model that a study may name, their options, and the slots that parts of a model fill."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple, TypeAlias


@dataclass(frozen=True)
class Slot:
    """Marks a parameter field that holds a part chosen by ``kind`` from ``registry``.

    A part is a ``NamedTuple`` of numbers with methods; its type tells the step what to compute, so that nothing
    is decided while tracing.

    Args:
        registry: The kinds that may stand here.
        number: The kind that a bare number stands for (its first field takes it).
        default: The kind when the table names none; without one, ``kind`` is required.
    """

    registry: "Registry"
    number: str | None = None
    default: str | None = None


class Entry(NamedTuple):
    """One registry row: a model, or a family of which an option picks the member.

    Args:
        members: The model for each value of the option; a single model stands under the key ``None``.
        option: Name of the option's field, e.g. ``discretisation``.
        default: The option's value when the table does not give it.
        summary: One line for ``dssc-jax info``.
        base: The table that the study's own is laid over.
    """

    members: dict[Any, Any]
    summary: str
    option: str | None = None
    default: Any = None
    base: dict[str, Any] = {}  # noqa: RUF012  (never changed)


Registry: TypeAlias = dict[str, Entry]


def single(model: Any, summary: str) -> Entry:
    """A registry row without options."""
    return Entry({None: model}, summary)


class Discretisation(StrEnum):
    """How a continuous-time law is sampled; see docs/model.md, Sampling."""

    IMPLICIT = "implicit"
    EXPLICIT = "explicit"
    PROPER = "proper"
