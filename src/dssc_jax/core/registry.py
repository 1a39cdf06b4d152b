"""Registries of the kinds of model that a study can name, options of these kinds, and slots for parts of a model."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple, TypeAlias

from dssc_jax.core.toml import TomlTable


@dataclass(frozen=True)
class Slot:
    """Annotation of a parameter field whose value is a part: a table in the study with a ``kind`` of ``registry``.

    A part is a ``NamedTuple`` of numbers with methods. The type of the part determines what a step computes, so no
    decision depends on traced values.

    Args:
        registry: The admissible kinds.
        number: The kind of the part if the study gives a number instead of a table; the number becomes the part's first
            field. None: a table is required.
        default: The kind if the table names none; None: the table must name its ``kind``.
    """

    registry: "Registry"
    number: str | None = None
    default: str | None = None


class Entry(NamedTuple):
    """One registry row: a model, or a family of models from which an option selects a member.

    Args:
        members: The model for each value of the option; a single model has the key ``None``.
        summary: Description in one line, for ``dssc-jax info``.
        option: Name of the option's field, e.g. ``discretisation``; None: there is no option.
        default: The option's value if the table does not give it.
        base: A table with values for the fields that the study's table leaves out.
        default_of: ``(table) -> value`` of the option if the default depends on a part in the table; None: the value is
            ``default``.
        example: A small table of the kind, without ``kind``; tests take their cases from it.
        loaded: ``(table) -> model`` if a file that the table names defines the model; None: ``members`` has the model.
        keys: Names in the table that ``loaded`` reads, with their meanings.
        native: Whether the file is native code: bound to the study by its digest, and loaded only on request.
    """

    members: dict[Any, Any]
    summary: str
    option: str | None = None
    default: Any = None
    base: TomlTable = {}  # noqa: RUF012  (never changed)
    default_of: Callable[[TomlTable], Any] | None = None
    example: TomlTable = {}  # noqa: RUF012  (never changed)
    loaded: Callable[[TomlTable], Any] | None = None
    keys: dict[str, str] = {}  # noqa: RUF012  (never changed)
    native: bool = False

    @property
    def default_member(self) -> Any:
        """The model that the option's default selects."""
        return self.members[self.default]


Registry: TypeAlias = dict[str, Entry]


def single(model: Any, summary: str, **example: Any) -> Entry:
    """Return the registry row of one model without options.

    Args:
        model: The model.
        summary: Description in one line.
        example: Fields of the row's example table.
    """
    return Entry({None: model}, summary, example=example)


class Discretisation(StrEnum):
    """Sampled form of a continuous-time control law; see docs/model.md, Sampling."""

    IMPLICIT = "implicit"
    EXPLICIT = "explicit"
    PROPER = "proper"
    CONSERVATIVE = "conservative"
