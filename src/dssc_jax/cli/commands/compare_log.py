"""dssc-jax compare-log: logged flights beside the study's draws, or the laws that a flight supports."""

import json
from dataclasses import asdict, replace

from dssc_jax.cli.analysing import finish, free_folder, save_text
from dssc_jax.cli.declarations.flight import CompareLog
from dssc_jax.cli.exit_codes import DONE, FAILS
from dssc_jax.cli.loading import study_of
from dssc_jax.cli.logs import logged_flight
from dssc_jax.cli.output import say
from dssc_jax.cli.parsing import require_unset
from dssc_jax.console.flight import show_fit, show_log_comparison, show_next_flight, show_replay, show_warnings
from dssc_jax.console.terminal import progress_bar, show_line
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.comparison import compare_log
from dssc_jax.flight_logs.fit.estimates import Fitted
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import FitRefused, NotIdentifiable
from dssc_jax.flight_logs.fit.search_limits import MOST_SIMULATIONS, SearchLimits
from dssc_jax.flight_logs.next_flight import PROBABILITY, next_flight, short_log
from dssc_jax.flight_logs.reading.reader import FlightLog
from dssc_jax.flight_logs.replay import LogReplay, replay_log
from dssc_jax.flight_logs.signal_warnings import fault_text, joined_warnings
from dssc_jax.study import Study


def run(options: CompareLog) -> int:
    """Read the logs, and compare them with the draws or fit the laws to a single one."""
    if options.number and not options.fit:
        raise ConfigError("--number", "is a number to estimate, and needs --fit")
    if not options.fit:
        require_unset(
            "with a comparison without --fit",
            simulations=options.simulations,
            minutes=options.minutes,
        )
    study = study_of(options).without_sweep()
    logs = [logged_flight(options, path, study) for path in options.log]
    if len(logs) > 1:
        require_unset("with several logs", fit=options.fit or None)
        return compare_flights(study, logs, options)
    require_unset("with a single log", probability=options.probability)
    (log,) = logs
    if options.fit:
        return fit(study, log, options)
    name = f"compare-log-{options.log[0].stem}"
    folder = free_folder(study, "compare-log", options.out, *question_of(options), ending=name)
    with progress_bar(study, quiet=options.as_json, unit="draws") as advance:
        comparison = compare_log(study, log, progress=advance)
    finish(comparison, folder, options, show_log_comparison)
    return DONE


def question_of(options: CompareLog) -> tuple[object, ...]:
    """Return the options that change the answer, which enter the name of the folder."""
    reading_options = (options.columns, options.column, options.start, options.segment, options.allow_damaged)
    return options.settings, options.draws, options.seed, *reading_options


def compare_flights(study: Study, logs: list[FlightLog], options: CompareLog) -> int:
    """Compare several flights with the draws, and print what they tell of the next flight.

    Args:
        study: The study, without a sweep.
        logs: The flights, at least two.
        options: Options of the command.

    Returns:
        The exit code.
    """
    probability = PROBABILITY if options.probability is None else options.probability
    names = [str(path) for path in options.log]
    question = (*question_of(options), names, options.probability)
    folder = free_folder(study, "next-flight", options.out, *question)
    short = short_log(study, logs)
    if short is not None:
        length = short.end - short.start
        say(f"warning: {short.name} ends after {length:.4g} s, and all flights are compared up to there only")
    with progress_bar(study, quiet=options.as_json, unit="draws") as advance:
        outlook = next_flight(study, logs, probability=probability, progress=advance)
    finish(outlook, folder, options, show_next_flight)
    return DONE


def fit(study: Study, log: FlightLog, options: CompareLog) -> int:
    """Estimate numbers from a flight, and print or write their laws, or print why the flight does not allow it.

    Args:
        study: The study, without a sweep.
        log: The flight.
        options: Options of the command.

    Returns:
        The exit code: :data:`FAILS` if the fit is refused.
    """
    simulations = MOST_SIMULATIONS if options.simulations is None else options.simulations
    seconds = None if options.minutes is None else 60.0 * options.minutes
    replay = replay_log(study, log)

    def why_early() -> str:
        """The reason why the search ended early; the progress bar asks for it once the fit is done."""
        return fitted.cut or "the search is complete"

    try:
        with progress_bar(study, quiet=options.as_json, unit="simulations", early=why_early) as advance:
            fitted = fit_log(
                study,
                log,
                options.number or [],
                allow_damaged=options.allow_damaged,
                limits=SearchLimits(simulations, seconds),
                replay=replay,
                progress=advance,
            )
    except FitRefused as refusal:
        print_refusal(refusal, study, replay, options)
        return FAILS
    if options.out is not None:
        save_text(options.out, fitted.toml())
    print_fit(fitted, study, replay, options)
    return DONE


def print_refusal(refusal: FitRefused, study: Study, replay: LogReplay, options: CompareLog) -> None:
    """Print why a flight does not allow a fit, and how the replayed commands differ from the logged ones.

    Args:
        refusal: The reason.
        study: The study.
        replay: Replay of the flight.
        options: Options of the command.
    """
    replay_summary = replay.summary(study)
    is_undetermined = isinstance(refusal, NotIdentifiable)
    told = {(cause.signal, cause.code) for cause in refusal.causes}
    others = [warning for warning in replay.warnings if (warning.signal, warning.code) not in told]
    reason = str(refusal) if is_undetermined else f"{refusal}{fault_text(others)}"
    if options.as_json:
        verdict = {"identifiable": False} if is_undetermined else {"explained": False}
        print(json.dumps({"study": study.name, **verdict, "reason": reason, **replay_summary}))
    else:
        show_replay(replay_summary, study)
        show_warnings(replay.warnings)
        show_line(reason)


def print_fit(fitted: Fitted, study: Study, replay: LogReplay, options: CompareLog) -> None:
    """Print the estimates and laws of a fit, and how the replayed commands differ from the logged ones.

    Args:
        fitted: The fit.
        study: The study.
        replay: Replay of the flight.
        options: Options of the command.
    """
    # hints on starts doubt that the flight starts where the study does, and the fit has found that it does
    replay = replay._replace(hints=replace(replay.hints, starts={}))
    warnings = joined_warnings(replay.warnings, fitted.warnings)
    summary = fitted.summary()
    summary |= {"identifiable": True, "explained": True, "file": str(options.out) if options.out else None}
    summary |= replay.summary(study)
    summary |= {"warned": bool(warnings), "warnings": [asdict(warning) for warning in warnings]}
    if options.as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        show_replay(summary, study)
        show_fit(summary, warnings)
