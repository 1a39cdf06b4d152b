"""Commands on files of other autopilots: airframe."""

import json
from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app


@app.command()
def airframe(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A PX4 airframe script, or a parameter file of a ground station.")
    ],
    as_json: opt.Json = False,
) -> int:
    """Show a PX4 airframe as the table [plant.vehicle] of a study.

    Takes the rotors' places and spins from CA_ROTOR.., and mass, inertia, thrust and lag from SIH_... Comments name
    what the file does not give.
    """
    from dssc_jax.core import files
    from dssc_jax.core.errors import errors_under
    from dssc_jax.models.uav.airframe import read_airframe
    from dssc_jax.study.tables import to_toml

    with errors_under(str(file)):
        vehicle, notes = read_airframe(files.read_text(file, errors="replace"))
    if as_json:
        print(json.dumps({"vehicle": vehicle, "notes": notes}))
    else:
        print(to_toml({"plant": {"vehicle": vehicle}}) + "".join(f"# {note}\n" for note in notes), end="")
    return DONE
