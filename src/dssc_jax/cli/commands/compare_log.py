"""dssc-jax compare-log: a logged flight beside the study's draws, or the laws that it supports."""

import json
from pathlib import Path

from dssc_jax.cli.analysing import attempt, finish, free_folder
from dssc_jax.cli.declarations.flight import CompareLog
from dssc_jax.cli.exit_codes import DONE, FAILS
from dssc_jax.cli.loading import study_of
from dssc_jax.cli.parsing import parse_assignment
from dssc_jax.console.flight import show_fit, show_log_comparison
from dssc_jax.console.terminal import output, progress_bar
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.comparison import compare_log
from dssc_jax.flight_logs.fit import fit_log
from dssc_jax.flight_logs.reader import FlightLog, read_log
from dssc_jax.flight_logs.refusals import FitRefused, NotIdentifiable
from dssc_jax.study import Study, read_toml


def run(options: CompareLog) -> int:
    """Read the log, and compare it with the draws or fit the laws to it."""
    if options.number and not options.fit:
        raise ConfigError("--number", "is a number to estimate, and needs --fit")
    study = study_of(options).without_sweep()
    log = logged_flight(options, study)
    if options.fit:
        return fit(study, log, options.number or [], options.out, options.as_json)
    folder = free_folder(
        study,
        "compare-log",
        f"compare-log-{options.log.stem}",
        options.out,
        options.settings,
        options.draws,
        options.seed,
        options.columns,
        options.column,
        options.start,
    )
    with progress_bar(study, quiet=options.as_json, of="draws") as advance:
        comparison = compare_log(study, log, progress=advance)
    finish(comparison, folder, options, show_log_comparison)
    return DONE


def logged_flight(options: CompareLog, study: Study) -> FlightLog:
    """The log, with the table of its columns and the options that change it."""
    table = read_toml(options.columns) if options.columns is not None else {}
    named = dict(parse_assignment(text, "--column") for text in options.column or [])
    if named:
        table = {**table, "signals": {**table.get("signals", {}), **named}}
    if options.start is not None:
        table = {**table, "start": options.start}
    try:
        return read_log(options.log, study.loop.channels, table)
    except ConfigError as error:
        if options.columns is not None and options.log.is_file():
            raise error.within(str(options.columns)) from None
        raise


def fit(study: Study, log: FlightLog, names: list[str], out: Path | None, as_json: bool) -> int:
    """Estimate the numbers, print or write their laws, and say if the flight does not support that."""
    try:
        fitted = fit_log(study, log, names)
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
