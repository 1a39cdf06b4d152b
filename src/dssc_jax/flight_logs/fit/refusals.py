"""The checks that a fit of a logged flight has to pass; the message of a refusal says what is wrong with the flight.

The residual's mean square r^2 consists of the noise's, n^2, and of what the study does not describe. The share of the
output's variance v that the study leaves unexplained is (r^2 - n^2)/v. The mean square of correlated noise has nearly
the law of chi squared with as many degrees of freedom as there are independent samples, which gives the share a lower
confidence limit.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.core.flag_runs import flag_runs
from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem, Readings
from dssc_jax.flight_logs.fit.minima import MinimumSearch
from dssc_jax.flight_logs.fit.prediction import NoiseProgram
from dssc_jax.flight_logs.fit.residual_advice import REMEDY, cause_text
from dssc_jax.flight_logs.hints.conversions import likeness_text
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning
from dssc_jax.statistics.correlated_noise import Noise, independent_samples

MOST_UNEXPLAINED = 0.1  # largest share of the output's variance that a fit may leave unexplained
EXPLAINED_CONFIDENCE = 0.95  # confidence that a refused fit leaves more than that
MUCH_LARGER = 1.25  # than what noise explains of a residual: a larger residual is doubted
NOISE_CONFIDENCE = 0.9999  # confidence that noise alone is no larger than its limit
NOISE_DEVIATIONS = 4.0  # standard deviations of the sizes of simulated noise, from their mean up to their limit
LEAST_DOUBTED = 1e-5  # share of the output's variance left unexplained, in a residual that is doubted
NOISIER = 3.0  # than the study's sensor: a residual with as much noise is doubted
NOISE_REPLICATES = 16  # simulations of the study's noise
SINGULAR_INFORMATION = 1e-10  # least eigenvalue of the scaled information matrix
SMALL_COEFFICIENT = 0.1  # least coefficient of a number that a message names in a combination
TIE = 0.95  # level of chi squared below which two minima describe a log equally well


class FitRefused(ValueError):
    """A flight does not support a fit; the message says why."""

    causes: tuple[SignalWarning, ...] = ()
    """Likely causes, which the message tells."""


class NotIdentifiable(FitRefused):
    """The flight does not identify the numbers, or a combination of them; the message says which.

    Args:
        message: The reason.
        number: The number with the largest coefficient in the combination; None: no single number is to blame.
        width: Standard deviation of the combination, relative to that of the laws.
        reasons: Why the combination is so wide, and what to do; the message ends with this text.
    """

    def __init__(self, message: str, number: str | None = None, width: float = math.inf, reasons: str = "") -> None:
        super().__init__(f"{message}. {reasons}" if reasons else message)
        self.number = number
        self.width = width
        self.reasons = reasons

    def with_reasons(self, reasons: str) -> "NotIdentifiable":
        """The same refusal, with reasons at the end of its message."""
        return NotIdentifiable(str(self), self.number, self.width, reasons)


class Unexplained(FitRefused):
    """The residual is more than noise; the message has the numbers.

    Args:
        message: The reason.
        causes: Likely causes, which the message tells.
    """

    def __init__(self, message: str, causes: tuple[SignalWarning, ...] = ()) -> None:
        super().__init__(message)
        self.causes = causes


class Explained(NamedTuple):
    """How well the simulated output of a channel describes the log; sizes are in the output's unit."""

    residual: float  # root mean square of the residual
    noise: float  # root mean square of the noise that log and study account for
    output: float  # standard deviation of the logged output
    independent: float  # number of independent samples of the residual
    limit: float  # root mean square of the residual that noise alone hardly exceeds
    reading_noise: float  # root mean square of the noise from one reading to the next

    @property
    def unexplained(self) -> float:
        """Share of the output's variance that neither the simulated output nor noise explains."""
        return self.unexplained_by(self.residual)

    def unexplained_by(self, residual: float) -> float:
        """Share of the output's variance that a residual of another size leaves unexplained, as of another fit."""
        return max(residual**2 - self.noise**2, 0.0) / max(self.output**2, TINY)

    @property
    def least_unexplained(self) -> float:
        """Lower confidence limit of ``unexplained``, by the law of chi squared of the residual's mean square."""
        largest = float(stats.chi2.ppf(EXPLAINED_CONFIDENCE, self.independent)) / self.independent
        return self.unexplained_by(self.residual / math.sqrt(largest))

    @property
    def is_doubtful(self) -> bool:
        """Whether the residual is clearly larger than noise explains, and leaves more than ``LEAST_DOUBTED``."""
        return self.residual > max(MUCH_LARGER * self.noise, self.limit) and self.unexplained > LEAST_DOUBTED


