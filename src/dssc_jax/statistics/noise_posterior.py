"""Bayesian model of a residual's correlated noise: the posterior law over kinds of noise and their parameters.

A residual seldom identifies its correlation well, a sparse residual hardly at all. Results that depend on the noise are
therefore averaged over all plausible noises, with their posterior probabilities, instead of computed for the most
likely one. Numbers have been fitted to the residual; the restricted likelihood accounts for that.

References:
    J. A. Hoeting, D. Madigan, A. E. Raftery, C. T. Volinsky, "Bayesian model averaging: a tutorial", Statistical
        Science 14 (1999) 382-417.
"""

import math
from collections.abc import Callable
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np
from scipy import optimize, special, stats

from dssc_jax.statistics.correlated_noise import WHITE, Noise, NoiseFit, fit_noise, weighted_products
from dssc_jax.statistics.noise_kinds import NOISE_KINDS, NoiseKind, TimeScale, logit, noise_of_share, sigmoid
from dssc_jax.statistics.simulated_noise import NoiseShape, SimulatedNoise

WHITE_PRIOR = 0.1  # prior probability of white noise; the kinds of correlated noise share the remainder
NOISE_SAMPLES = 64  # samples of the posterior law of each kind
FREEDOM = 4.0  # degrees of freedom of Student's t, the proposal law of these samples
PROPOSAL_WIDTH = 1.2  # width of the proposal law relative to the posterior law at its mode
MODE_STARTS = (-1.2, 0.0, 1.2)  # starts of the search for the mode, in each coordinate
LEAST_GAP = 0.2  # least gap between two times, as a share of the median gap
ROUNDING_VARIANCE = 10.0  # multiple of the least variance below which a residual counts as rounding, and as white


class Candidate(NamedTuple):
    """A sample of the posterior law of the noise.

    Args:
        noise: Noise of unit variance.
        weight: Posterior probability of the sample.
        fit: Least squares of the residual under this noise.
    """

    noise: Noise
    weight: float
    fit: NoiseFit


class NoisePosterior(NamedTuple):
    """Posterior law of the noise of a channel's residual.

    The noise may be white, of a kind in :data:`NOISE_KINDS`, or of the shape that simulations of a disturbance show.

    Args:
        likeliest: Noise at the mode of the likeliest kind.
        fit: Least squares of the residual under the likeliest noise.
        white: Posterior probability that the noise is white.
        candidates: Samples of the posterior law; the sum of their weights is 1.
    """

    likeliest: Noise
    fit: NoiseFit
    white: float
    candidates: tuple[Candidate, ...]


class Mode(NamedTuple):
    """Laplace's normal approximation of the posterior law of a kind of noise, around its mode.

    Args:
        point: Coordinates of the mode, whose prior law is standard normal, shape (k,).
        spread: Square root of the covariance, shape (k, k): point + spread @ z has the law if z is standard normal.
        density: Logarithm of the posterior density at the mode, without the prior probability of the kind.
    """

    point: np.ndarray
    spread: np.ndarray
    density: float

    @property
    def evidence(self) -> float:
        """Logarithm of the integral of the posterior density, in its normal approximation."""
        size = len(self.point)
        _, log_determinant = np.linalg.slogdet(self.spread)
        return self.density + 0.5 * size * math.log(2.0 * math.pi) + float(log_determinant)


def noise_of_simulations(times: np.ndarray, simulated: np.ndarray, white: float) -> tuple[SimulatedNoise, float] | None:
    """Model simulated disturbances plus white noise; return the noise and its variance.

    Args:
        times: Times of the readings [s], shape (n,).
        simulated: Simulations of what disturbs the readings, shape (m, n).
        white: Variance of the white noise.

    Returns:
        The noise of unit variance, and the variance; None if the simulations are 0 or not finite.
    """
    shape = NoiseShape.of(separate_times(times), simulated)
    if shape is None:
        return None
    disturbance = float(np.mean(np.square(simulated)))
    variance = disturbance + white
    share = sigmoid(logit(disturbance / variance))  # within the limits of a logit
    return SimulatedNoise(share, shape), variance


def separate_times(times: np.ndarray) -> np.ndarray:
    """Times in which every gap is at least :data:`LEAST_GAP` median gaps long, shape (n,).

    Shorter gaps are stretched to that length, and all later times move with them.

    Args:
        times: Times, rising [s], shape (n,).
    """
    gaps = np.diff(times)
    stretched = np.maximum(gaps, LEAST_GAP * np.median(gaps))
    return times[0] + np.concatenate([[0.0], np.cumsum(stretched)])


