"""Commands that show what is available: studies, info."""

import json
from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app, show_code
from dssc_jax.core.errors import ConfigError


def print_version(wanted: bool) -> None:
    """Print the version and end."""
    if wanted:
        from dssc_jax import __version__

        print(f"dssc-jax {__version__}")
        raise typer.Exit(DONE)


def silence(wanted: bool) -> None:
    """Show no progress and no notices; errors are still reported."""
    if wanted:
        from dssc_jax.console.terminal import errors

        errors().quiet = True


@app.callback()
def dssc_jax(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=print_version, help="Print the version and end.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", callback=silence, help="Show no progress and no notices, only errors.")
    ] = False,
) -> None:
    """How much uncertainty does this controller survive, and how do I know?

    Monte Carlo robustness of Dynamic Smooth Sliding Control and its rivals, on study files (TOML).
    """


@app.command()
def studies(as_json: opt.Json = False) -> int:
    """List the studies that can be run by name."""
    from dssc_jax.console.terminal import show_table
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
    kind: Annotated[
        str | None,
        typer.Argument(metavar="[NAME]", help="One kind of model or part, law or metric, or your own module:OBJECT."),
    ] = None,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Show versions, devices and every kind of model; or one kind's fields.

    Each kind with its fields and options, every law and metric, and the compiler of lanes. Of one kind: unit, meaning,
    admissible values and default of each field. Of a law: its arguments. Of a metric: meaning and unit.
    """
    from dssc_jax.console.environment import environment, show_environment

    if kind is not None:
        from dssc_jax.console.kinds import show_kind
        from dssc_jax.study.importing import allow_imports

        if as_json:
            raise ConfigError("--json", "covers all kinds; omit KIND")
        if allow_local:
            allow_imports(Path.cwd())
        if ":" in kind:
            show_code("command", {"kind": kind})
        show_kind(kind)
        return DONE
    machine = environment()
    if as_json:
        print(json.dumps(machine))
    else:
        show_environment(machine)
    return DONE