def noise_between_neighbours(times: np.ndarray, values: np.ndarray) -> float:
    """Standard deviation of a series about the straight line between each reading's two neighbours.

    White noise of variance 1 has the variance 1 + a^2 + b^2 about a line with the weights a and b of the neighbours;
    each square is divided by that. A curved series enlarges the result.

    Args:
        times: Times of the readings [s], shape (n,).
        values: The series at these times, shape (n,).
    """
    gaps = np.diff(times)
    weight = gaps[1:] / (gaps[:-1] + gaps[1:])
    line = weight * values[:-2] + (1.0 - weight) * values[2:]
    square = (values[1:-1] - line) ** 2 / (1.0 + weight**2 + (1.0 - weight) ** 2)
    return float(np.sqrt(np.mean(square)))


def explain_channel(readings: Readings, noise: Noise, residual: np.ndarray) -> Explained:
    """How well a channel is described; the noise is the smaller one of those between neighbours in output and residual.

    Args:
        readings: The readings of the channel.
        noise: The noise of the residual, which tells the number of independent samples.
        residual: The residual at the readings, shape (n,).
    """
    noise_rms = min(noise_between_neighbours(readings.times, series) for series in (readings.values, residual))
    residual_rms = float(np.sqrt(np.mean(residual**2)))
    independent = independent_samples(noise, readings.times)
    noise_rms = min(noise_rms, residual_rms)
    count = len(readings.values)
    limit = noise_rms * math.sqrt(float(stats.chi2.ppf(NOISE_CONFIDENCE, count)) / count)
    return Explained(
        residual=residual_rms,
        noise=noise_rms,
        output=float(np.std(readings.values)),
        independent=independent,
        limit=limit,
        reading_noise=noise_rms,
    )


def explain(problem: FitProblem, x: np.ndarray) -> list[Explained]:
    """How well the model describes each channel that has readings, at coordinates x of the fit.

    If the readings' noise alone leaves too much unexplained in any channel, or a residual that is clearly larger, the
    study's noise is simulated. For each channel the larger of the two noises then counts, and the larger limit.
    """
    results = []
    for readings, noise, columns in zip(problem.readings, problem.noises, problem.columns(x), strict=True):
        results.append(explain_channel(readings, noise, columns[:, 0]))
    if all(result.least_unexplained <= MOST_UNEXPLAINED and not result.is_doubtful for result in results):
        return results
    program = NoiseProgram(problem.study, problem.names, problem.log.commands, sensors=True)
    simulated_noise = program.simulate(problem.values(x), NOISE_REPLICATES)
    for place, readings in enumerate(problem.readings):
        added_noise = readings.interpolate(simulated_noise[:, readings.channel])
        replicate_rms = np.sqrt(np.mean(added_noise**2, axis=-1))
        simulated = float(np.sqrt(np.mean(added_noise**2)))
        limit = float(np.mean(replicate_rms) + NOISE_DEVIATIONS * np.std(replicate_rms))
        result = results[place]
        results[place] = result._replace(noise=max(result.noise, simulated), limit=max(result.limit, limit))
    return results


def conversion_hint(problem: FitProblem, x: np.ndarray, place: int) -> str:
    """The unit, sign or channel in which a channel's readings would match the prediction, in words; empty if none.

    Predicted are the outputs at coordinates x and at the medians of the laws.

    Args:
        problem: The least-squares problem of the log.
        x: The coordinates.
        place: Position of the readings.
    """
    readings = problem.readings[place]
    names = [signal_name(problem.study.loop.channels[output.channel], "y") for output in problem.readings]
    unit = problem.study.units[readings.channel].output
    for coordinates in (np.zeros_like(x), x):
        predicted = []
        for output, columns in zip(problem.readings, problem.columns(coordinates), strict=True):
            predicted.append(np.interp(readings.times, output.times, output.values - columns[:, 0]))
        words = likeness_text(place, readings.values, predicted, names, unit)
        if words:
            return f". {names[place]} {words}"
    return ""


