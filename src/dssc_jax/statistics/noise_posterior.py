"""The correlated noise of a residual: the posterior law over kinds of noise and their parameters.

A residual seldom tells its correlation well, a sparse one hardly at all. What follows from the noise is therefore
averaged over all noises that the residual allows, with their posterior probabilities, instead of taken for the most
likely one. The residual has been fitted to the numbers; the restricted likelihood accounts for that.

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

from dssc_jax.statistics.correlated_noise import (
    WHITE,
    Drift,
    FirstOrder,
    Noise,
    NoiseFit,
    SecondOrder,
    fit_noise,
    weighted_products,
)

WHITE_PRIOR = 0.1  # probability of white noise; the kinds of correlated noise share the rest
SHARE_WIDTH = 2.0  # standard deviation of logit c: one deviation either side is 12 to 88 %
DAMPING_MIDDLE = 1.0  # of logit zeta
DAMPING_WIDTH = 1.5  # standard deviation of logit zeta: 14 to 92 %
TIME_WIDTHS = 6.0  # standard deviations of log T from the median gap to the whole span
NOISE_SAMPLES = 64  # samples of the posterior law of each kind
FREEDOM = 4.0  # degrees of freedom of Student's t, from which they are drawn
WIDER = 1.2  # than the posterior law at its mode
MODE_STARTS = (-1.2, 0.0, 1.2)  # starts of the search for the mode, in each coordinate
LARGEST_LOGIT = 13.8  # bound of |logit c|: a share and its complement are at least 1e-6
LEAST_GAP = 0.2  # share of the median gap: times that lie closer count as this far apart
LONGEST = 1000.0  # median gaps; longer time constants of the second order are lost in rounding
ROUNDING_VARIANCE = 10.0  # multiple of the least variance: a residual below it is rounding, and white
LEAST_DAMPING = 0.02
MOST_DAMPING = 0.98


class Candidate(NamedTuple):
    """A noise that the residual allows.

    Args:
        noise: The noise, of unit variance.
        weight: Its posterior probability.
        fit: The fit of the residual with this noise.
    """

    noise: Noise
    weight: float
    fit: NoiseFit


class NoisePosterior(NamedTuple):
    """The posterior law of the noise of a channel's residual.

    Args:
        likeliest: The noise at the mode of the likeliest kind.
        fit: The fit of the residual with that noise.
        white: Posterior probability of white noise.
        candidates: Noises with their probabilities, whose sum is 1.
    """

    likeliest: Noise
    fit: NoiseFit
    white: float
    candidates: tuple[Candidate, ...]


class Mode(NamedTuple):
    """Where the posterior density of one kind is largest.

    Args:
        point: Its coordinates, whose prior law is standard normal, shape (k,).
        spread: Root of the covariance there: point + spread @ normal, shape (k, k).
        density: Logarithm of the posterior density there, without the probability of the kind.
    """

    point: np.ndarray
    spread: np.ndarray
    density: float

    @property
    def evidence(self) -> float:
        """Logarithm of the integrated density, by Laplace's method."""
        size = len(self.point)
        return self.density + 0.5 * size * math.log(2.0 * math.pi) + float(np.linalg.slogdet(self.spread)[1])


def sigmoid(x: float) -> float:
    """The inverse of the logit, within its limits."""
    return float(special.expit(np.clip(x, -LARGEST_LOGIT, LARGEST_LOGIT)))


class TimeScale(NamedTuple):
    """The times of observation: what their noise's time constant can be.

    Args:
        gap: Median gap [s].
        span: From the first to the last [s].
    """

    gap: float
    span: float

    def time_constant_at(self, score: float) -> float:
        """The time constant [s] at a standard normal score: log-normal, limited to 0.1 gap .. 3 span."""
        middle = 0.5 * math.log(self.gap * self.span)
        width = math.log(self.span / self.gap) / TIME_WIDTHS
        shortest = math.log(0.1 * self.gap)
        longest = math.log(3.0 * self.span)
        return math.exp(min(max(middle + width * score, shortest), longest))


