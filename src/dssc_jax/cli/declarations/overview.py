"""Options of the commands that show what is available: studies, info."""

from dataclasses import dataclass
from typing import Annotated

import typer

from dssc_jax.cli.declarations.types import Json, Local


@dataclass(frozen=True, kw_only=True)
class Studies:
    """List the studies that can be run by name."""

    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class Info:
    """Show versions, devices and every kind of model; or one kind's fields.

    Each kind with its fields and options, every law and metric, and the compiler of lanes. Of one kind: unit, meaning,
    admissible values and default of each field. Of a field, or a table within a kind: the same, with the kinds that
    have it. Of a law: its arguments. Of a metric: meaning and unit.
    """

    kind: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]", help="One kind of model or part, law, metric or field, or your own module:OBJECT."
        ),
    ] = None
    as_json: Json = False
    allow_local: Local = False
