"""Commands that tell what there is: studies, info."""

import json

from dssc_jax.cli.shared import DONE, JsonOption, app
from dssc_jax.errors import ConfigError


@app.command()
def studies(as_json: JsonOption = False) -> int:
    """List the studies that can be run by name."""
    from dssc_jax.console import show_table
    from dssc_jax.study import read_toml
    from dssc_jax.study.library import available

    rows = []
    for name, path in available().items():
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
def info(as_json: JsonOption = False) -> int:
    """Show versions, devices and every kind of model.

    Each kind with its fields and options, and the compiler flags in force.
    """
    from dssc_jax.console import environment, show_environment

    found = environment()
    if as_json:
        print(json.dumps(found))
    else:
        show_environment(found)
    return DONE
