"""Likelihood of noise that is correlated in time and observed at any times, and least squares under such noise.

Noise of unit variance is the sum of white noise and a correlated part with the share c of the variance. The correlated
part is the output of a first-order or second-order system driven by white noise, or the integral of first-order noise.
Its correlation over a lag tau, or its equation, is

    exp(-tau/T)                                                                        first order
    exp(-zeta w) (cos(nu w) + zeta sin(nu w)/nu), w = tau/T, nu^2 = 1 - zeta^2         second order
    p' = v/T, T v' = -v + white noise, p = v = 0 before the first reading              drift

These are Markov in their states, whose joint precision matrix over n times is banded. Likelihood and normal equations
therefore take O(n) operations. The correlated part may also have a shape that simulations show.

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

from dssc_jax.statistics.simulated_noise import SimulatedNoise

SHORT = 0.3  # gap in time constants below which the closed forms cancel; a quadrature or a series replaces them
NODES, WEIGHTS = np.polynomial.legendre.leggauss(6)
EQUAL_GAPS = 1e-9  # relative difference below which gaps count as equal
TINY = 1e-300  # in place of 0 in a denominator or a logarithm
RANK = 1e-10  # share of the largest eigenvalue below which a direction counts as undetermined


class FirstOrder(NamedTuple):
    """Noise whose correlated part is the output of a first-order system: correlation exp(-tau/T).

    Args:
        share: Share c of the variance in the correlated part, in [0, 1).
        time: Time constant T [s].
    """

    share: float
    time: float

    def transition(self, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition factor of the state over gaps [s], and the variance that each gap adds; shape (n, 1, 1) each."""
        w = (gaps / self.time)[:, None, None]  # gaps in time constants
        return np.exp(-w), -np.expm1(-2.0 * w)

    def correlation(self, lags: np.ndarray) -> np.ndarray:
        """Autocorrelation of the correlated part at lags [s], any shape."""
        return np.exp(-np.abs(lags) / self.time)