def first_order_noise(point: np.ndarray, scale: TimeScale) -> Noise:
    """The noise at coordinates."""
    return FirstOrder(sigmoid(SHARE_WIDTH * point[1]), scale.time_constant_at(point[0]))


def second_order_noise(point: np.ndarray, scale: TimeScale) -> Noise:
    """The noise at coordinates."""
    damping = min(max(sigmoid(DAMPING_MIDDLE + DAMPING_WIDTH * point[2]), LEAST_DAMPING), MOST_DAMPING)
    time = min(scale.time_constant_at(point[0]), LONGEST * scale.gap)
    return SecondOrder(sigmoid(SHARE_WIDTH * point[1]), time, damping)


def drift_noise(point: np.ndarray, scale: TimeScale) -> Noise:
    """The noise at coordinates."""
    span = scale.span + scale.gap
    return Drift(sigmoid(SHARE_WIDTH * point[1]), min(scale.time_constant_at(point[0]), span), span)


NOISE_KINDS: tuple[tuple[Callable[[np.ndarray, TimeScale], Noise], int], ...] = (
    (first_order_noise, 2),
    (second_order_noise, 3),
    (drift_noise, 2),
)
"""Kinds of correlated noise: the noise at coordinates, and their number."""


def times_apart(times: np.ndarray) -> np.ndarray:
    """Times with no two closer than a share of their median gap, shape (n,)."""
    gaps = np.diff(times)
    return times[0] + np.concatenate([[0.0], np.cumsum(np.maximum(gaps, LEAST_GAP * np.median(gaps)))])


def mode_of(density: Callable[[np.ndarray], float], size: int) -> Mode:
    """The largest posterior density and its curvature, by Nelder and Mead's simplex from the best of a grid."""
    begin = max((np.array(point) for point in product(MODE_STARTS, repeat=size)), key=density)
    simplex = np.vstack([begin, begin + 0.6 * np.eye(size)])
    options = {"xatol": 0.02, "fatol": 0.02, "maxfev": 80 * size, "initial_simplex": simplex}
    result = optimize.minimize(lambda point: -density(point), begin, method="Nelder-Mead", options=options)
    point = result.x
    top = -float(result.fun)
    steps = np.full(size, 0.5)
    for axis, move in enumerate(np.eye(size)):
        while steps[axis] > 1e-3:
            lower, upper = (density(point + sign * steps[axis] * move) for sign in (-1, 1))
            if top - min(lower, upper) <= 2.0:
                break
            steps[axis] *= 0.5
    curvature = np.zeros((size, size))
    moves = np.diag(steps)
    for i in range(size):
        ends = density(point + moves[i]) + density(point - moves[i])
        curvature[i, i] = (2.0 * top - ends) / steps[i] ** 2
        for j in range(i):
            along = density(point + moves[i] + moves[j]) + density(point - moves[i] - moves[j])
            across = density(point + moves[i] - moves[j]) + density(point - moves[i] + moves[j])
            curvature[i, j] = curvature[j, i] = (across - along) / (4.0 * steps[i] * steps[j])
    curvature = np.nan_to_num(curvature, nan=1.0, posinf=1.0, neginf=1.0)
    values, vectors = np.linalg.eigh(curvature)
    return Mode(point, vectors / np.sqrt(np.maximum(values, 0.25)), top)


def drawn_points(mode: Mode) -> tuple[np.ndarray, np.ndarray]:
    """Points around a mode, shape (n, k), and the logarithm of the density from which they are drawn, shape (n,)."""
    size = len(mode.point)
    uniform = stats.qmc.Sobol(size + 1, rng=np.random.default_rng(0)).random(NOISE_SAMPLES)
    radii = np.sqrt(FREEDOM / special.chdtri(FREEDOM, uniform[:, -1]))
    scores = np.asarray(special.ndtri(uniform[:, :-1])) * radii[:, None]
    squares = np.sum(scores**2, axis=1)
    density = math.lgamma(0.5 * (FREEDOM + size)) - math.lgamma(0.5 * FREEDOM)
    density -= 0.5 * size * math.log(FREEDOM * math.pi) + float(np.linalg.slogdet(WIDER * mode.spread)[1])
    return mode.point + WIDER * scores @ mode.spread.T, density - 0.5 * (FREEDOM + size) * np.log1p(squares / FREEDOM)


