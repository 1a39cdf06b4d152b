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
    """Show the versions, the devices and the available models; with NAME, describe one of them.

    Without NAME, it lists each kind of model with its fields and options, every law and metric, and the compiler of
    lanes. With NAME, it describes a model by unit, meaning, admissible values and default of each field; a field, or a
    table within a model, also by the models that have it; a law by its arguments; a metric by its meaning and unit.
    """

    kind: Annotated[
        str | None,
        typer.Argument(
            metavar="[NAME]", help="One kind of model or part, law, metric or field, or your own module:OBJECT."
        ),
    ] = None
    as_json: Json = False
    allow_local: Local = False
