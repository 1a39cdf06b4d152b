"""Noise that is correlated in time, observed at any times: its likelihood, and least squares with it.

Noise of unit variance is white but for a share c of its variance, whose correlation over a lag tau is that of a
first-order or of a second-order system driven by white noise, or which is the integral of a first-order one:

    exp(-tau/T)                                                                        first order
    exp(-zeta w) (cos(nu w) + zeta sin(nu w)/nu), w = tau/T, nu^2 = 1 - zeta^2         second order
    p' = v/T, T v' = -v + white noise, p = v = 0 before the first reading              drift

All are Markov in their states, whose joint precision matrix over n times is banded. Likelihood and normal equations
therefore take O(n) operations. At equal gaps the first order without a white part is an autoregression of order 1.

References:
    B. C. Kelly and others, "Flexible and scalable methods for quantifying stochastic variability", Astrophysical J. 788
        (2014) 33.
    D. A. Harville, "Maximum likelihood approaches to variance component estimation", J. American Statistical
        Association 72 (1977) 320-338.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

SHORT = 0.3  # share of a time constant: below, a quadrature, which does not cancel, gives a gap's process noise
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)
EQUAL_GAPS = 1e-9  # relative difference of gaps that are the same but for rounding
RANK = 1e-10  # share of the largest eigenvalue: below, a combination of numbers does not show


class FirstOrder(NamedTuple):
    """Correlation exp(-tau/T).

    Args:
        share: Share c of the variance that is correlated, 0 to below 1.
        time: T [s].
    """

    share: float
    time: float

    def transition(self, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition of the state over gaps [s], and the variance that the gap adds; shape (n, 1, 1) each."""
        w = (gaps / self.time)[:, None, None]
        return np.exp(-w), -np.expm1(-2.0 * w)

    def correlation(self, lags: np.ndarray) -> np.ndarray:
        """Correlation of the correlated part over lags [s], of their shape."""
        return np.exp(-np.abs(lags) / self.time)


