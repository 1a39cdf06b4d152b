"""Laws of a study's numbers from a logged flight: estimates, their covariance, and what the flight cannot tell.

The residual is the logged output minus the output that the study predicts for the logged commands. In each channel it
is noise, part of which may be correlated in time; how, is estimated, too. Weighted least squares then has the
covariance (J' S^-1 J)^-1 with the noise's covariance S and the Jacobian J. It is averaged over all S that the residual
allows.

References:
    L. Ljung, System Identification: Theory for the User, 2nd ed. (1999), sections 7.4 and 9.4.
"""

import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.numerics import wrap_angle
from dssc_jax.flight_logs.comparison import forward_filled, replayed_channel, signal_name
from dssc_jax.flight_logs.estimates import Fitted, OtherMinimum, ResidualNoise
from dssc_jax.flight_logs.explanation import FitRefused, explained, require_explained
from dssc_jax.flight_logs.prediction import RANDOM, Prediction, prediction
from dssc_jax.flight_logs.reader import LOGGED, FlightLog, nearest_offsets, nearest_values, samples_within
from dssc_jax.flight_logs.replay import study_references
from dssc_jax.flight_logs.residual import (
    LEAST_SAMPLES,
    FitProblem,
    MinimumSearch,
    SampledLog,
    averaged_covariance,
    best_fit,
)
from dssc_jax.study import Study

PLANT_SLOTS = ("plant", "unmodelled", "disturbance", "wind")
"""Parts of a study whose numbers show in the output for given commands."""

SINGULAR_INFORMATION = 1e-10  # least eigenvalue of the scaled information matrix
TIE = 0.95  # level of chi squared below which two minima describe a log equally well


class NotIdentifiable(FitRefused):
    """The flight does not tell the numbers; the message says which."""


def combination(names: Sequence[str], direction: np.ndarray) -> str:
    """A direction in the space of the numbers, in words."""
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    terms = [(name, float(x)) for name, x in zip(names, direction, strict=True) if abs(x) >= 0.1]
    if len(terms) == 1:
        return terms[0][0]
    return " ".join(f"{x:+.2f} {name}" for name, x in terms) + ", each in standard deviations of its law"


def require_identifiable(names: Sequence[str], information: np.ndarray) -> None:
    """Require that the flight tells every combination of the numbers better than their laws do.

    Args:
        names: The numbers.
        information: Their information matrix, in prior widths.

    Raises:
        NotIdentifiable: a number or a combination is not told.
    """
    diagonal = np.diag(information)
    for name, own in zip(names, diagonal, strict=True):
        if own <= 1e-24 * max(float(diagonal.max()), 1e-300) or not math.isfinite(own):
            raise NotIdentifiable(f"the flight does not tell {name}: the predicted output does not depend on it")
    root = np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(information / np.outer(root, root))
    if values[0] < SINGULAR_INFORMATION:
        direction = vectors[:, 0] / root
        text = combination(names, direction / np.linalg.norm(direction))
        raise NotIdentifiable(f"the flight does not tell {text}: the information matrix is singular in this direction")
    values, vectors = np.linalg.eigh(information)
    if values[0] < 1.0:
        text = combination(names, vectors[:, 0])
        raise NotIdentifiable(
            f"the flight does not tell {text}: the standard deviation along it is {values[0] ** -0.5:.3g} times "
            "that of the law"
        )


def numbers_to_fit(study: Study, wanted: Sequence[str]) -> list[str]:
    """The numbers to estimate; without a request those with laws that show in the output.

    Raises:
        ConfigError: a number has no law, or one of single cases, or there is none.
    """
    for name in wanted:
        if name not in study.laws:
            raise ConfigError("--number", f"'{name}' has no law in this study; {nearest(name, list(study.laws))}")
        if not study.laws[name].movable:
            raise ConfigError("--number", f"'{name}' has a law of single cases, which has no derivative")
    names = list(wanted) or [
        name
        for name, law in study.laws.items()
        if name.split(".")[0] in PLANT_SLOTS and law.movable and name.split(".")[-1] not in RANDOM
    ]
    if not names:
        raise ConfigError(study.source, f"has no law of {', '.join(PLANT_SLOTS)}: give a number a law to be fitted")
    return names


def sampled_log(study: Study, log: FlightLog) -> SampledLog:
    """Measured outputs with their times, and commands, of every channel.

    A command that was not logged is that of the analysed controller for the logged outputs.

    Raises:
        ConfigError: the log has not enough measured outputs within the study's duration, or a command can be neither
            read nor replayed.
    """
    loop = study.loop
    samples = max(samples_within(log, loop.sample_time, loop.steps), 1)
    references = study_references(study, samples)
    shape = (len(loop.channels), samples)
    outputs, offsets, commands, replayed = np.full(shape, np.nan), np.zeros(shape), np.zeros(shape), []
    for row, channel in enumerate(loop.channels):
        sampled = {
            name: nearest_values(log.columns[signal], log.start, loop.sample_time, samples)
            for name in LOGGED
            if (signal := signal_name(channel, name)) in log.columns
        }
        if "y" in sampled:
            if channel in loop.plant.angles:
                desired = references[row, 0]
                sampled["y"] = desired + np.asarray(wrap_angle(sampled["y"] - desired))
            column = log.columns[signal_name(channel, "y")]
            offsets[row] = nearest_offsets(column, log.start, loop.sample_time, samples)
            outputs[row] = np.where(np.isfinite(offsets[row]), sampled["y"], np.nan)
        command = sampled.get("u_total")
        if command is not None and np.isfinite(command).any():
            commands[row] = forward_filled(command)
            continue
        answer = replayed_channel(study, row, sampled, references[row])
        if isinstance(answer, str):
            raise ConfigError(log.name, f"has no command {signal_name(channel, 'u_total')}, and {answer}")
        commands[row] = answer
        replayed.append(channel)
    if samples < 4 or np.isfinite(outputs).sum(axis=1).max() < LEAST_SAMPLES:
        rule = f"has fewer than {LEAST_SAMPLES} values of the output y at the study's samples"
        raise ConfigError(log.name, f"{rule} in every channel" if len(loop.channels) > 1 else rule)
    return SampledLog(outputs, offsets, commands, tuple(replayed))


