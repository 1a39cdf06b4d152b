"""dssc-jax run: every draw of a study at its own values."""

from dssc_jax.cli.analysing import usual_folder
from dssc_jax.cli.declarations.simulation import Run
from dssc_jax.cli.exit_codes import DONE, FAILS
from dssc_jax.cli.parsing import parse_within, require_unset
from dssc_jax.cli.running import computed_result, print_result, simulated_study
from dssc_jax.cli.warnings import warn_of_study
from dssc_jax.console.terminal import progress_bar
from dssc_jax.core.errors import ConfigError
from dssc_jax.results.stated_errors import StatedAmounts
from dssc_jax.runs.run_until import MOST_DRAWS, run_until
from dssc_jax.statistics import AcceptReject, StoppingRule, UntilWidth
from dssc_jax.study import Study


def run(options: Run) -> int:
    """Simulate the draws, or as many as a stopping rule asks for, and print the result."""
    rule = stopping_rule(options.until_width, options.accept, options.reject)
    study = simulated_study(options).without_sweep()
    if rule is not None:
        resume = options.resume or None
        require_unset("with a data-driven stop", draws=options.draws, resume=resume, cluster=options.cluster)
        return run_with_rule(study, rule, options)
    require_unset("with a fixed number of draws", max_draws=options.max_draws)
    out = options.out or usual_folder(study, "run", options.settings, options.draws, options.seed)
    amounts = StatedAmounts(parse_within(options.within), options.shift, options.widening)
    print_result(computed_result(study, out, options, amounts), out, options.as_json)
    return DONE


def stopping_rule(width: float | None, accept: float | None, reject: float | None) -> StoppingRule | None:
    """Return the stopping rule that the options describe; None if they give none, and the number of draws is fixed.

    Args:
        width: Width of the interval at which to stop (``--until-width``).
        accept: Probability below which the loop is accepted (``--accept``).
        reject: Probability above which the loop is rejected (``--reject``).

    Raises:
        ConfigError: The options contradict each other, one is missing, or a value is not valid.
    """
    if width is None and accept is None and reject is None:
        return None
    if width is not None:
        if accept is not None or reject is not None:
            raise ConfigError("--until-width", "cannot be combined with --accept and --reject")
        try:
            return UntilWidth(width)
        except ValueError as error:
            raise ConfigError("--until-width", str(error)) from None
    if accept is None or reject is None:
        raise ConfigError("--accept" if accept is None else "--reject", "is missing; the two go together")
    try:
        return AcceptReject(accept, reject)
    except ValueError as error:
        raise ConfigError("--accept", str(error)) from None


def run_with_rule(study: Study, rule: StoppingRule, options: Run) -> int:
    """Simulate draws until a stopping rule is met, and print the result.

    Args:
        study: The study, without a sweep.
        rule: The stopping rule.
        options: Options of the command.

    Returns:
        The exit code: :data:`DONE` if the interval is narrow enough, or the loop is accepted.
    """
    warn_of_study(study)
    limit = MOST_DRAWS if options.max_draws is None else options.max_draws
    out = options.out or usual_folder(study.override({"draws": limit}), f"run-{rule.slug}", limit)
    with progress_bar(study, quiet=options.as_json, early="the rule is met") as advance:
        result = run_until(
            study,
            rule,
            out,
            most=limit,
            progress=advance,
            check=not options.no_check,
            within=parse_within(options.within),
            shift=options.shift,
            widening=options.widening,
        )
    print_result(result, out, options.as_json)
    return DONE if result.manifest["stopping"]["verdict"] in ("narrow", "accepted") else FAILS
