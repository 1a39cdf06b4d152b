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


def simulated_study(options: Run | Sweep) -> Study:
    """Load the study to simulate, here or on a cluster."""
    if options.cluster:
        spare_gpu_memory()
    return study_of(options)


def computed_result(study: Study, out: Path, options: Run | Sweep, amounts: StatedAmounts = NO_AMOUNTS) -> Result:
    """The result in a folder if it is complete, else that of a run into the folder.

    Args:
        study: The study.
        out: The results folder.
        options: Options of the command.
        amounts: Amounts by which the laws may be wrong, which are added to a complete result, too.
    """
    resume = options.resume
    if not options.fresh and (result := complete_result(study, out)) is not None:
        notify(f"{out} is complete, computed {result.manifest['started']}; --fresh computes it again")
        if not amounts or amounts == result.stated:
            return result
        resume = True
    warn_of_study(study)
    folder = str(Path(study.source).resolve().parent) if options.allow_local else None
    with progress_bar(study, quiet=options.as_json) as advance:
        return runs.run(
            study,
            out,
            resume=resume,
            progress=advance,
            cluster=options.cluster,
            notify=notify,
            local=folder,
            check=not options.no_check,
            within=amounts.within,
            shift=amounts.shift,
            widening=amounts.widening,
        )


def complete_result(study: Study, out: Path) -> Result | None:
    """The result in a folder if it is complete, of the same study, and by the same software and device; else None."""
    if not (out / MANIFEST).exists():
        return None
    try:
        if study.config.sampling == "auto":
            choice = recorded_choice(study, out, resume=False)
            if choice is None:
                return None
            study = choice.study
        manifest = read_manifest(out)
        complete = manifest["hash"] == study.hash and manifest.get("complete") and not manifest.get("stopping")
        if not complete or machinery_differences(manifest, {**computing(), **code_entries(study)}):
            return None
        return Result.of(study, read_dataset(out, study, manifest), manifest, out)
    except ConfigError:  # damaged: it is computed again
        return None


def print_result(result: Result, out: Path, as_json: bool) -> None:
    """Print a result, and then draw its figures, which takes longer."""
    warn_of_integration(result.manifest.get("integration"))
    if as_json:
        sys.stdout.writelines(line.replace("\n", "") for line in result.lines())
        print(flush=True)
    else:
        show_result(result)
    with report_write_errors(out):
        figures = plotting.save_all(result, out / "figures")
    if not as_json:
        show_figures(figures)
