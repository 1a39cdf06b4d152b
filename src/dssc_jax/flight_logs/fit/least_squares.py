"""The least-squares problem of a logged flight: its residual, the noise of it, and the covariance of a minimum.

Coordinates x are distances of the numbers from the medians of their laws, in standard deviations of the laws; numbers
with a logarithmic law count by their logarithms. With the residual r(x), its Jacobian -J and the covariance S of its
noise, the sum of squares r' S^-1 r has the information matrix J' S^-1 J and the descent direction J' S^-1 r. Numbers
that a flight does not identify keep their laws: each adds the square of its coordinate.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from scipy import special

from dssc_jax.flight_logs.fit.prediction import DisturbanceNoise, Prediction
from dssc_jax.flight_logs.fit.sampled_log import SampledLog
from dssc_jax.flight_logs.fit.search_limits import SearchCount
from dssc_jax.statistics.correlated_noise import WHITE, Noise, weighted_products
from dssc_jax.statistics.noise_posterior import NoisePosterior, NoiseSearch, noise_of_simulations
from dssc_jax.statistics.simulated_noise import SimulatedNoise
from dssc_jax.study import Law, Study

NORMAL_90 = float(special.ndtri(0.95))
LEAST_NOISE = 1e-9  # of the output's size: below, the residual is rounding
LEAST_SIZE = 1e-100  # of an output: below, it is 0, and its rounding that of one unit
LEAST_SAMPLES = 20  # of a channel: fewer do not identify its noise
NOISE_DRAWS = 512  # of the channels' noises together
LAW_ENDS = np.array([0.001, 0.999])  # levels between which a law's values lie
FAR_OUTSIDE = 2.0  # standard deviations of a law beyond these ends, from which its values are refuted
TINY = 1e-300  # in place of 0 in a denominator


def fit_scale(law: Law, values: np.ndarray | float) -> np.ndarray:
    """Values on the scale of the fit: their logarithms if the law is logarithmic, else the values themselves."""
    return np.log(values) if law.logarithmic else np.asarray(values, float)


def from_fit_scale(law: Law, values: np.ndarray | float) -> np.ndarray:
    """Convert values on the scale of the fit back to values of the number: the inverse of :func:`fit_scale`."""
    return np.exp(values) if law.logarithmic else np.asarray(values, float)


def prior_width(law: Law) -> float:
    """Standard deviation, on the scale of the fit, of a normal law with the same quantiles of 5 and 95 %."""
    low, high = fit_scale(law, law.quantile(np.array([0.05, 0.95])))
    return float(high - low) / (2.0 * NORMAL_90)


class Readings(NamedTuple):
    """The n logged outputs of one channel, and their interpolation between the simulated samples."""

    channel: int  # position of the channel
    times: np.ndarray  # [s], shape (n,)
    values: np.ndarray  # shape (n,)
    nodes: np.ndarray  # four samples around each reading, shape (n, 4)
    weights: np.ndarray  # of the cubic polynomial through them, shape (n, 4)
    floor: float  # least variance of the noise
    sensor: float  # variance of what the study's sensor adds to a reading

    @classmethod
    def of(cls, log: SampledLog, channel: int, sample_time: float) -> "Readings":
        """The readings of a channel of a log, with the weights of Lagrange's polynomial through four samples.

        Args:
            log: The log.
            channel: Position of the channel.
            sample_time: Time between two samples [s].
        """
        finite_rows = np.flatnonzero(np.isfinite(log.outputs[channel]))
        values = log.outputs[channel, finite_rows]
        position = finite_rows + log.offsets[channel, finite_rows]
        first = np.clip(np.floor(position).astype(int) - 1, 0, max(log.outputs.shape[1] - 4, 0))
        nodes = first[:, None] + np.arange(4)
        weights = np.ones((len(finite_rows), 4))
        for i in range(4):
            for j in range(4):
                if i != j:
                    weights[:, i] *= (position - nodes[:, j]) / (i - j)
        largest = float(np.abs(values).max(initial=0.0))
        size = largest if largest > LEAST_SIZE else 1.0
        sensor = log.sensor_noise[channel] ** 2
        return cls(
            channel=channel,
            times=sample_time * position,
            values=values,
            nodes=nodes,
            weights=weights,
            floor=(LEAST_NOISE * size) ** 2,
            sensor=sensor,
        )

    def interpolate(self, sampled: np.ndarray) -> np.ndarray:
        """Values at the times of the readings, shape (..., n), of a signal of shape (..., samples)."""
        with np.errstate(invalid="ignore"):  # a simulation that diverges becomes NaN, and no minimum
            return np.sum(self.weights * sampled[..., self.nodes], axis=-1)


class NormalEquations(NamedTuple):
    """The normal equations at a point, including the laws of the numbers that keep them.

    Args:
        cost: Weighted sum of squares r' S^-1 r.
        gradient: Descent direction J' S^-1 r, shape (p,).
        information: Information matrix J' S^-1 J, shape (p, p).
    """

    cost: float
    gradient: np.ndarray
    information: np.ndarray


@dataclass
class FitProblem:
    """The least-squares problem of one log for p numbers of a study.

    Args:
        study: The study.
        names: The numbers.
        predict: The prediction for these numbers.
        log: The log.
        count: Counts the simulations.
        kept: Names of the numbers that keep their laws.
        disturbances: The noise by the study's random disturbances, which problems of the same log share.
        is_shifted: Whether signals are at other times than logged. Noise of the study's random disturbances is then not
            replaced by another kind: commands answer the disturbances, so with later commands less of another noise
            may be left.
    """

    study: Study
    names: tuple[str, ...]
    predict: Prediction
    log: SampledLog
    count: SearchCount = field(default_factory=SearchCount)
    kept: frozenset[str] = frozenset()
    disturbances: DisturbanceNoise = field(default_factory=DisturbanceNoise)
    is_shifted: bool = False

    def __post_init__(self) -> None:
        self.is_kept = np.array([name in self.kept for name in self.names])
        self.prior = np.where(self.is_kept, 1.0, 0.0)  # information of the laws that count, shape (p,)
        self.laws = [self.study.laws[name] for name in self.names]
        self.widths = np.array([prior_width(law) for law in self.laws])
        self.medians = np.array([fit_scale(law, law.median) for law in self.laws])
        ends = np.array([fit_scale(law, law.quantile(LAW_ENDS)) for law in self.laws])
        self.lowest, self.highest = (ends.T - self.medians) / self.widths  # coordinates of the laws' ends, shape (p,)
        counts = np.isfinite(self.log.outputs).sum(axis=1)
        sample_time = self.study.loop.sample_time
        channels = np.flatnonzero(counts >= LEAST_SAMPLES)
        self.readings = [Readings.of(self.log, int(channel), sample_time) for channel in channels]
        self.noises: list[Noise] = [WHITE] * len(self.readings)
        self.variances = [max(float(np.var(readings.values)), readings.floor) for readings in self.readings]

    def scaled(self, x: np.ndarray) -> np.ndarray:
        """The numbers on the scale of the fit at coordinates x, shape (p,)."""
        return self.medians + x * self.widths

    def values(self, x: np.ndarray) -> np.ndarray:
        """The values of the numbers at coordinates x, shape (p,)."""
        pairs = zip(self.laws, self.scaled(x), strict=True)
        return np.array([float(from_fit_scale(law, scaled)) for law, scaled in pairs])

    def named_values(self, x: np.ndarray) -> dict[str, float]:
        """The values of the numbers at coordinates x, by name."""
        return dict(zip(self.names, self.values(x).tolist(), strict=True))

    def is_admissible(self, values: np.ndarray) -> bool:
        """Whether these values of the fitted numbers, and all numbers that follow from them, are in their ranges.

        Numbers with other laws have their medians, which are checked, too.
        """
        medians = {name: law.median for name, law in self.study.laws.items()}
        return not self.study.violations(medians | dict(zip(self.names, values.tolist(), strict=True)))

    def beyond_laws(self, x: np.ndarray) -> np.ndarray:
        """How far each number at coordinates x is outside of its law, in standard deviations of the law; 0 inside."""
        return np.maximum(0.0, np.maximum(self.lowest - x, x - self.highest))

    def is_far_outside(self, x: np.ndarray) -> bool:
        """Whether any number at coordinates x is far outside of its law."""
        return bool(np.any(self.beyond_laws(x) > FAR_OUTSIDE))

    def columns(
        self, x: np.ndarray, commands: np.ndarray | None = None, forces: np.ndarray | None = None
    ) -> list[np.ndarray]:
        """Residual r, and slopes J of the prediction, of each channel with readings, as columns, shape (n, 1 + p).

        Args:
            x: The coordinates, shape (p,).
            commands: Commands in place of those of the log, shape (channels, samples); None: those of the log.
            forces: Forces beside the study's disturbance, shape (samples,) [u]; None: there are none.
        """
        values = self.values(x)
        predicted, slopes = self.predict(values, self.log.commands if commands is None else commands, forces)
        chain = self.widths * [value if law.logarithmic else 1.0 for law, value in zip(self.laws, values, strict=True)]
        columns = []
        for readings in self.readings:
            residual = readings.values - readings.interpolate(predicted[readings.channel])
            slope = readings.interpolate(slopes[:, readings.channel]) * chain[:, None]
            columns.append(np.vstack([residual, slope]).T)
        return columns

    def normal_equations(self, x: np.ndarray, commands: np.ndarray | None = None) -> NormalEquations:
        """The normal equations at coordinates, after one simulation; the cost is infinite if the output diverges.

        Args:
            x: The coordinates, shape (p,).
            commands: Commands in place of those of the log, shape (channels, samples); None: those of the log.
        """
        self.count.add()
        count = len(self.names)
        products = np.zeros((1 + count, 1 + count))
        for readings, noise, variance, columns in zip(
            self.readings, self.noises, self.variances, self.columns(x, commands), strict=True
        ):
            if not np.isfinite(columns).all():
                return NormalEquations(math.inf, np.zeros(count), np.eye(count))
            with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # squares of what diverges
                products += weighted_products(noise, readings.times, columns)[0] / variance
        if not np.isfinite(products).all():
            return NormalEquations(math.inf, np.zeros(count), np.eye(count))
        cost = float(products[0, 0] + self.prior @ x**2)
        return NormalEquations(cost, products[1:, 0] - self.prior * x, products[1:, 1:] + np.diag(self.prior))

    @property
    def fitted(self) -> np.ndarray:
        """Positions of the numbers that do not keep their laws."""
        return np.flatnonzero(~self.is_kept)

    @property
    def fitted_names(self) -> list[str]:
        """Names of the numbers that do not keep their laws."""
        return [self.names[i] for i in self.fitted]

    def keeping(self, names: Iterable[str]) -> "FitProblem":
        """The problem in which the given numbers alone keep their laws; its noise is white, as before any search."""
        return replace(self, kept=frozenset(names))

    def noise_searches(self, x: np.ndarray) -> list[NoiseSearch]:
        """The search for the noise of each channel's residual at coordinates x."""
        simulated = self.disturbances.simulate(self.study, self.names, self.values(x), self.log.commands)
        return [self.noise_search(row, columns, simulated) for row, columns in enumerate(self.columns(x))]

    def noise_search(self, row: int, columns: np.ndarray, simulated: np.ndarray | None) -> NoiseSearch:
        """The search for the noise of a residual.

        Args:
            row: Position of the channel's readings.
            columns: Residual and slopes, shape (n, 1 + p).
            simulated: Simulations of random disturbances, shape (replicates, channels, samples); None: there are none.
        """
        readings = self.readings[row]
        return NoiseSearch(
            readings.times,
            columns,
            readings.floor,
            readings.sensor,
            None if simulated is None else readings.interpolate(simulated[:, readings.channel]),
            only_simulated=self.is_shifted and isinstance(self.noises[row], SimulatedNoise),
        )

    def weight_as_declared(self) -> None:
        """Replace the noises by those that the study declares, at the medians of the laws; without any, keep them.

        Commands answer disturbances. With white noise the search would begin near numbers that describe the controller
        instead of the plant.
        """
        medians = np.zeros(len(self.names))
        simulated = self.disturbances.simulate(self.study, self.names, self.values(medians), self.log.commands)
        if simulated is None:
            return
        for row, readings in enumerate(self.readings):
            disturbed = readings.interpolate(simulated[:, readings.channel])
            declared = noise_of_simulations(readings.times, disturbed, readings.sensor)
            if declared is not None:
                self.noises[row], self.variances[row] = declared

    def reweight(self, x: np.ndarray) -> None:
        """Replace the noises by the likeliest ones for the residual at coordinates x."""
        for row, search in enumerate(self.noise_searches(x)):
            self.noises[row], noise_fit = search.likeliest()
            self.variances[row] = noise_fit.variance