def require_one_minimum(problem: FitProblem, search: MinimumSearch) -> tuple[OtherMinimum, ...]:
    """Require that no other minimum describes the log as well as the best one does.

    Returns:
        The other minima.

    Raises:
        NotIdentifiable: one does.
    """
    others = []
    allowed = float(stats.chi2.ppf(TIE, len(problem.names)))
    for other, starts in search.others:
        values = dict(zip(problem.names, problem.values(other.at).tolist(), strict=True))
        ratio = math.sqrt(other.step.cost / max(search.best.step.cost, 1e-300))
        others.append(OtherMinimum(starts, values, ratio))
        if other.step.cost - search.best.step.cost <= allowed:
            best = dict(zip(problem.names, problem.values(search.best.at).tolist(), strict=True))
            both = " and at ".join(
                ", ".join(f"{name} = {value:.4g}" for name, value in one.items()) for one in (best, values)
            )
            raise NotIdentifiable(
                f"the flight does not tell the numbers: two minima describe it equally well, at {both}; "
                "narrow a law to one of them, or fit fewer numbers with --number"
            )
    return tuple(others)


def fit_log(
    study: Study,
    log: FlightLog,
    names: Sequence[str] = (),
    predictions: dict[tuple[str, ...], Prediction] | None = None,
) -> Fitted:
    """Estimate numbers of a study from a logged flight.

    Args:
        study: The study; its sweep is ignored.
        log: The flight, with measured outputs, and with commands, unless a replay can tell them.
        names: The numbers; none: all with laws that show in the output, without those that the flight does not tell.
        predictions: Compiled predictions to use again, by names, for logs of one length.

    Raises:
        ConfigError: a name or the log is not suitable.
        NotIdentifiable: the flight does not tell the numbers.
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
    chosen = numbers_to_fit(study, names)
    cache = {} if predictions is None else predictions
    sampled = sampled_log(study, log)
    kept: dict[str, float] = {}
    while True:
        key = tuple(chosen)
        if key not in cache:
            cache[key] = prediction(study, key, sampled.outputs.shape[1])
        problem = FitProblem(study, key, cache[key], sampled)
        search = best_fit(problem)
        if search is None:
            raise NotIdentifiable("the simulated output is not finite for these commands, whatever the numbers")
        alone = np.sqrt(np.diag(search.best.step.information))
        widths = {name: math.inf if root == 0.0 else float(1.0 / root) for name, root in zip(key, alone, strict=True)}
        unidentified = [] if names else [name for name, width in widths.items() if not width < 1.0]
        if not unidentified:
            break
        kept |= {name: widths[name] for name in unidentified}
        chosen = [name for name in chosen if name not in unidentified]
        if not chosen:
            raise NotIdentifiable(
                f"the flight tells none of {', '.join(kept)}: their laws are narrower than what it leaves open"
            )
    return fitted_at(problem, search, kept)


def fitted_at(problem: FitProblem, search: MinimumSearch, kept: dict[str, float]) -> Fitted:
    """The estimate at the best minimum, with its covariance.

    Args:
        problem: The problem.
        search: The search for its minimum.
        kept: Numbers that keep their laws.

    Raises:
        NotIdentifiable: the flight does not tell the numbers.
        Unexplained: the residual is more than noise.
    """
    study, at = problem.study, search.best.at
    channels = [study.loop.channels[part.channel] for part in problem.readings]
    results = explained(problem, at)
    require_explained(channels, [study.units[part.channel].output for part in problem.readings], results)
    require_identifiable(problem.names, search.best.step.information)
    others = require_one_minimum(problem, search)
    posteriors = [noise.posterior() for noise in problem.searches(at)]
    covariance = averaged_covariance(problem, posteriors)
    require_identifiable(problem.names, np.linalg.inv(covariance))
    residuals = (ResidualNoise.of(*pair) for pair in zip(posteriors, results, strict=True))
    return Fitted(
        study,
        tuple(problem.names),
        problem.values(at),
        problem.middles + at * problem.widths,
        covariance * np.outer(problem.widths, problem.widths),
        dict(zip(channels, residuals, strict=True)),
        kept,
        sum(len(part.values) for part in problem.readings),
        problem.log.replayed,
        (search.starts, search.starts_here),
        others,
    )
