"""dssc-jax info: versions, devices, and every kind of model."""

import json
from pathlib import Path

from dssc_jax.cli.declarations.overview import Info
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import announce_code
from dssc_jax.console.environment import environment, show_environment
from dssc_jax.console.kinds import described_name, show_kind
from dssc_jax.study.importing import allow_imports


def run(options: Info) -> int:
    """Show the machine and all kinds, or the fields of one kind."""
    if options.kind is not None:
        if options.allow_local:
            allow_imports(Path.cwd())
        if ":" in options.kind:
            announce_code("command", {"kind": options.kind})
        if options.as_json:
            print(json.dumps(described_name(options.kind)))
        else:
            show_kind(options.kind)
        return DONE
    description = environment()
    if options.as_json:
        print(json.dumps(description))
    else:
        show_environment(description)
    return DONE