def find_mode(density: Callable[[np.ndarray], float], size: int) -> Mode:
    """Find the maximum of a log density, and the normal law that approximates the density around the maximum.

    The simplex search of Nelder and Mead starts from the best point of a grid.

    Args:
        density: (point, shape (k,)) -> log density.
        size: Number k of coordinates.
    """
    grid = [np.array(point) for point in product(MODE_STARTS, repeat=size)]
    start = max(grid, key=density)
    simplex = np.vstack([start, start + 0.6 * np.eye(size)])
    options = {"xatol": 0.02, "fatol": 0.02, "maxfev": 80 * size, "initial_simplex": simplex}
    result = optimize.minimize(lambda point: -density(point), start, method="Nelder-Mead", options=options)
    top = -float(result.fun)
    curvature = curvature_at(density, result.x, top)
    values, vectors = np.linalg.eigh(curvature)
    spread = vectors / np.sqrt(np.maximum(values, 0.25))  # a standard deviation of at most 2, twice the prior law's
    return Mode(result.x, spread, top)


def curvature_at(density: Callable[[np.ndarray], float], point: np.ndarray, top: float) -> np.ndarray:
    """Estimate the negative second derivatives of a log density at its maximum, by finite differences, shape (k, k).

    The steps are halved until the density falls by at most 2. A derivative that is not finite is replaced by 1, the
    curvature of the prior law.

    Args:
        density: (point, shape (k,)) -> log density.
        point: The maximum, shape (k,).
        top: Log density at the maximum.
    """
    size = len(point)
    steps = np.full(size, 0.5)
    for axis, move in enumerate(np.eye(size)):
        while steps[axis] > 1e-3:
            lower = density(point - steps[axis] * move)
            upper = density(point + steps[axis] * move)
            if top - min(lower, upper) <= 2.0:
                break
            steps[axis] *= 0.5
    curvature = np.zeros((size, size))
    moves = np.diag(steps)
    for i in range(size):
        ends = density(point + moves[i]) + density(point - moves[i])
        curvature[i, i] = (2.0 * top - ends) / steps[i] ** 2
        for j in range(i):
            along = density(point + moves[i] + moves[j]) + density(point - moves[i] - moves[j])  # both rise or fall
            across = density(point + moves[i] - moves[j]) + density(point - moves[i] + moves[j])  # one rises, one falls
            curvature[i, j] = curvature[j, i] = (across - along) / (4.0 * steps[i] * steps[j])
    return np.nan_to_num(curvature, nan=1.0, posinf=1.0, neginf=1.0)


def draw_points(mode: Mode) -> tuple[np.ndarray, np.ndarray]:
    """Draw points around a mode from a Student's t law, whose tails are longer than those of the posterior law.

    Returns:
        Points, shape (n, k), and the logarithm of the density of Student's t law at each point, shape (n,).
    """
    size = len(mode.point)
    uniform = stats.qmc.Sobol(size + 1, rng=np.random.default_rng(0)).random(NOISE_SAMPLES)
    radii = np.sqrt(FREEDOM / special.chdtri(FREEDOM, uniform[:, -1]))  # make Student's t of normal scores
    scores = np.asarray(special.ndtri(uniform[:, :-1])) * radii[:, None]
    squares = np.sum(scores**2, axis=1)
    _, log_determinant = np.linalg.slogdet(PROPOSAL_WIDTH * mode.spread)
    constant = math.lgamma(0.5 * (FREEDOM + size)) - math.lgamma(0.5 * FREEDOM)
    constant -= 0.5 * size * math.log(FREEDOM * math.pi) + float(log_determinant)
    log_density = constant - 0.5 * (FREEDOM + size) * np.log1p(squares / FREEDOM)
    return mode.point + PROPOSAL_WIDTH * scores @ mode.spread.T, log_density


