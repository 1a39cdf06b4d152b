"""Commands that show what is available: studies, info."""

import json
from typing import Annotated

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app
from dssc_jax.core.errors import ConfigError


@app.command()
def studies(as_json: opt.Json = False) -> int:
    """List the studies that can be run by name."""
    from dssc_jax.console import show_table
    from dssc_jax.study import read_toml
    from dssc_jax.study.library import available_studies

    rows = []
    for name, path in available_studies().items():
        try:
            about = str(read_toml(path).get("description", ""))
        except ConfigError as error:
            about = f"({error.rule})"
        rows.append((name, about, str(path)))
    if as_json:
        print(json.dumps({"studies": [dict(zip(("name", "description", "path"), row, strict=True)) for row in rows]}))
    else:
        show_table(("study", "description", "file"), rows)
    return DONE


@app.command()
def info(
    kind: Annotated[str | None, typer.Argument(metavar="[KIND]", help="Show only this kind of model or part.")] = None,
    as_json: opt.Json = False,
) -> int:
    """Show versions, devices and every kind of model; or one kind's fields.

    Each kind with its fields and options, and the compiler of lanes. Of one KIND: unit, meaning, admissible
    values and default of each field.
    """
    from dssc_jax.console import environment, show_environment

    if kind is not None:
        from dssc_jax.console.kinds import show_kind

        if as_json:
            raise ConfigError("--json", "covers all kinds; omit KIND")
        show_kind(kind)
        return DONE
    machine = environment()
    if as_json:
        print(json.dumps(machine))
    else:
        show_environment(machine)
    return DONE
