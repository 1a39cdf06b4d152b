"""dssc-jax laws: how far the laws may be wrong."""

from dataclasses import replace
from pathlib import Path

from dssc_jax.analyses.laws.law_errors import laws
from dssc_jax.analyses.laws.law_ranges import law_ranges
from dssc_jax.cli.analysing import finish, free_folder
from dssc_jax.cli.declarations.statistics import Laws
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import stored_result, study_of
from dssc_jax.cli.parsing import parse_within, require_unset
from dssc_jax.console.laws import show_laws
from dssc_jax.console.ranges import show_ranges
from dssc_jax.console.terminal import progress_bar
from dssc_jax.results.result import Result
from dssc_jax.study import Study


def run(options: Laws) -> int:
    """Find how far the laws may be wrong, save and print the answer."""
    within = parse_within(options.within)
    subject = subject_of(options)
    if isinstance(subject, Study) and subject.ranged_laws:
        return run_ranges(subject, options)
    is_stored = isinstance(subject, Result)
    study = subject.study if is_stored else subject
    question = (options.limit, options.within, options.shift, options.widening, options.fresh or None)
    subject_options = (options.study if is_stored else None, options.settings, options.draws, options.seed)
    folder = free_folder(study, "laws", options.out, *question, *subject_options)
    with progress_bar(study, quiet=options.as_json, unit="simulations", compiles=not is_stored) as advance:
        errors = laws(
            subject,
            limit=options.limit,
            within=within,
            shift=options.shift,
            widening=options.widening,
            fresh=options.fresh,
            progress=advance,
        )
    if is_stored:  # its integration was checked when it was simulated
        errors.integration = subject.manifest.get("integration")
        options = replace(options, no_check=True)
    finish(errors, folder, options, show_laws)
    return DONE


def run_ranges(study: Study, options: Laws) -> int:
    """Find the failure probability over all laws within their ranges, save and print the answer.

    Args:
        study: A study in which arguments of laws are ranges.
        options: Options of the command.

    Returns:
        The exit code.

    Raises:
        ConfigError: An amount by which the laws are wrong is given.
    """
    amounts = {"within": options.within, "shift": options.shift, "widening": options.widening}
    require_unset("with laws whose arguments are ranges", **amounts)
    question = (options.limit, options.fresh or None, options.settings, options.draws, options.seed)
    folder = free_folder(study, "law-ranges", options.out, *question, ending="laws")
    with progress_bar(study, quiet=options.as_json, unit="simulations") as advance:
        ranges = law_ranges(study, limit=options.limit, fresh=options.fresh or None, progress=advance)
    options = replace(options, no_check=True)  # there is no single law whose draws could be integrated again
    finish(ranges, folder, options, show_ranges)
    return DONE


def subject_of(options: Laws) -> Result | Study:
    """Load the stored result, if the user names a folder, or else the study.

    Raises:
        ConfigError: It cannot be loaded, or a change of the study is requested of a result.
    """
    folder = Path(options.study)
    if not folder.is_dir():
        return study_of(options).without_sweep()
    require_unset("with a result", set=options.settings, draws=options.draws, seed=options.seed)
    return stored_result(folder, options.trust_code, options.allow_local, options.allow_native)