def doubts(
    problem: FitProblem, x: np.ndarray, results: Sequence[Explained], causes: Sequence[SignalWarning] = ()
) -> tuple[SignalWarning, ...]:
    """The doubts about residuals that are clearly larger than noise explains, by channel, with cause or remedy.

    Args:
        problem: The least-squares problem of the log.
        x: The coordinates of the numbers, shape (p,).
        results: How well each channel is described there.
        causes: Warnings of likely causes.
    """
    reasons = []
    columns = problem.columns(x) if any(result.is_doubtful for result in results) else []
    for place, result in enumerate(results):
        if not result.is_doubtful:
            continue
        name, unit = signal_and_unit(problem, place)
        largest = largest_text(problem.readings[place].times, columns[place][:, 0])
        text = (
            f"the residual of {name} is {result.residual:.3g} {unit} rms, "
            f"{result.residual / max(result.noise, TINY):.3g} times the {result.noise:.3g} {unit} that noise explains, "
            f"and {largest}: {cause_text(problem.study.loop.channels[problem.readings[place].channel], causes)}"
            f"{conversion_hint(problem, x, place)}"
        )
        reasons.append(SignalWarning(name, "large-residual", text))
    return tuple(reasons)


def largest_text(times: np.ndarray, residual: np.ndarray) -> str:
    """When a residual is the largest, and the span around it in which it is at least half as large, in words.

    Args:
        times: Times of the study [s], shape (n,).
        residual: The residual, shape (n,).
    """
    size = np.abs(residual)
    place = int(np.argmax(size))
    text = f"largest at {times[place]:.4g} s of the study"
    for begin, end in zip(*flag_runs(size >= 0.5 * size[place]), strict=True):
        if begin <= place < end and end - begin > 1:
            text += f" (at least half as large from {times[begin]:.4g} s to {times[end - 1]:.4g} s)"
    return text


def noise_doubts(problem: FitProblem, x: np.ndarray, results: Sequence[Explained]) -> tuple[SignalWarning, ...]:
    """The doubts about readings that are far noisier than the study's sensor, by channel, with the remedy.

    Args:
        problem: The least-squares problem of the log.
        x: Coordinates of the numbers, shape (p,).
        results: How well each channel is described there.
    """
    reasons = []
    for place, (readings, result) in enumerate(zip(problem.readings, results, strict=True)):
        sensor = math.sqrt(readings.sensor)
        noise = result.reading_noise
        if sensor == 0.0 or noise <= NOISIER * sensor:
            continue
        name, unit = signal_and_unit(problem, place)
        text = (
            f"the readings of {name} have a noise of {noise:.3g} {unit}, {noise / sensor:.3g} times that of the "
            f"study's sensor, {sensor:.3g} {unit}. {REMEDY}; or give the sensor that noise"
            f"{conversion_hint(problem, x, place)}"
        )
        reasons.append(SignalWarning(name, "noisy-output", text))
    return tuple(reasons)


def signal_and_unit(problem: FitProblem, place: int) -> tuple[str, str]:
    """Name and unit of the output to which the readings at a position of the problem belong."""
    channel = problem.readings[place].channel
    return signal_name(problem.study.loop.channels[channel], "y"), problem.study.units[channel].output


def unexplained_place(results: Sequence[Explained]) -> int | None:
    """Position of the first channel whose residual is more than noise; None: there is none."""
    for place, result in enumerate(results):
        if result.least_unexplained > MOST_UNEXPLAINED:
            return place
    return None


def refusal_text(problem: FitProblem, x: np.ndarray, place: int, result: Explained) -> str:
    """Why a fit is refused whose residual is more than noise, without causes and advice.

    Args:
        problem: The least-squares problem of the log.
        x: Coordinates of its minimum.
        place: Position of the channel's readings.
        result: How well the channel is described.
    """
    readings = problem.readings[place]
    channel = problem.study.loop.channels[readings.channel]
    unit = problem.study.units[readings.channel].output
    name = f"y of {channel}" if channel else "y"
    largest = largest_text(readings.times, problem.columns(x)[place][:, 0])
    return (
        f"the study does not describe this flight: the residual of {name} is {result.residual:.3g} {unit} rms, "
        f"{largest}, noise explains {result.noise:.3g} {unit} of it, and {100 * result.unexplained:.3g} % of the "
        f"output's variance ({result.output:.3g} {unit})^2 is left unexplained, with {100 * EXPLAINED_CONFIDENCE:g} % "
        f"confidence at least {100 * result.least_unexplained:.3g} %; at most {100 * MOST_UNEXPLAINED:g} % is accepted"
    )


