"""Laws of a study's numbers from a logged flight: estimates, covariance, and numbers that it does not identify.

The residual is the logged output minus the output that the study predicts for the logged commands. In each channel it
is noise, part of which may be correlated in time; its correlation is estimated, too. Weighted least squares then has
the covariance (J' S^-1 J)^-1 with the noise's covariance S and the Jacobian J. It is averaged over all S that the
residual allows.

References:
    L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), sections 7.4 and 9.4.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.flight_logs.command_gaps import (
    better_commands,
    command_doubts,
    command_moves,
    compared_commands,
    held_doubts,
    is_rare,
    largest_jump,
    reconstructions,
    with_commands,
)
from dssc_jax.flight_logs.coverage import time_unit_text
from dssc_jax.flight_logs.estimates import Fitted, ResidualNoise, RivalMinimum
from dssc_jax.flight_logs.first_integrals import free_integrals, require_first_integrals
from dssc_jax.flight_logs.gaps import gap_text, log_gaps
from dssc_jax.flight_logs.held_outputs import drop_repeats, usual_hold
from dssc_jax.flight_logs.late_outputs import delay_doubts
from dssc_jax.flight_logs.least_squares import (
    LEAST_SAMPLES,
    TINY,
    FitProblem,
    Minimum,
    MinimumSearch,
    averaged_covariance,
    find_minima,
)
from dssc_jax.flight_logs.outliers import outlier_doubts
from dssc_jax.flight_logs.prediction import RANDOM, Prediction, prediction
from dssc_jax.flight_logs.reader import (
    FlightLog,
    channel_signals,
    column_remedy,
    held_samples,
    nearest_offsets,
    samples_within,
    signal_name,
)
from dssc_jax.flight_logs.reading_noise import reading_noise
from dssc_jax.flight_logs.references import study_references
from dssc_jax.flight_logs.refusals import (
    NotIdentifiable,
    Unexplained,
    doubts,
    explain,
    noise_doubts,
    require_description,
    require_identifiable,
    require_unique_minimum,
)
from dssc_jax.flight_logs.replay import (
    LogReplay,
    replay_log,
    replayed_channel,
    require_same_signals,
)
from dssc_jax.flight_logs.reset_hints import require_no_jumps
from dssc_jax.flight_logs.roughness import roughness, roughness_doubts, widening
from dssc_jax.flight_logs.sampled_log import SampledLog
from dssc_jax.flight_logs.search_limits import USUAL_LIMITS, SearchCount, SearchLimits
from dssc_jax.flight_logs.start_doubts import output_start_doubts, wind_doubts
from dssc_jax.flight_logs.starts import fixed_integrals
from dssc_jax.flight_logs.width_reasons import open_numbers, widest_growth, width_reasons
from dssc_jax.study import Study

PLANT_SLOTS = ("plant", "unmodelled", "actuator", "disturbance", "wind")
"""Parts of a study whose numbers show in the output for given commands."""
LARGE_JUMP = 0.2  # of a command's range


def fit_log(
    study: Study,
    log: FlightLog,
    names: Sequence[str] = (),
    predictions: dict[tuple[str, ...], Prediction] | None = None,
    *,
    allow_damaged: bool = False,
    limits: SearchLimits = USUAL_LIMITS,
    replay: LogReplay | None = None,
    progress: ProgressCallback | None = None,
) -> Fitted:
    """Estimate numbers of a study from a logged flight.

    Args:
        study: The study; its sweep is ignored.
        log: The flight, with measured outputs, and with commands, unless a replay computes them.
        names: The numbers; none: all with laws that show in the output, less those that the flight does not identify.
        predictions: Compiled predictions to use again, by names, for logs of one length.
        allow_damaged: Whether a log that has lost messages is fitted all the same.
        limits: When the search for the minimum ends with the best so far.
        replay: The log's replay, whose commands are then checked, too; None: only its references are.
        progress: Called with the simulations done, and their largest number.

    Raises:
        ConfigError: a name or the log is not suitable; the log has lost messages, or a jump of the estimator; a signal
            of it is the study's in another unit, sign or column.
        NotIdentifiable: the flight does not identify the numbers.
        Unexplained: the residual is more than noise.
        StartsElsewhere: the integrals of an inner loop were others at the first sample.

    Example:
        >>> import dssc_jax as dj
        >>> from dssc_jax.flight_logs.reader import Column
        >>> study = dj.Study.load("motor")
        >>> run = dj.simulate(study, 3)
        >>> columns = {name: Column(run["t"].values, run[name].values) for name in ("y", "u_total")}
        >>> fitted = fit_log(study, dj.FlightLog("run", columns, 0.0), ["unmodelled.mu"])
        >>> fitted.law("unmodelled.mu").kind
        'lognormal'
    """
    if log.damaged and not allow_damaged:
        raise ConfigError(
            log.name,
            "is damaged: messages are lost, and commands are held where the flight had others. "
            "Take another log, or a part before the damage; `allow_damaged` fits it all the same",
        )
    if not allow_damaged:
        require_no_jumps(study, log)
    count = SearchCount(limits, progress)
    starting_minima: list[Minimum] = []
    study = study.without_sweep()
    fitted_names = tuple(numbers_to_fit(study, names))
    require_same_signals(log, replay_log(study, log, commands=False) if replay is None else replay)
    predictions = {} if predictions is None else predictions
    sampled = sampled_log(study, log)
    if sampled.gaps and not allow_damaged:
        raise ConfigError(
            log.name, f"{gap_text(log, sampled.gaps, study.loop.sample_time)}; `allow_damaged` fits it all the same"
        )
    unidentified_widths: dict[str, float] = {}
    reasons = ""
    all_information: Mapping[str, Mapping[str, float]] | None = None
    while True:
        if fitted_names not in predictions:
            predictions[fitted_names] = prediction(
                study, fitted_names, sampled.outputs.shape[1], fixed_integrals(study)
            )
        problem = FitProblem(study, fitted_names, predictions[fitted_names], sampled, count)
        search = find_minima(problem, starting_minima)
        if search is None:
            raise NotIdentifiable("the simulated output is not finite for these commands, whatever the numbers")
        comparisons = compared_commands(problem, search.best)
        better = better_commands(problem, search.best, comparisons)
        if better is not None:
            sampled = with_commands(sampled, better)
            starting_minima = [search.best, *search.rivals]
            continue
        information = search.best.equations.information
        if all_information is None:
            all_information = information_by_names(fitted_names, information)
        unidentified = {} if names else unidentified_numbers(problem, search)
        if not unidentified:
            try:
                added_covariance = covariance_of_unidentified(all_information, fitted_names, tuple(unidentified_widths))
                moves = command_moves(problem, search.best, comparisons)
                return fitted_minimum(problem, search, unidentified_widths, added_covariance, moves)
            except NotIdentifiable as refusal:
                if names or refusal.number is None:
                    raise
                unidentified = {refusal.number: refusal.width}
                reasons = refusal.reasons
        unidentified_widths |= unidentified
        starting_minima = search.restricted_to([name not in unidentified for name in fitted_names])
        fitted_names = tuple(name for name in fitted_names if name not in unidentified)
        if not fitted_names:
            x = search.best.x
            results = explain(problem, x)
            require_description(problem, x, results)
            doubt_texts = "".join(f". {doubt.text}" for doubt in doubts(problem, x, results))
            raise NotIdentifiable(
                f"the flight identifies none of {', '.join(unidentified_widths)}: their laws are narrower than what it "
                f"leaves open, a standard deviation that is a multiple of the law's, "
                f"{open_numbers(unidentified_widths)}. {reasons or width_reasons(problem)}{doubt_texts}"
            )


def numbers_to_fit(study: Study, requested: Sequence[str]) -> list[str]:
    """The numbers to estimate; without a request those with laws that show in the output."""
    for name in requested:
        if name not in study.laws:
            raise ConfigError("names", f"'{name}' has no law in this study; {nearest(name, list(study.laws))}")
        if not study.laws[name].movable:
            raise ConfigError("names", f"'{name}' has a law of single cases, which has no derivative")
    if requested:
        return list(requested)
    names = []
    for name, law in study.laws.items():
        paths = [follower.split(".") for follower in study.followers(name)]
        if law.movable and any(fields[0] in PLANT_SLOTS and fields[-1] not in RANDOM for fields in paths):
            names.append(name)
    if not names:
        raise ConfigError(study.source, f"has no law of {', '.join(PLANT_SLOTS)}: give a number a law to be fitted")
    return names


def sampled_log(study: Study, log: FlightLog) -> SampledLog:
    """Measured outputs, the offsets of their times, and commands of every channel, at the study's samples.

    A command that was not logged is that of the analysed controller for the logged outputs.
    """
    loop = study.loop
    samples = max(samples_within(log, loop.sample_time, loop.steps), 1)
    references = study_references(study, samples)
    shape = (len(loop.channels), samples)
    outputs = np.full(shape, np.nan)
    offsets = np.zeros(shape)
    commands = np.zeros(shape)
    replayed_channels = []
    rare_commands = []
    needed_signals = []  # signals whose gaps falsify a command
    held_counts: dict[str, int] = {}
    jumps: dict[str, float] = {}
    slow: dict[str, float] = {}
    for row, channel in enumerate(loop.channels):
        signals = channel_signals(study, log, row, references[row, 0])
        if "y" in signals:
            column = log.columns[signal_name(channel, "y")]
            offsets[row] = nearest_offsets(column, log.start, loop.sample_time, samples)
            outputs[row] = np.where(np.isfinite(offsets[row]), signals["y"], np.nan)
            hold = usual_hold(outputs[row])
            if hold > 1:
                outputs[row] = drop_repeats(outputs[row])
                slow[signal_name(channel, "y")] = hold * loop.sample_time
        command = signals.get("u_total")
        if command is not None and np.isfinite(command).any():
            commands[row] = command
            if is_rare(command):
                rare_commands.append(signal_name(channel, "u_total"))
            needed_signals.append(signal_name(channel, "u_total"))
            held_counts |= held_samples({signal_name(channel, "u_total"): command})
            jump = largest_jump(command)
            if jump > LARGE_JUMP * np.nanmax(command) - LARGE_JUMP * np.nanmin(command):
                jumps[signal_name(channel, "u_total")] = jump
            continue
        replay = replayed_channel(study, row, signals, references[row])
        if isinstance(replay, str):
            name = signal_name(channel, "u_total")
            raise ConfigError(log.name, f"has no command {name}, and {replay}; {column_remedy(channel, 'u_total')}")
        commands[row] = replay
        replayed_channels.append(channel)
        needed_signals += [signal_name(channel, name) for name in signals if name.startswith("y")]
    if samples < 4 or np.isfinite(outputs).sum(axis=1).max() < LEAST_SAMPLES:
        rule = f"has fewer than {LEAST_SAMPLES} values of the output y at the study's samples"
        place = " in every channel" if len(loop.channels) > 1 else ""
        raise ConfigError(log.name, f"{rule}{place}{time_unit_text(log, loop.sample_time)}")
    end = log.start + (samples - 1) * loop.sample_time
    reconstruction, *alternatives = reconstructions(list(commands))
    gaps = log_gaps(log, needed_signals, end)
    return SampledLog(
        outputs=outputs,
        offsets=offsets,
        commands=reconstruction.commands,
        held_samples=held_counts,
        replayed=tuple(replayed_channels),
        jumps=jumps,
        gaps=gaps,
        rare=tuple(rare_commands),
        between=reconstruction.text,
        sensor_noise=reading_noise(study, outputs),
        alternatives=tuple(alternatives),
        slow=slow,
    )


def information_by_names(names: Sequence[str], information: np.ndarray) -> dict[str, dict[str, float]]:
    """The information matrix by pairs of names."""
    return {name: dict(zip(names, map(float, row), strict=True)) for name, row in zip(names, information, strict=True)}


def covariance_of_unidentified(
    information: Mapping[str, Mapping[str, float]], fitted_names: Sequence[str], unidentified: Sequence[str]
) -> np.ndarray:
    """The covariance that unidentified numbers, which keep their laws, add to the fitted ones, shape (p, p).

    An unidentified number that differs from its median by d moves the estimates by -A^-1 B d, where A and B are the
    blocks of the information of all numbers. In coordinates of the fit d has the variance 1.
    """
    inner = np.array([[information[row][column] for column in fitted_names] for row in fitted_names])
    if not unidentified:
        return np.zeros_like(inner)
    coupling = np.array([[information[row][column] for column in unidentified] for row in fitted_names])
    moves = np.linalg.lstsq(inner, coupling, rcond=None)[0]
    return moves @ moves.T


def unidentified_numbers(problem: FitProblem, search: MinimumSearch) -> dict[str, float]:
    """Numbers whose standard deviation from this flight is not below that of their law, with the ratio of the two."""
    unidentified = {}
    information = search.best.equations.information
    information_roots = np.sqrt(np.diag(information))
    for name, root in zip(problem.names, information_roots, strict=True):
        width = math.inf if root == 0.0 else float(1.0 / root)
        if not width < 1.0:
            unidentified[name] = width
    return unidentified


def fitted_minimum(
    problem: FitProblem,
    search: MinimumSearch,
    unidentified_widths: dict[str, float],
    added_covariance: np.ndarray,
    moves: np.ndarray,
) -> Fitted:
    """The estimate at the best minimum, with its covariance, if it passes all checks.

    Args:
        problem: The problem.
        search: Its minima.
        unidentified_widths: Numbers that keep their laws, with the width that the flight leaves over that of the law.
        added_covariance: What they add to the covariance, shape (p, p).
        moves: How far other commands that may have flown move the coordinates, shape (k, p).
    """
    study = problem.study
    x = search.best.x
    channels = [study.loop.channels[readings.channel] for readings in problem.readings]
    results = explain(problem, x)
    try:
        require_description(problem, x, results)
    except Unexplained as refusal:
        causes = (
            *output_start_doubts(problem, x, results),
            *outlier_doubts(problem, x),
            *delay_doubts(problem, search.best),
        )
        reasons = "".join(f". {doubt.text}" for doubt in causes)
        raise Unexplained(f"{refusal}{reasons}") from None
    require_identifiable(problem.names, search.best.equations.information)
    require_first_integrals(free_integrals(problem, search.best))
    posteriors = [noise_search.posterior() for noise_search in problem.noise_searches(x)]
    rough = roughness(problem, search.best)
    doubts_of_delays = delay_doubts(problem, search.best)
    covariance = widening(rough) * averaged_covariance(problem, posteriors) + added_covariance
    doubts_of_commands = command_doubts(problem, moves, np.sqrt(np.diag(covariance)))
    growth = widest_growth(covariance, covariance + moves.T @ moves)
    covariance = covariance + moves.T @ moves
    information = np.linalg.inv(covariance)
    try:
        require_identifiable(problem.names, information)
    except NotIdentifiable as refusal:
        raise refusal.with_reasons(width_reasons(problem, rough, growth)) from None
    require_unique_minimum(problem, search, information)
    doubts_of_outliers = outlier_doubts(problem, x)
    with_outliers = {doubt.signal for doubt in doubts_of_outliers}
    noises = [ResidualNoise.of(*pair) for pair in zip(posteriors, results, strict=True)]
    rivals = []
    for rival in search.rivals:
        ratio = math.sqrt(rival.cost / max(search.best.cost, TINY))
        rivals.append(RivalMinimum(rival.starts, problem.named_values(rival.x), ratio))
    return Fitted(
        study=study,
        names=tuple(problem.names),
        estimates=problem.values(x),
        scaled=problem.scaled(x),
        covariance=covariance * np.outer(problem.widths, problem.widths),
        noise=dict(zip(channels, noises, strict=True)),
        unidentified=unidentified_widths,
        samples=sum(len(readings.values) for readings in problem.readings),
        simulated=problem.log.outputs.shape[1],
        held_samples=problem.log.held_samples,
        between=problem.log.between,
        replayed=problem.log.replayed,
        starts=search.starts,
        starts_here=search.best.starts,
        rivals=tuple(rivals),
        simulations=problem.count.simulations,
        cut=problem.count.reason,
        doubts=(
            *doubts(problem, x, results),
            *output_start_doubts(problem, x, results),
            *doubts_of_outliers,
            *(doubt for doubt in noise_doubts(problem, x, results) if doubt.signal not in with_outliers),
            *doubts_of_delays,
            *held_doubts(problem.log),
            *doubts_of_commands,
            *wind_doubts(study),
            *roughness_doubts(rough),
        ),
    )
