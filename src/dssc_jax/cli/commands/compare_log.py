"""dssc-jax compare-log: a logged flight beside the study's draws, or the laws that it supports."""

import json
from dataclasses import asdict

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
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import FitRefused, NotIdentifiable
from dssc_jax.flight_logs.fit.search_limits import MOST_SIMULATIONS, SearchLimits
from dssc_jax.flight_logs.next_flight import PROBABILITY, next_flight, short_log
from dssc_jax.flight_logs.reading.reader import FlightLog
from dssc_jax.flight_logs.replay import replay_log
from dssc_jax.flight_logs.signal_warnings import joined_warnings
from dssc_jax.study import Study


def run(options: CompareLog) -> int:
    """Read the log, and compare it with the draws or fit the laws to it."""
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
        return run_next_flight(study, logs, options)
    require_unset("with a single log", probability=options.probability)
    (log,) = logs
    if options.fit:
        return fit(study, log, options)
    name = f"compare-log-{options.log[0].stem}"
    folder = free_folder(study, "compare-log", options.out, *question_of(options), name=name)
    with progress_bar(study, quiet=options.as_json, of="draws") as advance:
        comparison = compare_log(study, log, progress=advance)
    finish(comparison, folder, options, show_log_comparison)
    return DONE


def question_of(options: CompareLog) -> tuple[object, ...]:
    """The options that change the question, for the name of the folder."""
    reading_options = (options.columns, options.column, options.start, options.segment, options.allow_damaged)
    return options.settings, options.draws, options.seed, *reading_options


def run_next_flight(study: Study, logs: list[FlightLog], options: CompareLog) -> int:
    """Compare several flights with the draws, and print what they tell of the next flight."""
    probability = PROBABILITY if options.probability is None else options.probability
    names = [str(path) for path in options.log]
    question = (*question_of(options), names, options.probability)
    folder = free_folder(study, "next-flight", options.out, *question)
    short = short_log(study, logs)
    if short is not None:
        length = short.end - short.start
        say(f"warning: {short.name} ends after {length:.4g} s, and all flights are compared up to there only")
    with progress_bar(study, quiet=options.as_json, of="draws") as advance:
        outlook = next_flight(study, logs, probability=probability, progress=advance)
    finish(outlook, folder, options, show_next_flight)
    return DONE


def fit(study: Study, log: FlightLog, options: CompareLog) -> int:
    """Estimate numbers from a flight, and print or write their laws, or print why the flight does not allow it."""
    out = options.out
    as_json = options.as_json
    simulations = MOST_SIMULATIONS if options.simulations is None else options.simulations
    seconds = None if options.minutes is None else 60.0 * options.minutes
    replay = replay_log(study, log)
    replay_summary = replay.summary(study)
    try:
        with progress_bar(
            study, quiet=as_json, of="simulations", early=lambda: log_fit.cut or "the search is complete"
        ) as advance:
            log_fit = fit_log(
                study,
                log,
                options.number or [],
                allow_damaged=options.allow_damaged,
                limits=SearchLimits(simulations, seconds),
                replay=replay,
                progress=advance,
            )
    except FitRefused as refusal:
        if as_json:
            verdict = {"identifiable": False} if isinstance(refusal, NotIdentifiable) else {"explained": False}
            print(json.dumps({"study": study.name, **verdict, "reason": str(refusal), **replay_summary}))
        else:
            show_replay(replay_summary, study)
            show_warnings(replay.warnings)
            show_line(str(refusal))
        return FAILS
    replay = replay._replace(hints=replay.hints._replace(starts={}))  # the fit has found that the flight starts there
    replay_summary = replay.summary(study)
    summary = log_fit.summary()
    warnings = joined_warnings(replay.warnings, log_fit.warnings)
    summary |= {"identifiable": True, "explained": True, "file": str(out) if out else None}
    summary |= replay_summary | {"warned": bool(warnings), "warnings": [asdict(warning) for warning in warnings]}
    if out is not None:
        save_text(out, log_fit.toml())
    if as_json:
        print(json.dumps(summary, allow_nan=False))
    else:
        show_replay(summary, study)
        show_fit(summary, warnings)
    return DONE