def averaged_covariance(problem: FitProblem, posteriors: Sequence[NoisePosterior], x: np.ndarray) -> np.ndarray:
    """Second moments of the coordinates about an estimate, averaged over all noises that the residual allows, (p, p).

    Args:
        problem: The problem.
        posteriors: Posterior law of the noise of each channel's residual.
        x: Coordinates of the estimate, shape (p,).
    """
    count = len(problem.names)
    information = np.zeros((NOISE_DRAWS, count, count))
    gradient = np.zeros((NOISE_DRAWS, count))
    random = np.random.default_rng(0)
    for posterior in posteriors:
        noise_fits = [candidate.fit for candidate in posterior.candidates]
        levels = np.cumsum([candidate.weight for candidate in posterior.candidates])
        candidate_indices = np.searchsorted(levels, (np.arange(NOISE_DRAWS) + 0.5) / NOISE_DRAWS * levels[-1])
        # The draws have the candidates' shares; a random order makes the channels independent.
        candidate_indices = random.permutation(np.minimum(candidate_indices, len(levels) - 1))
        information += np.array([fit.information for fit in noise_fits])[candidate_indices]
        gradient += np.array([fit.gradient for fit in noise_fits])[candidate_indices]
    information += np.diag(problem.prior)
    gradient -= problem.prior * x
    scale = np.sqrt(np.mean([np.diag(matrix) for matrix in information], axis=0))
    scaled = information / np.outer(scale, scale) + 1e-12 * np.eye(count)
    covariances = np.linalg.inv(scaled)
    moves = np.einsum("gij,gj->gi", covariances, gradient / scale)
    moments = np.mean(covariances + moves[:, :, None] * moves[:, None, :], axis=0)
    return moments / np.outer(scale, scale)
