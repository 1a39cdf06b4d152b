"""Steps that the commands run and sweep share: compute a result unless its folder is complete, and print it."""

import sys
from pathlib import Path

import dssc_jax.plotting as plotting
from dssc_jax.cli.declarations.simulation import Run, Sweep
from dssc_jax.cli.loading import spare_gpu_memory, study_of
from dssc_jax.cli.warnings import warn_of_integration, warn_of_study
from dssc_jax.console.results import show_figures, show_result
from dssc_jax.console.terminal import notify, progress_bar
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import computing
from dssc_jax.results.blocks import report_write_errors
from dssc_jax.results.manifest import MANIFEST, code_entries, machinery_differences, read_manifest
from dssc_jax.results.result import Result
from dssc_jax.results.stated_errors import StatedAmounts
from dssc_jax.results.store import read_dataset
from dssc_jax.runs import run as runs
from dssc_jax.runs.design_choice import recorded_choice
from dssc_jax.study import Study

NO_AMOUNTS = StatedAmounts({}, None, None)
"""Amounts of a user who does not state how wrong the laws may be."""


def simulated_study(options: Run | Sweep) -> Study:
    """Load the study to simulate, in this process or on a cluster.

    Raises:
        ConfigError: See :func:`study_of`.
    """
    if options.cluster:
        spare_gpu_memory()
    return study_of(options)


def computed_result(study: Study, out: Path, options: Run | Sweep, amounts: StatedAmounts = NO_AMOUNTS) -> Result:
    """Return the complete result in a folder; if there is none, run the study into the folder.

    A complete result without the stated amounts is continued, which adds them and simulates no draw again.

    Args:
        study: The study.
        out: The results folder.
        options: Options of the command.
        amounts: Amounts by which the laws may be wrong.

    Raises:
        ConfigError: The folder holds another study, cannot be written, or the study cannot run.
    """
    resume = options.resume
    result = None if options.fresh else complete_result(study, out)
    if result is not None:
        notify(f"{out} is complete, computed {result.manifest['started']}; --fresh computes it again")
        if not amounts or amounts == result.stated:
            return result
        resume = True
    warn_of_study(study)
    code_folder = str(Path(study.source).resolve().parent) if options.allow_local else None
    with progress_bar(study, quiet=options.as_json) as advance:
        return runs.run(
            study,
            out,
            resume=resume,
            progress=advance,
            cluster=options.cluster,
            notify=notify,
            local=code_folder,
            check=not options.no_check,
            within=amounts.within,
            shift=amounts.shift,
            widening=amounts.widening,
        )


def complete_result(study: Study, out: Path) -> Result | None:
    """Return the result in a folder; None if it is not complete, or differs in study, software or devices.

    Args:
        study: The study.
        out: The folder, which need not exist.
    """
    if not (out / MANIFEST).exists():
        return None
    try:
        if study.config.sampling == "auto":
            choice = recorded_choice(study, out, resume=False)
            if choice is None:
                return None
            study = choice.study
        manifest = read_manifest(out)
        if manifest["hash"] != study.hash or not manifest.get("complete"):
            return None
        if manifest.get("stopping"):  # a stopping rule chose the number of draws
            return None
        if machinery_differences(manifest, {**computing(), **code_entries(study)}):
            return None
        return Result.of(study, read_dataset(out, study, manifest), manifest, out)
    except ConfigError:  # a damaged result is computed again
        return None


def print_result(result: Result, out: Path, as_json: bool) -> None:
    """Print a result, and then save its figures, which takes longer.

    Args:
        result: The result.
        out: The results folder.
        as_json: Whether to print JSON, as one line.

    Raises:
        ConfigError: The figures cannot be written.
    """
    warn_of_integration(result.manifest.get("integration"))
    if as_json:
        for line in result.lines():
            sys.stdout.write(line.replace("\n", ""))
        print(flush=True)
    else:
        show_result(result)
    with report_write_errors(out):
        figures = plotting.save_all(result, out / "figures")
    if not as_json:
        show_figures(figures)
