"""The commands for flight computers: code."""

import json
from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app, attempt, load_study


@app.command()
def code(
    study: opt.StudyArgument,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder to write.")],
    draws: Annotated[int, typer.Option("--draws", metavar="N", min=1, help="Draws to record for the bench.")] = 32,
    samples: Annotated[
        int | None, typer.Option("--samples", metavar="K", min=1, help="Samples of each draw [all, at most 2000].")
    ] = None,
    settings: opt.Set = None,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Write the sampled controller as C99, with a bench that compares it bit by bit with the analysis.

    Differentiator and controller of every channel come from the functions that the analysis runs. `make -C DIR`
    replays recorded draws and compares every bit; docs/flight.md tells how to do so for ARM. For float32 give
    --set loop.precision=32.
    """
    from dssc_jax.console.flight import show_code
    from dssc_jax.flight.folder import FlightFolder

    folder = FlightFolder(load_study(study, settings, None, None, allow_local))
    attempt(out, lambda: out.mkdir(parents=True, exist_ok=True))
    for name, text in folder.texts().items():
        path = out / name
        attempt(path, lambda path=path, text=text: path.write_text(text, encoding="utf-8"))
    path = out / "recorded.bin"
    parts = folder.recording(draws, samples)
    with path.open("wb") as file:
        for part in parts:
            file.write(part)
    summary = folder.summary() | {"files": [*folder.texts(), path.name], "folder": str(out)}
    if as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        show_code(summary)
    return DONE
