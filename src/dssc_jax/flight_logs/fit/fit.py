"""Laws of a study's numbers from a logged flight: estimates, covariance, and numbers that it does not identify.

The residual is the logged output minus the output that the study predicts for the logged commands. In each channel it
is noise, part of which may be correlated in time; its correlation is estimated, too. Weighted least squares then has
the covariance (J' S^-1 J)^-1 with the noise's covariance S and the Jacobian J. It is averaged over all S that the
residual allows.

References:
    L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), sections 7.4 and 9.4.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.flight_logs.fit.command_gaps import (
    better_commands,
    command_doubts,
    command_moves,
    compared_commands,
    freed_doubts,
    held_doubts,
    rare_doubts,
    with_commands,
)
from dssc_jax.flight_logs.fit.declared_noise import declared_covariance, larger_covariance
from dssc_jax.flight_logs.fit.estimates import Fitted, ResidualNoise, RivalMinimum, correlation_doubts
from dssc_jax.flight_logs.fit.first_integrals import free_integrals, starts_elsewhere
from dssc_jax.flight_logs.fit.fitted_numbers import insensitive_numbers, numbers_to_fit, require_stated_times
from dssc_jax.flight_logs.fit.freed_commands import freed_commands
from dssc_jax.flight_logs.fit.late_outputs import late_output
from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem, averaged_covariance
from dssc_jax.flight_logs.fit.log_sampling import sampled_log
from dssc_jax.flight_logs.fit.minima import Minimum, MinimumSearch, find_minima
from dssc_jax.flight_logs.fit.possible_values import require_plausible, require_possible
from dssc_jax.flight_logs.fit.prediction import Prediction, prediction
from dssc_jax.flight_logs.fit.refusals import (
    Explained,
    NotIdentifiable,
    Unexplained,
    conversion_hint,
    doubts,
    explain,
    refusal_text,
    require_identifiable,
    require_unique_minimum,
    unexplained_place,
)
from dssc_jax.flight_logs.fit.remaining_residuals import certain_delay
from dssc_jax.flight_logs.fit.residual_advice import advice_text
from dssc_jax.flight_logs.fit.residual_causes import doubts_of_estimates, refusal_causes
from dssc_jax.flight_logs.fit.roughness import roughness, roughness_doubts, widening
from dssc_jax.flight_logs.fit.search_limits import USUAL_LIMITS, SearchCount, SearchLimits
from dssc_jax.flight_logs.fit.start_doubts import wind_doubts
from dssc_jax.flight_logs.fit.unidentified import UnidentifiedNumbers
from dssc_jax.flight_logs.fit.width_reasons import open_numbers, widest_growth, width_reasons
from dssc_jax.flight_logs.fit.wrapped_outputs import column_causes
from dssc_jax.flight_logs.hints.reset_hints import require_no_jumps
from dssc_jax.flight_logs.hints.starts import fixed_integrals
from dssc_jax.flight_logs.reading.gaps import gap_text
from dssc_jax.flight_logs.reading.reader import FlightLog
from dssc_jax.flight_logs.replay import LogReplay, replay_log, require_same_signals
from dssc_jax.flight_logs.signal_warnings import SignalWarning, possible_causes
from dssc_jax.study import Study


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
        names: The numbers to estimate. Empty: all numbers with laws that show in the output, without those that the
            flight does not identify.
        predictions: Compiled predictions by names of the numbers, which the fit uses and adds to; logs that share them
            have the same length.
        allow_damaged: Whether a log that has lost messages is fitted all the same.
        limits: When the search for the minimum ends with the best so far.
        replay: A replay of the log, to check the logged commands as well as the references; None: the fit replays the
            references alone.
        progress: Called with the number of simulations done, and the largest number allowed.

    Raises:
        ConfigError: a name or the log is not suitable; the log has lost messages, or a jump of the estimator; a signal
            of it is the study's in another unit, sign or column.
        NotIdentifiable: the flight does not identify the numbers.
        Unexplained: the residual is more than noise.
        StartsElsewhere: the integrals of an inner loop were others at the first sample.

    Example:
        >>> import dssc_jax as dj
        >>> from dssc_jax.flight_logs.reading.reader import Column
        >>> study = dj.Study.load("motor")
        >>> run = dj.simulate(study, 3)
        >>> columns = {name: Column(run["t"].values, run[name].values) for name in ("y", "u_total")}
        >>> fitted = fit_log(study, dj.FlightLog("run", columns, 0.0), ["unmodelled.mu"])
        >>> fitted.law("unmodelled.mu").kind
        'lognormal'
    """
    if not allow_damaged:
        require_undamaged(study, log)
    study = study.without_sweep()
    candidates = tuple(numbers_to_fit(study, names))
    require_stated_times(study, candidates)
    replay = replay_log(study, log, commands=False) if replay is None else replay
    require_same_signals(log, replay)
    known = possible_causes(replay.warnings)
    predictions = {} if predictions is None else predictions
    sampled = sampled_log(study, log)
    if sampled.gaps and not allow_damaged:
        raise ConfigError(
            log.name, f"{gap_text(log, sampled.gaps, study.loop.sample_time)}; `allow_damaged` fits it all the same"
        )
    if candidates not in predictions:
        predictions[candidates] = prediction(study, candidates, sampled.outputs.shape[1], fixed_integrals(study))
    problem = FitProblem(study, candidates, predictions[candidates], sampled, SearchCount(limits, progress))
    starting_minima: list[Minimum] = []
    unidentified = UnidentifiedNumbers()
    while True:
        search = find_minima(problem, starting_minima)
        if search is None:
            raise NotIdentifiable("the simulated output is not finite for these commands, whatever the numbers")
        starting_minima = [search.best, *search.rivals]
        comparisons = compared_commands(problem, search.best)
        better = better_commands(problem, search.best, comparisons)
        if better is not None:
            problem = replace(problem, log=with_commands(problem.log, better))
            continue
        freed = freed_commands(problem, search.best)
        if freed is not None:
            problem = freed
            continue
        insensitive = {} if names else insensitive_numbers(problem, search.best)
        if not unidentified.update_insensitive(insensitive):
            try:
                moves = command_moves(problem, search.best, comparisons)
                return fitted_minimum(problem, search, unidentified.kept_widths, moves, known)
            except NotIdentifiable as refusal:
                if names or refusal.number is None:
                    raise
                unidentified.add(refusal.number, refusal)
        if unidentified.kept.issuperset(candidates):
            raise none_identified(problem, search.best, unidentified, known)
        problem = problem.keeping(unidentified.kept)
        starting_minima = [at_medians(minimum, problem.is_kept) for minimum in starting_minima]


