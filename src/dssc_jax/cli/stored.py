"""Commands on a results folder: verify, export."""

import json
from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, FAILS, app, load_any, load_result


@app.command()
def verify(
    result: opt.ResultArgument,
    draws: Annotated[int, typer.Option("--draws", metavar="K", help="How many lanes to compute again.")] = 16,
    seed: Annotated[int | None, typer.Option("--seed", metavar="S", help="Picks them [anew each time].")] = None,
    as_json: opt.Json = False,
    trust_code: opt.TrustCode = False,
    allow_local: opt.Local = False,
) -> int:
    """Compute a random handful of a result's lanes again, by the plain program.

    The largest relative deviation is shown. Exit 1 where it is more than rounding explains, or where every lane
    amplifies rounding so much that none is evidence. A result whose study names code of its own needs --trust-code.
    """
    from dssc_jax.console.draws import show_verification
    from dssc_jax.results.summary import jsonable
    from dssc_jax.runs.verify import verify as verify_result

    verification = verify_result(load_result(result, trust_code, allow_local), draws, seed)
    if as_json:
        print(json.dumps(jsonable({"result": str(result), **verification.to_dict()}), allow_nan=False))
    else:
        show_verification(verification)
    return DONE if verification.verified else FAILS


@app.command()
def export(
    result: opt.StoredArgument,
    to: Annotated[str, typer.Option("--to", metavar="FORMAT", help="csv, parquet, netcdf or mat.")],
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="The file [draws.csv, ... in FOLDER].")
    ] = None,
    as_json: opt.Json = False,
) -> int:
    """Write a result or an analysis for other programs, with units and meanings.

    csv and parquet: a table, of a result with one row a draw and sweep point, of an analysis with one row of its own
    kind (a draw, a controller's draw, a factor, a simulated point, ...). netcdf: the dataset, with CF attributes.
    """
    from dssc_jax.console.terminal import show_files
    from dssc_jax.results.export import export as export_result

    written = export_result(load_any(result), to, out)
    if as_json:
        print(json.dumps({"result": str(result), "files": list(map(str, written))}))
    else:
        show_files(written)
    return DONE
