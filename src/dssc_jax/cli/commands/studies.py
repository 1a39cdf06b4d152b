"""dssc-jax studies: the studies that can be run by name."""

import json

from dssc_jax.cli.declarations.overview import Studies
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.console.terminal import show_table
from dssc_jax.core.errors import ConfigError
from dssc_jax.study import read_toml
from dssc_jax.study.library import available_studies


def run(options: Studies) -> int:
    """Print name, description and file of each study."""
    rows = []
    content = []
    for name, path in available_studies().items():
        try:
            description = str(read_toml(path).get("description", ""))
        except ConfigError as error:
            description = f"({error.rule})"
        rows.append((name, description, str(path)))
        content.append({"name": name, "description": description, "path": str(path)})
    if options.as_json:
        print(json.dumps({"studies": content}))
    else:
        show_table(("study", "description", "file"), rows)
    return DONE
