"""Commands on the theorem: check."""

import json
from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.cli.shared import DONE, FAILS, JsonOption, app


@app.command()
def check(
    design: Annotated[
        Path, typer.Argument(metavar="DESIGN", help="A design file: [bounds] with [parameters] or [free].")
    ],
    as_json: JsonOption = False,
) -> int:
    """Check Table 1's design inequalities.

    They must hold strictly over the whole interval of k_p; exit 1 otherwise.
    """
    from dssc_jax.console import jsonable, show_certificate
    from dssc_jax.design import check as check_design
    from dssc_jax.study.design_file import load_design

    found = load_design(design)
    certificate = check_design(found.parameters, found.bounds)
    if as_json:
        content = {"design": found.name, "parameters": found.parameters._asdict(), **certificate.to_dict()}
        print(json.dumps(jsonable(content), allow_nan=False))
    else:
        show_certificate(found.name, found.parameters, certificate)
    return DONE if certificate.certified else FAILS
