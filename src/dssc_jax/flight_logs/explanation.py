"""Whether a fitted study explains its log: residual, noise, and the share of the output's variance between them.

The residual's mean square r^2 consists of the noise's, n^2, and of what the study does not describe. The share of the
output's variance v that the study leaves unexplained is (r^2 - n^2)/v. The mean square of correlated noise has nearly
the law of chi squared with as many degrees of freedom as there are independent samples, which gives the share a lower
confidence limit.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.prediction import noise_of_study
from dssc_jax.flight_logs.residual import FitProblem, Readings
from dssc_jax.statistics.correlated_noise import Noise, independent_samples

MOST_UNEXPLAINED = 0.1  # of the output's variance
EXPLAINED_CONFIDENCE = 0.95  # that a refused fit leaves more than that
NOISE_REPLICATES = 16  # of the study's noise


class FitRefused(ValueError):
    """A flight does not support a fit; the message says why."""


class Unexplained(FitRefused):
    """The residual is more than noise; the message has the numbers."""


class Explained(NamedTuple):
    """How well the simulated output of a channel describes the log.

    Args:
        residual: Root mean square of the residual, in the output's unit.
        noise: Root mean square of the noise that log and study account for.
        output: Standard deviation of the logged output.
        independent: Number of independent samples of the residual.
    """

    residual: float
    noise: float
    output: float
    independent: float

    @property
    def unexplained(self) -> float:
        """Share of the output's variance that neither the simulated output nor noise explains."""
        return max(self.residual**2 - self.noise**2, 0.0) / max(self.output**2, 1e-300)

    @property
    def least_unexplained(self) -> float:
        """Lower confidence limit of that share."""
        largest = float(stats.chi2.ppf(EXPLAINED_CONFIDENCE, self.independent)) / self.independent
        return max(self.residual**2 / largest - self.noise**2, 0.0) / max(self.output**2, 1e-300)


def noise_between_neighbours(times: np.ndarray, values: np.ndarray) -> float:
    """Standard deviation of what a series has beyond the straight line between each reading's two neighbours.

    White noise of variance 1 has a variance of 1 + a^2 + b^2 there, with the line's weights a and b, by which it is
    divided. What is curved between neighbours adds to it.

    Args:
        times: Times of the readings, rising, shape (n,).
        values: The readings, shape (n,).
    """
    before, after = np.diff(times)[:-1], np.diff(times)[1:]
    weight = after / (before + after)
    line = weight * values[:-2] + (1.0 - weight) * values[2:]
    square = (values[1:-1] - line) ** 2 / (1.0 + weight**2 + (1.0 - weight) ** 2)
    return float(np.sqrt(np.mean(square)))


def explained(problem: FitProblem, at: np.ndarray) -> list[Explained]:
    """How well each channel with readings is described; what the study has of noise counts where it is needed."""
    results = []
    for readings, noise, columns in zip(problem.readings, problem.noises, problem.columns(at), strict=True):
        results.append(explained_channel(readings, noise, columns[:, 0]))
    if all(result.least_unexplained <= MOST_UNEXPLAINED for result in results):
        return results
    added = noise_of_study(problem.study, problem.names, problem.values(at), problem.log.commands, NOISE_REPLICATES)
    for place, readings in enumerate(problem.readings):
        implied = float(np.sqrt(np.mean(readings.at_times(added[:, readings.channel]) ** 2)))
        results[place] = results[place]._replace(noise=max(results[place].noise, implied))
    return results


def explained_channel(readings: Readings, noise: Noise, residual: np.ndarray) -> Explained:
    """How well a channel is described, by the log's own noise: the least that its output or its residual shows."""
    beyond = min(noise_between_neighbours(readings.times, series) for series in (readings.values, residual))
    size = float(np.sqrt(np.mean(residual**2)))
    independent = independent_samples(noise, readings.times)
    return Explained(size, min(beyond, size), float(np.std(readings.values)), independent)


def require_explained(channels: Sequence[str], units: Sequence[str], results: Sequence[Explained]) -> None:
    """Require that every channel's residual can be noise.

    Args:
        channels: Their names.
        units: Units of their outputs.
        results: How well they are described.

    Raises:
        Unexplained: one cannot.
    """
    for channel, unit, result in zip(channels, units, results, strict=True):
        if result.least_unexplained <= MOST_UNEXPLAINED:
            continue
        name = f"y of {channel}" if channel else "y"
        unexplained, least = 100 * result.unexplained, 100 * result.least_unexplained
        raise Unexplained(
            f"the study does not describe this flight: the residual of {name} is {result.residual:.3g} {unit} rms, "
            f"noise explains {result.noise:.3g} {unit} of it, and {unexplained:.3g} % of the output's variance "
            f"({result.output:.3g} {unit})^2 is left unexplained, with {100 * EXPLAINED_CONFIDENCE:g} % confidence at "
            f"least {least:.3g} %; at most {100 * MOST_UNEXPLAINED:g} % is accepted. Compare the log's columns, units "
            "and start with the study, and its initial state; give the study what acts on the flight "
            "(wind, disturbance, sensor noise), or wider laws"
        )
