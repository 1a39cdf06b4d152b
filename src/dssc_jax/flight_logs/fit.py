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

import numpy as np

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.flight_logs.estimates import Fitted, ResidualNoise, RivalMinimum
from dssc_jax.flight_logs.least_squares import (
    LEAST_SAMPLES,
    TINY,
    FitProblem,
    MinimumSearch,
    SampledLog,
    averaged_covariance,
    find_minima,
)
from dssc_jax.flight_logs.prediction import RANDOM, Prediction, prediction
from dssc_jax.flight_logs.reader import (
    FlightLog,
    channel_signals,
    forward_filled,
    held_samples,
    nearest_offsets,
    samples_within,
    signal_name,
)
from dssc_jax.flight_logs.refusals import (
    NotIdentifiable,
    explain,
    require_explained,
    require_identifiable,
    require_unique_minimum,
)
from dssc_jax.flight_logs.replay import replayed_channel, study_references
from dssc_jax.study import Study

PLANT_SLOTS = ("plant", "unmodelled", "actuator", "disturbance", "wind")
"""Parts of a study whose numbers show in the output for given commands."""


def fit_log(
    study: Study,
    log: FlightLog,
    names: Sequence[str] = (),
    predictions: dict[tuple[str, ...], Prediction] | None = None,
) -> Fitted:
    """Estimate numbers of a study from a logged flight.

    Args:
        study: The study; its sweep is ignored.
        log: The flight, with measured outputs, and with commands, unless a replay computes them.
        names: The numbers; none: all with laws that show in the output, less those that the flight does not identify.
        predictions: Compiled predictions to use again, by names, for logs of one length.

    Raises:
        ConfigError: a name or the log is not suitable.
        NotIdentifiable: the flight does not identify the numbers.
        Unexplained: the residual is more than noise.

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
    study = study.without_sweep()
    chosen = tuple(numbers_to_fit(study, names))
    predictions = {} if predictions is None else predictions
    sampled = sampled_log(study, log)
    kept: dict[str, float] = {}
    while True:
        if chosen not in predictions:
            predictions[chosen] = prediction(study, chosen, sampled.outputs.shape[1])
        problem = FitProblem(study, chosen, predictions[chosen], sampled)
        search = find_minima(problem)
        if search is None:
            raise NotIdentifiable("the simulated output is not finite for these commands, whatever the numbers")
        unidentified = {} if names else unidentified_numbers(problem, search)
        if not unidentified:
            return fitted_minimum(problem, search, kept)
        kept |= unidentified
        chosen = tuple(name for name in chosen if name not in unidentified)
        if not chosen:
            raise NotIdentifiable(
                f"the flight identifies none of {', '.join(kept)}: their laws are narrower than what it leaves open"
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
        decided = [follower.split(".") for follower in study.followers(name)]
        if law.movable and any(fields[0] in PLANT_SLOTS and fields[-1] not in RANDOM for fields in decided):
            names.append(name)
    if not names:
        raise ConfigError(study.source, f"has no law of {', '.join(PLANT_SLOTS)}: give a number a law to be fitted")
    return names


def sampled_log(study: Study, log: FlightLog) -> SampledLog:
    """Measured outputs with their times, and commands, of every channel.

    A command that was not logged is that of the analysed controller for the logged outputs.
    """
    loop = study.loop
    samples = max(samples_within(log, loop.sample_time, loop.steps), 1)
    references = study_references(study, samples)
    shape = (len(loop.channels), samples)
    outputs = np.full(shape, np.nan)
    offsets = np.zeros(shape)
    commands = np.zeros(shape)
    replayed = []
    held: dict[str, int] = {}
    for row, channel in enumerate(loop.channels):
        signals = channel_signals(study, log, row, references[row, 0])
        if "y" in signals:
            column = log.columns[signal_name(channel, "y")]
            offsets[row] = nearest_offsets(column, log.start, loop.sample_time, samples)
            outputs[row] = np.where(np.isfinite(offsets[row]), signals["y"], np.nan)
        command = signals.get("u_total")
        if command is not None and np.isfinite(command).any():
            commands[row] = forward_filled(command)
            held |= held_samples({signal_name(channel, "u_total"): command})
            continue
        replay = replayed_channel(study, row, signals, references[row])
        if isinstance(replay, str):
            raise ConfigError(log.name, f"has no command {signal_name(channel, 'u_total')}, and {replay}")
        commands[row] = replay
        replayed.append(channel)
    if samples < 4 or np.isfinite(outputs).sum(axis=1).max() < LEAST_SAMPLES:
        rule = f"has fewer than {LEAST_SAMPLES} values of the output y at the study's samples"
        raise ConfigError(log.name, f"{rule} in every channel" if len(loop.channels) > 1 else rule)
    return SampledLog(outputs, offsets, commands, held, tuple(replayed))


def unidentified_numbers(problem: FitProblem, search: MinimumSearch) -> dict[str, float]:
    """Numbers whose standard deviation from this flight is not below that of their law, with the ratio of the two."""
    unidentified = {}
    roots = np.sqrt(np.diag(search.best.equations.information))
    for name, root in zip(problem.names, roots, strict=True):
        width = math.inf if root == 0.0 else float(1.0 / root)
        if not width < 1.0:
            unidentified[name] = width
    return unidentified


def fitted_minimum(problem: FitProblem, search: MinimumSearch, kept: dict[str, float]) -> Fitted:
    """The estimate at the best minimum, with its covariance, if it passes all checks."""
    study = problem.study
    x = search.best.x
    channels = [study.loop.channels[readings.channel] for readings in problem.readings]
    units = [study.units[readings.channel].output for readings in problem.readings]
    results = explain(problem, x)
    for channel, unit, result in zip(channels, units, results, strict=True):
        require_explained(channel, unit, result)
    require_identifiable(problem.names, search.best.equations.information)
    require_unique_minimum(problem, search)
    posteriors = [noise_search.posterior() for noise_search in problem.noise_searches(x)]
    covariance = averaged_covariance(problem, posteriors)
    require_identifiable(problem.names, np.linalg.inv(covariance))
    noises = [ResidualNoise.of(*pair) for pair in zip(posteriors, results, strict=True)]
    rivals = []
    for rival in search.rivals:
        ratio = math.sqrt(rival.cost / max(search.best.cost, TINY))
        rivals.append(RivalMinimum(rival.starts, problem.named_values(rival.x), ratio))
    return Fitted(
        study,
        tuple(problem.names),
        problem.values(x),
        problem.scaled(x),
        covariance * np.outer(problem.widths, problem.widths),
        dict(zip(channels, noises, strict=True)),
        kept,
        sum(len(readings.values) for readings in problem.readings),
        problem.log.outputs.shape[1],
        problem.log.held,
        problem.log.replayed,
        search.starts,
        search.best.starts,
        tuple(rivals),
    )