def at_medians(minimum: Minimum, is_kept: np.ndarray) -> Minimum:
    """A minimum as the start of another search, moved to the medians along the numbers that keep their laws.

    Args:
        minimum: The minimum.
        is_kept: Whether each number keeps its law, shape (p,).
    """
    return minimum._replace(x=np.where(is_kept, 0.0, minimum.x))


def require_undamaged(study: Study, log: FlightLog) -> None:
    """Require a log that has lost no messages and has no jump of the estimator.

    Raises:
        ConfigError: The log has lost messages, or has a jump of the estimator.
    """
    if log.damaged:
        raise ConfigError(
            log.name,
            "is damaged: messages are lost, and commands are held where the flight had others. "
            "Take another log, or a part before the damage; `allow_damaged` fits it all the same",
        )
    require_no_jumps(study, log)


def marginal_information(information: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """The information on f numbers while all others, which keep their laws, are free within these; shape (f, f).

    It is the Schur complement of the block of the other numbers.

    Args:
        information: The information on all numbers, including that of the laws that are kept, shape (p, p).
        positions: Positions of the f numbers.
    """
    others = np.setdiff1d(np.arange(len(information)), positions)
    coupling = information[np.ix_(others, positions)]
    shared = coupling.T @ np.linalg.solve(information[np.ix_(others, others)], coupling)
    return information[np.ix_(positions, positions)] - shared


def none_identified(
    problem: FitProblem, best: Minimum, unidentified: UnidentifiedNumbers, known: tuple[SignalWarning, ...]
) -> NotIdentifiable:
    """The refusal of a flight that identifies none of the numbers.

    Args:
        problem: The last problem, with the noise of its minimum.
        best: The minimum of that problem.
        unidentified: The numbers with their widths.
        known: Warnings by the replay of the log that may explain a residual.

    Raises:
        Unexplained: The residual is more than noise.
    """
    results = explain(problem, best.x)
    require_explained(problem, best, results)
    causes = column_causes(problem, best)
    causes = (*causes, *doubts(problem, best.x, results, (*causes, *known)))
    doubt_texts = "".join(f". {doubt.text}" for doubt in causes)
    return NotIdentifiable(
        f"the flight identifies none of {', '.join(unidentified.widths)}: their laws are narrower than what it leaves "
        f"open, a standard deviation that is a multiple of the law's, {open_numbers(unidentified.widths)}. "
        f"{unidentified.reasons or width_reasons(problem)}{doubt_texts}"
    )


def require_explained(problem: FitProblem, best: Minimum, results: list[Explained]) -> None:
    """Require that the residual is noise.

    Args:
        problem: The least-squares problem of the log.
        best: The best minimum of the problem.
        results: How well the study describes each channel at that minimum.

    Raises:
        Unexplained: The residual of a channel is more than noise; the message has the likely causes.
    """
    place = unexplained_place(results)
    if place is None:
        return
    causes = column_causes(problem, best)
    is_explained = False
    if not causes:
        causes, is_explained = refusal_causes(problem, best, results)
    if not is_explained:
        causes = (*causes, *rare_doubts(problem.log), *held_doubts(problem.log))
    hint = "" if is_explained else conversion_hint(problem, best.x, place)
    advice = advice_text(problem.study, hint, causes)
    raise Unexplained(f"{refusal_text(problem, best.x, place, results[place])}{advice}", causes)


def fitted_minimum(
    problem: FitProblem,
    search: MinimumSearch,
    unidentified_widths: dict[str, float],
    moves: np.ndarray,
    known: tuple[SignalWarning, ...],
) -> Fitted:
    """The estimate at the best minimum, with its covariance, if it passes all checks.

    Args:
        problem: The least-squares problem of the log.
        search: The minima of the problem.
        unidentified_widths: Numbers that keep their laws, with the width that the flight leaves over that of the law.
        moves: How far other commands that may have flown move the coordinates, shape (k, p).
        known: Warnings by the replay of the log that may explain a residual.

    Raises:
        Unexplained: The residual is more than noise, or a number has an impossible value.
        NotIdentifiable: The flight does not identify the numbers.
        StartsElsewhere: The integrals of an inner loop were others at the first sample.
    """
    study = problem.study
    x = search.best.x
    channels = [study.loop.channels[readings.channel] for readings in problem.readings]
    results = explain(problem, x)
    require_explained(problem, search.best, results)
    require_plausible(problem, x, results)
    require_possible(problem, x, results)
    fitted = problem.fitted
    fitted_names = problem.fitted_names
    require_identifiable(fitted_names, marginal_information(search.best.equations.information, fitted))
    integrals = free_integrals(problem, search.best)
    delay = None
    if integrals is not None and integrals.differ_and_matter:
        lateness = None if problem.count.reason else late_output(problem, search.best)
        delay = certain_delay(problem, lateness, results)
        if delay is None or integrals.leave_less_than(delay):
            raise starts_elsewhere(study, integrals)
    posteriors = [noise_search.posterior() for noise_search in problem.noise_searches(x)]
    rough = roughness(problem, search.best)
    covariance = averaged_covariance(problem, posteriors, x)
    covariance = widening(rough) * larger_covariance(covariance, declared_covariance(problem, search.best))
    covariance = covariance[np.ix_(fitted, fitted)]
    moves = moves[:, fitted]
    doubts_of_commands = command_doubts(problem, moves, np.sqrt(np.diag(covariance)))
    growth = widest_growth(covariance, covariance + moves.T @ moves)
    covariance = covariance + moves.T @ moves
    information = np.linalg.inv(covariance)
    try:
        require_identifiable(fitted_names, information)
    except NotIdentifiable as refusal:
        raise refusal.with_reasons(width_reasons(problem, rough, growth)) from None
    require_unique_minimum(problem, search, information)
    noises = [ResidualNoise.of(*pair) for pair in zip(posteriors, results, strict=True)]
    noise_by_channel = dict(zip(channels, noises, strict=True))
    doubts_of_residuals = (
        *doubts_of_estimates(problem, search.best, results, np.sqrt(np.diag(covariance)), known, delay),
        *held_doubts(problem.log),
        *freed_doubts(problem.log),
        *doubts_of_commands,
    )
    return Fitted(
        study=study,
        names=tuple(fitted_names),
        estimates=problem.values(x)[fitted],
        scaled=problem.scaled(x)[fitted],
        covariance=covariance * np.outer(problem.widths[fitted], problem.widths[fitted]),
        noise=noise_by_channel,
        unidentified=unidentified_widths,
        samples=sum(len(readings.values) for readings in problem.readings),
        simulated=problem.log.outputs.shape[1],
        held_samples=problem.log.held_samples,
        between=problem.log.between,
        replayed=problem.log.replayed,
        starts=search.starts,
        starts_here=search.best.starts,
        rivals=rival_minima(problem, search),
        simulations=problem.count.simulations,
        cut=problem.count.reason,
        stopped=problem.count.is_stopped,
        doubts=(
            *doubts_of_residuals,
            *(() if doubts_of_residuals else correlation_doubts(study, noise_by_channel)),
            *wind_doubts(study),
            *roughness_doubts(rough),
        ),
    )


def rival_minima(problem: FitProblem, search: MinimumSearch) -> tuple[RivalMinimum, ...]:
    """The minima of a search that are not its best one."""
    rivals = []
    for rival in search.rivals:
        ratio = math.sqrt(rival.cost / max(search.best.cost, TINY))
        rivals.append(RivalMinimum(rival.starts, problem.named_values(rival.x), ratio))
    return tuple(rivals)