class SecondOrder(NamedTuple):
    """Noise whose correlated part is the output of a second-order system; its state is (output, T times its rate).

    Args:
        share: Share c of the variance in the correlated part, in [0, 1).
        time: Reciprocal T of the natural frequency [s].
        damping: Damping ratio zeta, in (0, 1).
    """

    share: float
    time: float
    damping: float

    def transition(self, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition matrices F of the state over gaps [s], and the covariance that each gap adds; (n, 2, 2) each.

        The covariance is 1 - F F'. Over short gaps the difference cancels, so there it is computed as the integral of 4
        zeta r r' over the gap, by Gauss-Legendre quadrature, where r is the response of the state to an impulse.

        Args:
            gaps: Times between observations [s], shape (n,).
        """
        w = gaps / self.time
        transition = self.transition_over(w)
        covariance = np.eye(2) - transition @ transition.transpose(0, 2, 1)
        short = w < SHORT
        if short.any():
            half = 0.5 * w[short, None]
            nodes = half * (1.0 + NODES)  # shape (short gaps, nodes)
            response = self.transition_over(nodes.ravel())[:, :, 1].reshape(*nodes.shape, 2)
            weights = 4.0 * self.damping * half * WEIGHTS
            covariance[short] = np.einsum("nk,nki,nkj->nij", weights, response, response)
        return transition, covariance

    def transition_over(self, w: np.ndarray) -> np.ndarray:
        """Transition matrices of the state over w time constants T, shape (n, 2, 2).

        Args:
            w: Duration in time constants T, shape (n,).
        """
        cosine, sine = self.oscillation(w)
        output = [cosine + self.damping * sine, sine]
        rate = [-sine, cosine - self.damping * sine]
        return np.array([output, rate]).transpose(2, 0, 1)

    def oscillation(self, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The functions exp(-zeta w) cos(nu w) and exp(-zeta w) sin(nu w)/nu of w time constants, each of w's shape."""
        nu = math.sqrt((1.0 - self.damping) * (1.0 + self.damping))
        decay = np.exp(-self.damping * w)
        return decay * np.cos(nu * w), decay * w * np.sinc(nu * w / np.pi)

    def correlation(self, lags: np.ndarray) -> np.ndarray:
        """Autocorrelation of the correlated part at lags [s], any shape."""
        cosine, sine = self.oscillation(np.abs(lags) / self.time)
        return cosine + self.damping * sine


class Drift(NamedTuple):
    """Noise whose correlated part p, the drift, is the integral of first-order noise v; both start at 0.

    Noise inside a velocity loop drives the position like this. The variance of p grows with time. p is scaled so that
    its variance has the mean 1 over the span. For a short T the drift is a random walk.

    Args:
        share: Share c of the variance in the drift, in [0, 1).
        time: Time constant T of the first-order noise, at most the span [s].
        span: Time from the start of the drift to the last reading [s].
    """

    share: float
    time: float
    span: float

    def transition(self, gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Transition matrices of the state (p, v) over gaps [s], and the covariance of each gap; (n, 2, 2) each."""
        w = gaps / self.time
        p_scale = 1.0 / math.sqrt(self.mean_square)
        transition = np.zeros((len(w), 2, 2))
        transition[:, 0, 0] = 1.0
        transition[:, 0, 1] = -np.expm1(-w) * p_scale
        transition[:, 1, 1] = np.exp(-w)
        # v is driven by white noise of intensity 2, so the entries are integrals over 0 < s < w
        covariance = np.empty((len(w), 2, 2))
        covariance[:, 0, 0] = drift_variance(w)  # of 2 (1 - exp(-s))^2
        covariance[:, 0, 1] = np.expm1(-w) ** 2  # of 2 (1 - exp(-s)) exp(-s)
        covariance[:, 1, 0] = covariance[:, 0, 1]
        covariance[:, 1, 1] = -np.expm1(-2.0 * w)  # of 2 exp(-2 s)
        scale = np.array([p_scale, 1.0])
        return transition, covariance * np.outer(scale, scale)

    @property
    def mean_square(self) -> float:
        """Mean over the span of the variance of the unscaled p, for a v whose variance tends to 1."""
        w = self.span / self.time
        decay = math.exp(-w)
        return w - 3.0 + (4.0 * (1.0 - decay) - 0.5 * (1.0 - decay**2)) / w

    def covariance(self, first: np.ndarray | float, second: np.ndarray | float) -> np.ndarray:
        """Covariance of the drift p between two times, of the times' broadcast shape.

        Given the rate v at the earlier time, p is expected to change by v (1 - exp(-w)) over the next w time constants
        T.

        Args:
            first: Time since the start of the drift [s].
            second: The other time [s], earlier or later.
        """
        earlier = np.minimum(first, second) / self.time
        relaxation = -np.expm1(-np.abs(first - second) / self.time)
        return (drift_variance(earlier) + np.expm1(-earlier) ** 2 * relaxation) / self.mean_square


def drift_variance(w: np.ndarray) -> np.ndarray:
    """Variance 2 w - 3 + 4 exp(-w) - exp(-2 w) of an unscaled drift after w time constants, of the shape of w.

    For small w the terms cancel; there the power series of the sum is used.
    """
    decay = np.exp(-w)
    # of w^3, w^4, ...
    coefficients = [2.0 / 3.0, -1.0 / 2.0, 7.0 / 30.0, -1.0 / 12.0, 31.0 / 1260.0, -1.0 / 160.0]
    series = w**3 * np.polynomial.polynomial.polyval(w, coefficients)
    return np.where(w < SHORT, series, 2.0 * w - 3.0 + 4.0 * decay - decay**2)


WHITE = FirstOrder(share=0.0, time=1.0)  # without a correlated part, the time constant does not matter
Noise = FirstOrder | SecondOrder | Drift | SimulatedNoise


def correlation_time(noise: Noise) -> float:
    """Smallest lag at which the autocorrelation of the correlated part falls to 1/e [s]; 0 for white noise.

    A drift and a simulated noise are not stationary: their lags count back from the last reading.
    """
    if noise.share == 0.0:
        return 0.0
    if isinstance(noise, SimulatedNoise):
        return noise.shape.correlation_time
    if isinstance(noise, Drift):
        lags = np.linspace(0.0, noise.span, 2001)[:-1]
        times = noise.span - lags
        sizes = np.sqrt(noise.covariance(times, times) * noise.covariance(noise.span, noise.span))
        has_decayed = noise.covariance(times, noise.span) <= math.exp(-1.0) * sizes
        return float(lags[np.argmax(has_decayed)])  # the first True
    lags = noise.time * np.linspace(0.0, 5.0, 2001)
    has_decayed = noise.correlation(lags) <= math.exp(-1.0)
    return float(lags[np.argmax(has_decayed)])


def independent_samples(noise: Noise, times: np.ndarray, limit: int = 800) -> float:
    """Effective sample size: the number of independent samples that determine the variance as precisely as these n.

    With the covariance S of the noise it is (tr S)^2/tr(S^2).

    Args:
        noise: Noise of unit variance.
        times: Times of observation [s], shape (n,).
        limit: Largest number of columns of S to compute; evenly spaced columns stand for all.
    """
    if noise.share == 0.0 or len(times) < 2:
        return float(len(times))
    if isinstance(noise, SimulatedNoise):
        return noise.independent_samples
    stride = math.ceil(len(times) / limit)
    white = 1.0 - noise.share
    if isinstance(noise, Drift):
        from_start = times - times[0] + np.median(np.diff(times))
        correlated = noise.share * noise.covariance(from_start[:, None], from_start[None, ::stride])
        variance = noise.share * noise.covariance(from_start, from_start)
    else:
        correlated = noise.share * noise.correlation(times[:, None] - times[None, ::stride])
        variance = np.full(len(times), noise.share)
    sampled_variance = variance[::stride]
    trace = (variance + white).sum()
    sampled_trace = (sampled_variance + white).sum()
    # white noise is on the diagonal of S only, where it adds 2 white variance + white^2 to the squares
    sampled_squares = np.square(correlated).sum() + (2.0 * white * sampled_variance + white**2).sum()
    return float(trace * sampled_trace / sampled_squares)


class StatePrecision(NamedTuple):
    """Precision matrix of the states of a noise's correlated part at n times together.

    Args:
        bands: Lower bands of the matrix, as SciPy stores them, shape (2 p, n p).
        log_determinant: Logarithm of the matrix's determinant.
        size: Length p of a state.
    """

    bands: np.ndarray
    log_determinant: float
    size: int


def state_precision(noise: FirstOrder | SecondOrder | Drift, times: np.ndarray) -> StatePrecision:
    """Precision matrix of the states of the correlated part at all times together, for a variance of 1.

    A drift starts at 0 a median gap before the first time.

    Args:
        noise: The noise; its share does not matter.
        times: Times of observation, rising [s], shape (n,).
    """
    gaps = np.diff(times)
    median_gap = np.array([np.median(gaps)])
    if np.ptp(gaps) <= EQUAL_GAPS * gaps[0]:
        gaps = gaps[:1]  # the same transition serves all gaps
    transition, covariance = noise.transition(gaps)
    size = transition.shape[-1]
    initial_covariance = np.eye(size)
    if isinstance(noise, Drift):
        _, added_covariances = noise.transition(median_gap)
        initial_covariance = added_covariances[0]
    # each gap adds the square of (next state - F state), weighted by Q^-1, with the transition F and the covariance Q
    inverse = np.linalg.inv(covariance)
    subdiagonal = -inverse @ transition  # -Q^-1 F
    diagonal = np.tile(np.linalg.inv(initial_covariance), (len(times), 1, 1))
    diagonal[1:] = inverse
    diagonal[:-1] += transition.transpose(0, 2, 1) @ -subdiagonal  # F' Q^-1 F
    _, gap_log_determinants = np.linalg.slogdet(covariance)
    _, initial_log_determinant = np.linalg.slogdet(initial_covariance)
    log_determinant = -(len(times) - 1) * float(gap_log_determinants.mean()) - float(initial_log_determinant)
    return StatePrecision(lower_bands(diagonal, subdiagonal), log_determinant, size)


def lower_bands(diagonal: np.ndarray, subdiagonal: np.ndarray) -> np.ndarray:
    """Lower bands of a symmetric block-tridiagonal matrix, as SciPy stores them, shape (2 p, n p).

    Row k of the bands has the elements k places below the diagonal.

    Args:
        diagonal: Blocks on the diagonal, shape (n, p, p).
        subdiagonal: Blocks below the diagonal, shape (n - 1, p, p); (1, p, p) if all are equal.
    """
    count, size, _ = diagonal.shape
    bands = np.zeros((2 * size, count, size))
    for column in range(size):
        for row in range(column, size):
            bands[row - column, :, column] = diagonal[:, row, column]
        for row in range(size):
            bands[size + row - column, :-1, column] = subdiagonal[:, row, column]
    return bands.reshape(2 * size, -1)


def weighted_products(noise: Noise, times: np.ndarray, columns: np.ndarray) -> tuple[np.ndarray, float]:
    """Products C' S^-1 C of columns C, weighted by the inverse of the noise's covariance S, by banded matrices.

    Args:
        noise: Noise of unit variance.
        times: Times of observation, rising [s], shape (n,).
        columns: Matrix C, shape (n, m).

    Returns:
        The products, shape (m, m), and log det S.
    """
    if isinstance(noise, SimulatedNoise):
        return noise.weighted_products(times, columns)
    plain = columns.T @ columns
    if noise.share == 0.0:
        return plain, 0.0
    white = 1.0 - noise.share
    bands, log_det_precision, size = state_precision(noise, times)
    # S = share H P^-1 H' + white 1, where H reads the outputs from the states, of precision P; with the matrix
    # M = H' H + white/share P, S^-1 = (1 - H M^-1 H')/white and det S = white^n (share/white)^(n p) det M/det P
    bands *= white / noise.share
    bands[0, ::size] += 1.0  # H' H: 1 on the diagonal at the output of each state
    factor = cholesky_banded(bands, lower=True, check_finite=False)
    log_det_m = 2.0 * float(np.log(factor[0]).sum())
    state_columns = np.zeros((len(times), size, columns.shape[1]))
    state_columns[:, 0] = columns  # H' C: the output comes first in a state
    right_sides = state_columns.reshape(-1, columns.shape[1])
    outputs = cho_solve_banded((factor, True), right_sides, check_finite=False)[::size]  # H M^-1 H' C
    log_det = len(times) * (math.log(white) - size * math.log(white / noise.share)) - log_det_precision
    return (plain - columns.T @ outputs) / white, log_det + log_det_m


class NoiseFit(NamedTuple):
    """Generalised least squares of a channel's residual under a kind of noise.

    Args:
        log_likelihood: Logarithm of the restricted likelihood, in which the p fitted numbers and the variance of the
            noise are integrated out.
        variance: Estimated variance of the noise.
        information: Information matrix of the fitted numbers, shape (p, p).
        gradient: Right-hand side of the normal equations: the information matrix times the best change of the fitted
            numbers, shape (p,).
    """

    log_likelihood: float
    variance: float
    information: np.ndarray
    gradient: np.ndarray


def fit_noise(noise: Noise, times: np.ndarray, columns: np.ndarray, floor: float = 0.0) -> NoiseFit:
    """Fit numbers to a residual under a given noise, by generalised least squares and restricted likelihood.

    The fitted numbers and the variance of the noise are integrated out, under flat priors for the numbers and for the
    logarithm of the variance. Directions of the numbers on which the residual does not depend are left out. The
    returned variance is the posterior mean.

    Args:
        noise: Correlation of the noise; its variance is estimated.
        times: Times of observation, rising [s], shape (n,).
        columns: Residual, and derivatives of the prediction by each of p numbers, shape (n, 1 + p).
        floor: Lower limit of the variance.
    """
    products, log_det = weighted_products(noise, times, columns)
    information = products[1:, 1:]  # up to the variance, as the gradient
    gradient = products[1:, 0]
    scale = np.sqrt(np.maximum(np.diag(information), TINY))
    eigenvalues, eigenvectors = np.linalg.eigh(information / np.outer(scale, scale))
    is_determined = np.zeros(0, bool)  # without fitted numbers
    if len(eigenvalues):
        is_determined = eigenvalues > RANK * max(float(eigenvalues[-1]), TINY)
    determined_eigenvalues = eigenvalues[is_determined]
    projections = eigenvectors[:, is_determined].T @ (gradient / scale)
    fitted_square = float(products[0, 0] - np.sum(projections**2 / determined_eigenvalues))  # residual after the fit
    freedom = len(times) - len(determined_eigenvalues)
    square = max(fitted_square, floor * freedom, TINY)
    log_det += float(np.log(determined_eigenvalues).sum()) + 2.0 * float(np.log(scale).sum())
    variance = square / max(freedom - 2, 1)
    log_likelihood = -0.5 * (log_det + freedom * math.log(square))
    return NoiseFit(log_likelihood, variance, information / variance, gradient / variance)