class SecondOrder(NamedTuple):
    """Correlation of a second-order system's output; the state is the output and T times its derivative.

    Args:
        share: Share c of the variance that is correlated, 0 to below 1.
        time: T, one over the natural frequency [s].
        damping: zeta, above 0 and below 1.
    """

    share: float
    time: float
    damping: float

    def transition(self, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition of the state over gaps [s], and the covariance that the gap adds; shape (n, 2, 2) each."""
        w = gaps / self.time
        transition = self.transition_over(w)
        covariance = np.eye(2) - transition @ transition.transpose(0, 2, 1)
        short = w < SHORT
        if short.any():
            half = 0.5 * w[short, None]
            response = self.transition_over((half * (1.0 + NODES)).ravel())[:, :, 1].reshape(-1, len(NODES), 2)
            weights = 4.0 * self.damping * half * WEIGHTS
            covariance[short] = np.einsum("nk,nki,nkj->nij", weights, response, response)
        return transition, covariance

    def transition_over(self, w: np.ndarray) -> np.ndarray:
        """Transition of the state over w time constants, shape (n, 2, 2)."""
        cosine, sine = self.oscillation(w)
        rows = [[cosine + self.damping * sine, sine], [-sine, cosine - self.damping * sine]]
        return np.array(rows).transpose(2, 0, 1)

    def oscillation(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """exp(-zeta w) cos(nu w) and exp(-zeta w) sin(nu w)/nu."""
        nu = math.sqrt((1.0 - self.damping) * (1.0 + self.damping))
        decay = np.exp(-self.damping * w)
        return decay * np.cos(nu * w), decay * w * np.sinc(nu * w / np.pi)

    def correlation(self, lags: np.ndarray) -> np.ndarray:
        """Correlation of the correlated part over lags [s], of their shape."""
        cosine, sine = self.oscillation(np.abs(lags) / self.time)
        return cosine + self.damping * sine


class Drift(NamedTuple):
    """The integral of first-order noise, which starts at 0: what noise within a velocity loop makes of the position.

    Its variance grows with time; the mean over the span is 1. For a short T it is a random walk.

    Args:
        share: Share c of the variance that drifts, 0 to below 1.
        time: T, at most the span [s].
        span: From the beginning to the last reading [s].
    """

    share: float
    time: float
    span: float

    def transition(self, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition of (p, v) over gaps [s], and the covariance that the gap adds; shape (n, 2, 2) each."""
        w = gaps / self.time
        decay = np.exp(-w)
        transition = np.zeros((len(w), 2, 2))
        transition[:, 0, 0] = 1.0
        transition[:, 0, 1] = -np.expm1(-w)
        transition[:, 1, 1] = decay
        # of p with the driving noise sqrt(2) of v: 2 int (1 - exp(-s))^2, and so on, over 0 < s < w
        position = np.where(w < SHORT, small_drift(w), 2.0 * w - 3.0 + 4.0 * decay - decay**2)
        position_speed = np.expm1(-w) ** 2
        speed = -np.expm1(-2.0 * w)
        covariance = np.stack([np.stack([position, position_speed], -1), np.stack([position_speed, speed], -1)], -1)
        scale = np.array([1.0 / math.sqrt(self.mean_square), 1.0])
        transition[:, 0, 1] *= scale[0]
        return transition, covariance * np.outer(scale, scale)

    @property
    def mean_square(self) -> float:
        """The variance of the integral of v/T, averaged over the span; v has variance 1."""
        w = self.span / self.time
        decay = math.exp(-w)
        return w - 3.0 + (4.0 * (1.0 - decay) - 0.5 * (1.0 - decay**2)) / w

    def covariance(self, first: np.ndarray | float, second: np.ndarray | float) -> np.ndarray:
        """Covariance of the correlated part at two times from the beginning [s], of their broadcast shape."""
        early = np.minimum(first, second) / self.time
        decay = np.exp(-early)
        at = np.where(early < SHORT, small_drift(early), 2.0 * early - 3.0 + 4.0 * decay - decay**2)
        relaxation = -np.expm1(-np.abs(first - second) / self.time)
        return (at + np.expm1(-early) ** 2 * relaxation) / self.mean_square


def small_drift(w: np.ndarray) -> np.ndarray:
    """2 w - 3 + 4 exp(-w) - exp(-2 w) by its series, for small w."""
    coefficients = [2.0 / 3.0, -1.0 / 2.0, 7.0 / 30.0, -1.0 / 12.0, 31.0 / 1260.0, -1.0 / 160.0]
    return w**3 * np.polynomial.polynomial.polyval(w, coefficients)


WHITE = FirstOrder(0.0, 1.0)
Noise = FirstOrder | SecondOrder | Drift


def correlation_time(noise: Noise) -> float:
    """The smallest lag at which the correlated part's correlation is 1/e [s]; 0 for white noise.

    Of a drift it is that with its last value.
    """
    if noise.share == 0.0:
        return 0.0
    if isinstance(noise, Drift):
        ago = np.linspace(0.0, noise.span, 2001)[:-1]
        times = noise.span - ago
        sizes = np.sqrt(noise.covariance(times, times) * noise.covariance(noise.span, noise.span))
        return float(ago[np.argmax(noise.covariance(times, noise.span) <= math.exp(-1.0) * sizes)])
    lags = noise.time * np.linspace(0.0, 5.0, 2001)
    has_decayed = noise.correlation(lags) <= math.exp(-1.0)
    return float(lags[np.argmax(has_decayed)])


def independent_samples(noise: Noise, times: np.ndarray, limit: int = 800) -> float:
    """Number of independent samples that determine the noise's variance as precisely as the samples at ``times``.

    Args:
        noise: The noise.
        times: Times of observation [s], shape (n,).
        limit: Largest number of observations to use, evenly chosen; all others count in proportion.
    """
    if noise.share == 0.0 or len(times) < 2:
        return float(len(times))
    stride = -(-len(times) // limit)
    white = 1.0 - noise.share
    if isinstance(noise, Drift):
        from_start = times - times[0] + np.median(np.diff(times))
        correlated = noise.share * noise.covariance(from_start[:, None], from_start[None, ::stride])
        variance = noise.share * noise.covariance(from_start, from_start)
    else:
        correlated = noise.share * noise.correlation(times[:, None] - times[None, ::stride])
        variance = np.full(len(times), noise.share)
    sampled_variance = variance[::stride]
    squares = np.square(correlated).sum() + (2.0 * white * sampled_variance + white**2).sum()
    return float((variance + white).sum() * (sampled_variance + white).sum() / squares)


def precision(noise: Noise, times: np.ndarray) -> tuple[np.ndarray, float, int]:
    """Joint precision matrix of the states at the times, for noise of unit variance.

    A drift starts at 0 one median gap before the first time.

    Returns:
        - The lower bands of the matrix, as SciPy stores them, shape (2 p, n p).
        - The logarithm of its determinant.
        - p, the length of a state.
    """
    gaps = np.diff(times)
    median_gap = np.array([np.median(gaps)])
    if np.ptp(gaps) <= EQUAL_GAPS * gaps[0]:
        gaps = gaps[:1]  # one transition serves all gaps
    transition, covariance = noise.transition(gaps)
    size = transition.shape[-1]
    initial_covariance = noise.transition(median_gap)[1][0] if isinstance(noise, Drift) else np.eye(size)
    # each gap adds the square of (next state - transition state), weighted by the inverse of its covariance
    inverse = np.linalg.inv(covariance)
    below = -inverse @ transition
    diagonal = np.tile(np.linalg.inv(initial_covariance), (len(times), 1, 1))
    diagonal[1:] = inverse
    diagonal[:-1] += transition.transpose(0, 2, 1) @ -below
    gap_log_determinants = np.linalg.slogdet(covariance)[1]
    initial_log_determinant = float(np.linalg.slogdet(initial_covariance)[1])
    log_determinant = -(len(times) - 1) * float(gap_log_determinants.mean()) - initial_log_determinant
    return lower_bands(diagonal, below), log_determinant, size


def lower_bands(diagonal: np.ndarray, below: np.ndarray) -> np.ndarray:
    """Lower bands, as SciPy stores them, of a symmetric block-tridiagonal matrix; shape (2 p, n p).

    Args:
        diagonal: The blocks on the diagonal, shape (n, p, p).
        below: The blocks below it, shape (n - 1, p, p); (1, p, p) if all are the same.
    """
    count, size, _ = diagonal.shape
    bands = np.zeros((2 * size, count, size))
    for column in range(size):
        for row in range(column, size):
            bands[row - column, :, column] = diagonal[:, row, column]
        for row in range(size):
            bands[size + row - column, :-1, column] = below[:, row, column]
    return bands.reshape(2 * size, -1)


def weighted_products(noise: Noise, times: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, float]:
    """Columns' products, weighted by the inverse of the noise's covariance S of unit variance.

    Args:
        noise: The noise.
        times: Times of observation, rising [s], shape (n,).
        columns: Shape (n, m).

    Returns:
        columns' S^-1 columns, shape (m, m), and log det S.
    """
    plain = columns.T @ columns
    if noise.share == 0.0:
        return plain, 0.0
    white = 1.0 - noise.share
    bands, log_det_precision, size = precision(noise, times)
    bands *= white / noise.share
    bands[0, ::size] += 1.0
    factor = cholesky_banded(bands, lower=True, check_finite=False)
    spread = np.zeros((len(times), size, columns.shape[1]))
    spread[:, 0] = columns
    solution = cho_solve_banded((factor, True), spread.reshape(-1, columns.shape[1]), check_finite=False)[::size]
    log_det = len(times) * (math.log(white) - size * math.log(white / noise.share)) - log_det_precision
    return (plain - columns.T @ solution) / white, log_det + 2.0 * float(np.log(factor[0]).sum())


class NoiseFit(NamedTuple):
    """How well a noise explains a channel's residual, and what that tells of the fitted numbers.

    Args:
        log_likelihood: Logarithm of the restricted likelihood: the fitted numbers and the noise's variance are
            integrated out.
        variance: Variance of the noise.
        information: Information matrix of the fitted numbers, shape (p, p).
        gradient: Information matrix times the best change of the fitted numbers, shape (p,).
    """

    log_likelihood: float
    variance: float
    information: np.ndarray
    gradient: np.ndarray


def fit_noise(noise: Noise, times: np.ndarray, columns: np.ndarray, floor: float = 0.0) -> NoiseFit:
    """The restricted likelihood of a residual's noise, and the least squares with it.

    The numbers and the noise's variance are integrated out, with a flat law of the numbers and of the variance's
    logarithm. A combination of the numbers on which the residual does not depend is left out. The variance is its
    posterior mean.

    Args:
        noise: The noise; its variance is estimated.
        times: Times of observation, rising [s], shape (n,).
        columns: The residual, and the slopes of the prediction by each of p numbers, shape (n, 1 + p).
        floor: Least variance.
    """
    products, log_det = weighted_products(noise, times, columns)
    information = products[1:, 1:]
    gradient = products[1:, 0]
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    values, vectors = np.linalg.eigh(information / np.outer(scale, scale))
    is_determined = values > RANK * max(float(values[-1]), 1e-300) if len(values) else np.zeros(0, bool)
    projections = vectors[:, is_determined].T @ (gradient / scale)
    square = float(products[0, 0] - np.sum(projections**2 / values[is_determined]))
    freedom = len(times) - int(is_determined.sum())
    square = max(square, floor * freedom, 1e-300)
    log_det += float(np.log(values[is_determined]).sum()) + 2.0 * float(np.log(scale).sum())
    variance = square / max(freedom - 2, 1)
    log_likelihood = -0.5 * (log_det + freedom * math.log(square))
    return NoiseFit(log_likelihood, variance, information / variance, gradient / variance)
