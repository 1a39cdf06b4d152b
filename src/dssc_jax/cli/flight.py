"""The commands for flight computers and their logs: code, compare-log."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import (
    DONE,
    FAILS,
    app,
    assignment,
    attempt,
    default_out,
    load_study,
    output_analysis,
    save_analysis,
)
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError

if TYPE_CHECKING:
    from dssc_jax.flight_logs.reader import FlightLog
    from dssc_jax.study import Study


@app.command()
def code(
    study: opt.StudyArgument,
    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder to write.")],
    draws: Annotated[int, typer.Option("--draws", metavar="N", min=1, help="Draws to record for the bench.")] = 32,
    samples: Annotated[
        int | None, typer.Option("--samples", metavar="K", min=1, help="Samples of each draw [all, at most 2000].")
    ] = None,
    fmu: Annotated[
        bool, typer.Option("--fmu", help="Write the controller as an FMU for co-simulation (FMI 2.0) beside it.")
    ] = False,
    settings: opt.Set = None,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Write the sampled controller as C99, with a bench that compares it bit by bit with the analysis.

    Differentiator and controller of every channel come from the functions that the analysis runs. `make -C DIR`
    replays recorded draws and compares every bit; docs/flight.md tells how to do so for ARM. For float32 give
    --set loop.precision=32. With --fmu the same source becomes an FMU, with its library if there is a C compiler.
    """
    from dssc_jax.cli.compiling import built_library
    from dssc_jax.console.flight import show_code
    from dssc_jax.flight_code.folder import FlightFolder

    folder = FlightFolder(load_study(study, settings, None, None, allow_local))
    attempt(out, lambda: files.make_folder(out))
    for name, text in folder.texts().items():
        path = out / name
        attempt(path, lambda path=path, text=text: files.write_text(path, text))
    path = out / "recorded.bin"
    parts = folder.recording(draws, samples)
    attempt(path, lambda: files.write_parts(path, parts))
    written = [*folder.texts(), path.name]
    summary = folder.summary() | {"folder": str(out)}
    if fmu:
        unit = folder.fmu()
        library, reason = built_library(unit)
        packed = out / f"{unit.name}.fmu"
        attempt(packed, lambda: files.write_bytes(packed, unit.archive(library)))
        written.append(packed.name)
        summary["fmu"] = {"file": packed.name, "library": library is not None, "reason": reason}
    summary["files"] = written
    if as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        show_code(summary)
    return DONE


@app.command()
def compare_log(
    study: opt.StudyArgument,
    log: Annotated[Path, typer.Argument(metavar="LOG", help="A CSV or Parquet file, or a ULog of PX4 (.ulg).")],
    columns: Annotated[
        Path | None, typer.Option("--columns", metavar="FILE", help="Table of the log's columns, in TOML.")
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option("--column", metavar="SIGNAL=COLUMN", help="The column of a signal; may be repeated."),
    ] = None,
    start: Annotated[
        float | None,
        typer.Option("--start", metavar="T", help="Time of the log at which the study begins [its first]."),
    ] = None,
    fit: Annotated[
        bool, typer.Option("--fit", help="Estimate numbers that have laws, and propose narrower laws; --out FILE.toml.")
    ] = False,
    number: Annotated[
        list[str] | None,
        typer.Option(
            "--number", metavar="NAME", help="A number to estimate, repeatable [all that the flight identifies]."
        ),
    ] = None,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Is this logged flight one of the flights that were analysed?

    Replays the logged measurements through the analysed controller and compares its commands with the logged ones. Lays
    the log over the study's draws, tells which signal leaves their range and since when, and gives a p-value that is
    exact for any time series: the rank of the log among the draws by its largest standardised departure. Signals are
    y, y_dot, y_ref, y_ref_dot, y_ref_ddot and u_total; those of a channel x are x_y and so on. Without a table, the
    log's columns must have these names, and t. The study's [sweep] is ignored.

    With --fit the plant's numbers are estimated instead, and their laws are proposed as TOML. The exit code is 1, with
    the reason, if the flight does not identify them, or if the study does not describe the flight.
    """
    from dssc_jax.console.flight import show_log_comparison
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.flight_logs.comparison import compare_log as compare
    from dssc_jax.flight_logs.reader import read_log
    from dssc_jax.results.analysis_folder import require_free
    from dssc_jax.study import read_toml

    if number and not fit:
        raise ConfigError("--number", "is a number to estimate, and needs --fit")
    loaded = load_study(study, settings, draws, seed, allow_local).without_sweep()
    table = read_toml(columns) if columns is not None else {}
    named = dict(assignment(text, "--column") for text in column or [])
    if named:
        table = {**table, "signals": {**table.get("signals", {}), **named}}
    if start is not None:
        table = {**table, "start": start}
    try:
        flown = read_log(log, loaded.loop.channels, table)
    except ConfigError as error:
        raise error.within(str(columns)) if columns is not None and log.is_file() else error from None
    if fit:
        return fitted_laws(loaded, flown, number or [], out, as_json)
    folder = out or default_out(loaded, f"compare-log-{log.stem}", settings, draws, seed, columns, column, start)
    require_free(folder, "compare-log", loaded)
    with progress_bar(loaded, quiet=as_json, of="draws") as advance:
        answer = compare(loaded, flown, progress=advance)
    output_analysis(
        answer, {"result": folder}, save_analysis(answer, folder, check=not no_check), as_json, show_log_comparison
    )
    return DONE


def fitted_laws(study: "Study", flown: "FlightLog", names: list[str], out: Path | None, as_json: bool) -> int:
    """Estimate the numbers, print or write their laws, and say if the flight does not support that."""
    from dssc_jax.console.flight import show_fit
    from dssc_jax.console.terminal import output
    from dssc_jax.flight_logs.fit import fit_log
    from dssc_jax.flight_logs.refusals import FitRefused, NotIdentifiable

    try:
        fitted = fit_log(study, flown, names)
    except FitRefused as refusal:
        if as_json:
            verdict = {"identifiable": False} if isinstance(refusal, NotIdentifiable) else {"explained": False}
            print(json.dumps({"study": study.name, **verdict, "reason": str(refusal)}))
        else:
            output().print(str(refusal), soft_wrap=True, markup=False)
        return FAILS
    summary = fitted.summary() | {"identifiable": True, "explained": True, "file": str(out) if out else None}
    if out is not None:
        attempt(out, lambda: files.write_text(out, fitted.toml()))
    if as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        show_fit(summary)
    return DONE