def direction_text(names: Sequence[str], direction: np.ndarray) -> str:
    """Describe a direction in the space of the numbers in words, such as ``+0.80 a -0.60 b``.

    Args:
        names: Names of the p numbers.
        direction: Components of the direction along their coordinates, shape (p,).
    """
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    terms = [(name, float(x)) for name, x in zip(names, direction, strict=True) if abs(x) >= SMALL_COEFFICIENT]
    if len(terms) == 1:
        return terms[0][0]
    return " ".join(f"{x:+.2f} {name}" for name, x in terms) + ", each in standard deviations of its law"


def require_identifiable(names: Sequence[str], information: np.ndarray) -> None:
    """Require a standard deviation below that of the laws along every direction of the numbers' coordinates.

    Args:
        names: Names of the f numbers.
        information: Information on their coordinates, in standard deviations of the laws, shape (f, f).

    Raises:
        NotIdentifiable: A number or a combination of numbers has a larger one.
    """
    diagonal = np.diag(information)
    for name, entry in zip(names, diagonal, strict=True):
        if entry <= 1e-24 * max(float(diagonal.max()), TINY) or not math.isfinite(entry):
            text = f"the flight does not identify {name}: the predicted output does not depend on it"
            raise NotIdentifiable(text, name)
    direction = unidentified_direction(information)
    if direction is None:
        return
    text = direction_text(names, direction.parts)
    number = names[int(np.argmax(np.abs(direction.parts)))]
    if math.isinf(direction.width):
        reason = "the information matrix is singular in this direction"
        raise NotIdentifiable(f"the flight does not identify {text}: {reason}", number)
    raise NotIdentifiable(
        f"the flight does not identify {text}: the standard deviation along it is {direction.width:.3g} times that of "
        "the law",
        number,
        direction.width,
    )


class UnidentifiedDirection(NamedTuple):
    """A combination of numbers that a flight does not identify: a unit vector, and its width over that of the laws."""

    parts: np.ndarray
    width: float  # infinite where the information is singular


def unidentified_direction(information: np.ndarray) -> UnidentifiedDirection | None:
    """The direction of least information, if its standard deviation is not below that of the laws; else None.

    Singularity is judged with the numbers scaled to the information 1 each, so that their units do not matter.
    """
    root = np.sqrt(np.diag(information))
    values, vectors = np.linalg.eigh(information / np.outer(root, root))
    if values[0] < SINGULAR_INFORMATION:
        direction = vectors[:, 0] / root
        return UnidentifiedDirection(direction / np.linalg.norm(direction), math.inf)
    values, vectors = np.linalg.eigh(information)
    return UnidentifiedDirection(vectors[:, 0], float(values[0] ** -0.5)) if values[0] < 1.0 else None


def require_unique_minimum(problem: FitProblem, search: MinimumSearch, information: np.ndarray) -> None:
    """Require that no other minimum describes the log as well as the best one does.

    A rival within the confidence region of the best minimum adds nothing to that region. The laws refute a rival far
    outside of them, unless the best minimum is far outside, too.

    Args:
        problem: The least-squares problem.
        search: Its minima.
        information: The inverse of the stated covariance of the fitted numbers' coordinates, shape (f, f).

    Raises:
        NotIdentifiable: Another minimum describes the log equally well.
    """
    allowed_difference = float(stats.chi2.ppf(TIE, len(problem.fitted)))
    for rival in search.rivals:
        move = (rival.x - search.best.x)[problem.fitted]
        is_near = float(move @ information @ move) <= allowed_difference
        is_refuted = problem.is_far_outside(rival.x) and not problem.is_far_outside(search.best.x)
        if rival.cost - search.best.cost <= allowed_difference and not is_near and not is_refuted:
            best = assignments_text(problem.named_values(search.best.x))
            second = assignments_text(problem.named_values(rival.x))
            raise NotIdentifiable(
                f"the flight does not identify the numbers: two minima describe it equally well, at {best} and at "
                f"{second}; narrow a law to one of them, or fit fewer numbers"
            )


def assignments_text(values: Mapping[str, float]) -> str:
    """Values of numbers by name, in words."""
    return ", ".join(f"{name} = {value:.4g}" for name, value in values.items())