class NoiseSearch:
    """The search for the noise of one channel's residual.

    Args:
        times: Times of observation, rising [s], shape (n,).
        columns: The residual, and the slopes of the prediction by each of p numbers, shape (n, 1 + p).
        floor: Least variance.
        least_white: Least variance of the white part, such as that of a sensor. The residual tells the noise, and this
            only weights it: without it a smooth misfit of the model would count as readings of high precision.
    """

    def __init__(self, times: np.ndarray, columns: np.ndarray, floor: float, least_white: float = 0.0) -> None:
        self.times = times_apart(times)
        self.columns = columns
        self.floor = floor
        self.least_white = least_white
        self.white = fit_noise(WHITE, self.times, columns, floor)
        self.scale = TimeScale(float(np.median(np.diff(self.times))), float(self.times[-1] - self.times[0]))
        self.kinds = NOISE_KINDS if self.white.variance > ROUNDING_VARIANCE * floor else ()
        self.modes = [mode_of(partial(self.log_density, kind), size) for kind, size in self.kinds]

    def log_density(self, kind: Callable[..., Noise], point: np.ndarray) -> float:
        """Logarithm of the posterior density, as :meth:`density` has it."""
        return self.density(kind, point)[0]

    def density(self, kind: Callable[..., Noise], point: np.ndarray) -> tuple[float, NoiseFit]:
        """Logarithm of the posterior density, relative to the likelihood of white noise; and the fit of the noise."""
        try:
            fit = fit_noise(kind(point, self.scale), self.times, self.columns, self.floor)
        except np.linalg.LinAlgError:
            return -math.inf, self.white
        prior = -0.5 * float(point @ point) - 0.5 * len(point) * math.log(2.0 * math.pi)
        return fit.log_likelihood - self.white.log_likelihood + prior, fit

    def likeliest(self) -> tuple[Noise, NoiseFit]:
        """The noise at the mode of the likeliest kind, by Laplace's method, and the residual's fit with it."""
        share = (1.0 - WHITE_PRIOR) / len(NOISE_KINDS)
        evidence = [mode.evidence + math.log(share / WHITE_PRIOR) for mode in self.modes]
        if not evidence or max(evidence) <= 0.0:
            return self.with_sensor(WHITE, self.white)
        best = int(np.argmax(evidence))
        kind, _ = self.kinds[best]
        point = self.modes[best].point
        return self.with_sensor(kind(point, self.scale), self.density(kind, point)[1])

    def with_sensor(self, noise: Noise, fit: NoiseFit) -> tuple[Noise, NoiseFit]:
        """A noise whose white part has at least its least variance, and the residual's fit with that noise."""
        shortage = self.least_white - (1.0 - noise.share) * fit.variance
        if shortage <= 0.0:
            return noise, fit
        variance = fit.variance + shortage
        noise = noise._replace(share=noise.share * fit.variance / variance)
        products = weighted_products(noise, self.times, self.columns)[0] / variance
        return noise, fit._replace(variance=variance, information=products[1:, 1:], gradient=products[1:, 0])

    def posterior(self) -> NoisePosterior:
        """All noises that the residual allows, by importance sampling around the modes."""
        logs = [math.log(WHITE_PRIOR)]
        fits = [self.with_sensor(WHITE, self.white)]
        for (kind, _), mode in zip(self.kinds, self.modes, strict=True):
            points, log_proposals = drawn_points(mode)
            for point, log_proposed in zip(points, log_proposals, strict=True):
                log_density, fit = self.density(kind, point)
                logs.append(math.log((1.0 - WHITE_PRIOR) / len(NOISE_KINDS) / len(points)) + log_density - log_proposed)
                fits.append(self.with_sensor(kind(point, self.scale), fit))
        weights = np.exp(np.array(logs) - max(logs))
        weights /= weights.sum()
        candidates = [
            Candidate(noise, weight, fit) for weight, (noise, fit) in zip(weights.tolist(), fits, strict=True)
        ]
        return NoisePosterior(*self.likeliest(), float(weights[0]), tuple(candidates))
