"""dssc-jax airframe: a PX4 airframe as the table [plant] of a study."""

import json

from dssc_jax.cli.declarations.flight import Airframe
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.output import say
from dssc_jax.core import files
from dssc_jax.core.errors import errors_under
from dssc_jax.flight_logs.reading.parameters import logged_parameters
from dssc_jax.flight_logs.reading.ulog import is_ulog
from dssc_jax.models.uav.airframe import read_airframe
from dssc_jax.study.tables import to_toml


def run(options: Airframe) -> int:
    """Read the airframe, and print it as the table [plant]; comments name what is estimated or left out."""
    with errors_under(str(options.file)):
        if is_ulog(options.file):
            content = logged_parameters(options.file)
        else:
            content = files.read_text(options.file, errors="replace")
        vehicle, notes, entries, warnings = read_airframe(
            content, options.mass, options.arm, options.cascade, options.hover_speed
        )
    for warning in warnings:
        say(f"warning: {warning}")
    plant = {"kind": "uav", **entries}
    if options.as_json:
        print(json.dumps({"vehicle": vehicle, "notes": notes, "warnings": warnings, "plant": plant}))
    else:
        print(to_toml({"plant": plant | {"vehicle": vehicle}}), end="")
        for note in notes:
            print(f"# {note}")
    return DONE