class NoiseSearch:
    """Search for the noise of a channel's residual, from which :meth:`posterior` draws samples.

    Args:
        times: Times of observation, rising [s], shape (n,).
        columns: Residual, and derivatives of the prediction by each of p numbers, shape (n, 1 + p).
        floor: Lower limit of the variance.
        least_white: Lower limit of the variance of the white part, such as the variance of a sensor's noise. It applies
            after the noise has been estimated. Without it, a smooth model error would count as readings of high
            precision.
        simulated: Simulations of what disturbs the readings, shape (m, n), whose shape is a further kind of noise;
            None: nothing is known to disturb the readings.
        only_simulated: Whether the simulated shape is the only kind beside white noise.
    """

    def __init__(
        self,
        times: np.ndarray,
        columns: np.ndarray,
        floor: float,
        least_white: float = 0.0,
        simulated: np.ndarray | None = None,
        only_simulated: bool = False,
    ) -> None:
        """Find the mode of the posterior law of each kind of noise; the arguments are those of the class."""
        self.times = separate_times(times)
        self.columns = columns
        self.floor = floor
        self.least_white = least_white
        self.white = fit_noise(WHITE, self.times, columns, floor)
        self.scale = TimeScale(float(np.median(np.diff(self.times))), float(self.times[-1] - self.times[0]))
        self.kinds: tuple[NoiseKind, ...] = NOISE_KINDS
        noise_and_variance = None if simulated is None else noise_of_simulations(times, simulated, least_white)
        if noise_and_variance is not None:
            simulated_noise, _ = noise_and_variance
            simulated_kind = NoiseKind(partial(noise_of_share, simulated_noise), 1)
            self.kinds = (simulated_kind,) if only_simulated else (*NOISE_KINDS, simulated_kind)
        is_rounding = self.white.variance <= ROUNDING_VARIANCE * floor
        if is_rounding:  # nothing is left for a correlated noise to explain
            self.kinds = ()
        self.modes = [find_mode(partial(self.log_density, kind), kind.scores) for kind in self.kinds]

    def log_density(self, kind: NoiseKind, point: np.ndarray) -> float:
        """Compute the log posterior density of a kind of noise at a point of scores, relative to white noise."""
        log_density, _ = self.fit_at(kind, point)
        return log_density

    def fit_at(self, kind: NoiseKind, point: np.ndarray) -> tuple[float, NoiseFit]:
        """Fit the residual under a kind of noise at a point of scores.

        Args:
            kind: The kind of noise.
            point: Standard normal scores of the noise's parameters, shape (k,).

        Returns:
            - The logarithm of prior density times likelihood, less white noise's log likelihood; -inf if the least
              squares are singular.
            - The least squares.
        """
        try:
            fit = fit_noise(kind.noise_at(point, self.scale), self.times, self.columns, self.floor)
        except np.linalg.LinAlgError:
            return -math.inf, self.white
        prior = -0.5 * float(point @ point) - 0.5 * len(point) * math.log(2.0 * math.pi)
        return fit.log_likelihood - self.white.log_likelihood + prior, fit

    def likeliest(self) -> tuple[Noise, NoiseFit]:
        """Return the noise at the mode of the likeliest kind, and the least squares of the residual under it."""
        if not self.kinds:
            return self.with_least_white(WHITE, self.white)
        prior = (1.0 - WHITE_PRIOR) / len(self.kinds)
        log_odds = [mode.evidence + math.log(prior / WHITE_PRIOR) for mode in self.modes]  # against white noise
        if max(log_odds) <= 0.0:
            return self.with_least_white(WHITE, self.white)
        best = int(np.argmax(log_odds))
        kind = self.kinds[best]
        point = self.modes[best].point
        _, fit = self.fit_at(kind, point)
        return self.with_least_white(kind.noise_at(point, self.scale), fit)

    def with_least_white(self, noise: Noise, fit: NoiseFit) -> tuple[Noise, NoiseFit]:
        """Raise the white part of a noise to its least variance, and repeat the least squares with the raised noise.

        A noise whose white part is large enough is returned unchanged, with its fit.

        Args:
            noise: The noise; its ``share`` is the correlated part of the variance.
            fit: Least squares of the residual under this noise.
        """
        shortage = self.least_white - (1.0 - noise.share) * fit.variance
        if shortage <= 0.0:
            return noise, fit
        variance = fit.variance + shortage
        noise = noise._replace(share=noise.share * fit.variance / variance)
        products, _ = weighted_products(noise, self.times, self.columns)
        products = products / variance
        return noise, fit._replace(variance=variance, information=products[1:, 1:], gradient=products[1:, 0])

    def posterior(self) -> NoisePosterior:
        """Sample the posterior law of the noise: white noise, and points around the mode of each kind, with weights.

        The weight of a sample is proportional to the posterior density of the sample over the density of the law from
        which it was drawn.
        """
        log_weights = [math.log(WHITE_PRIOR)]
        fits = [self.with_least_white(WHITE, self.white)]
        log_prior_of_sample = math.log((1.0 - WHITE_PRIOR) / max(len(self.kinds), 1) / NOISE_SAMPLES)
        for kind, mode in zip(self.kinds, self.modes, strict=True):
            points, log_proposals = draw_points(mode)
            for point, log_proposal in zip(points, log_proposals, strict=True):
                log_density, fit = self.fit_at(kind, point)
                log_weights.append(log_prior_of_sample + log_density - log_proposal)
                fits.append(self.with_least_white(kind.noise_at(point, self.scale), fit))
        weights = np.exp(np.array(log_weights) - max(log_weights))
        weights /= weights.sum()
        candidates = []
        for weight, (noise, fit) in zip(weights.tolist(), fits, strict=True):
            candidates.append(Candidate(noise, weight, fit))
        likeliest, fit_of_likeliest = self.likeliest()
        return NoisePosterior(likeliest, fit_of_likeliest, white=float(weights[0]), candidates=tuple(candidates))
