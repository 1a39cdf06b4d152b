"""The least-squares problem of a logged flight: residual, its colour, and the minimum by Gauss-Newton.

References:
    B. Efron, R. J. Tibshirani, An Introduction to the Bootstrap (1993), sections 6.5 and 12.5.
    J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), section 10.3.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import special

from dssc_jax.flight.prediction import Prediction
from dssc_jax.statistics.autoregression import ar_coefficients, ar_process, whitened
from dssc_jax.study import Law, Study
from dssc_jax.study.laws import LOGARITHMIC

ITERATIONS, FILTERINGS = 40, 5
LARGEST_STEP = 2.0  # prior standard deviations in one iteration
NORMAL_90 = float(special.ndtri(0.95))
REPLICATES, SETTLING = 80, 200  # of the residual; samples before its first
LEAST_NOISE = 1e-9  # of the output's size: below, the residual is rounding


def fit_scale(law: Law, values: Any) -> np.ndarray:
    """Values on the scale of the fit."""
    return np.log(values) if law.kind in LOGARITHMIC else np.asarray(values, float)


def unscaled(law: Law, values: Any) -> np.ndarray:
    """The inverse of :func:`scale`."""
    return np.exp(values) if law.kind in LOGARITHMIC else np.asarray(values, float)


def prior_width(law: Law) -> float:
    """Standard deviation, on the scale of the fit, of a normal law with the same quantiles of 5 and 95 %."""
    low, high = fit_scale(law, law.quantile(np.array([0.05, 0.95])))
    return float(high - low) / (2.0 * NORMAL_90)


@dataclass
class FitProblem:
    """The least-squares problem of one log; coordinates are distances from the medians in prior widths.

    Args:
        study: The study.
        names: The numbers.
        predict: Their prediction.
        logged: Measured outputs, NaN where missing, shape (channels, samples).
        commands: Logged commands, shape (channels, samples).
    """

    study: Study
    names: Sequence[str]
    predict: Prediction
    logged: np.ndarray
    commands: np.ndarray

    def __post_init__(self) -> None:
        self.laws = [self.study.laws[name] for name in self.names]
        self.widths = np.array([prior_width(law) for law in self.laws])
        self.middles = np.array([fit_scale(law, law.median) for law in self.laws])
        channels = len(self.logged)
        self.filters = [np.zeros(0)] * channels
        self.noise = np.ones(channels)

    def values(self, at: np.ndarray) -> np.ndarray:
        """The numbers at coordinates."""
        return np.array(
            [float(unscaled(law, s)) for law, s in zip(self.laws, self.middles + at * self.widths, strict=True)]
        )

    def admissible(self, values: np.ndarray) -> bool:
        """Whether every number is in its range."""
        quantities = (self.study.numbers[name].quantity for name in self.names)
        return all(each.violated_by(x, x) is None for each, x in zip(quantities, values, strict=True))

    def residuals(self, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual, shape (channels, samples), and minus its derivative by the coordinates, shape (n, ...)."""
        values = self.values(at)
        predicted, slopes = self.predict(values, self.commands)
        chain = [
            w * (x if law.kind in LOGARITHMIC else 1.0)
            for law, w, x in zip(self.laws, self.widths, values, strict=True)
        ]
        return self.logged - predicted, slopes * np.array(chain)[:, None, None]

    def filtered(self, residual: np.ndarray, slopes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """White residuals of unit variance, shape (m,), and their slopes, shape (m, n)."""
        parts = []
        for channel, (own, noise) in enumerate(zip(self.filters, self.noise, strict=True)):
            rows = np.concatenate([residual[channel][:, None], slopes[:, channel].T], axis=1)
            rows = whitened(rows, own) / noise
            parts.append(rows[np.isfinite(rows).all(axis=1)])
        rows = np.concatenate(parts)
        return rows[:, 0], rows[:, 1:]

    def reweighted(self, residual: np.ndarray) -> None:
        """Estimate the residual's autoregression and noise."""
        for channel, own in enumerate(residual):
            if np.isfinite(own).sum() < 20:
                continue
            self.filters[channel] = ar_coefficients(own)
            white = whitened(own, self.filters[channel])
            count = np.isfinite(white).sum() - len(self.names)
            floor = LEAST_NOISE * max(float(np.nanmax(np.abs(self.logged[channel]))), 1e-300)
            self.noise[channel] = max(math.sqrt(float(np.nansum(white**2)) / max(count, 1)), floor)


def minimised(problem: FitProblem, at: np.ndarray) -> np.ndarray:
    """Gauss-Newton with Levenberg's damping, from coordinates on."""
    damping = 1e-3
    residual, slopes = problem.filtered(*problem.residuals(at))
    cost = float(residual @ residual)
    for _ in range(ITERATIONS):
        information, gradient = slopes.T @ slopes, slopes.T @ residual
        least = 1e-12 * max(float(np.diag(information).max()), 1e-300)
        damped = information + damping * np.diag(np.maximum(np.diag(information), least))
        move = np.linalg.lstsq(damped, gradient, rcond=None)[0]
        move *= min(1.0, LARGEST_STEP / max(float(np.abs(move).max()), 1e-300))
        tried = at + move
        if problem.admissible(problem.values(tried)):
            new_residual, new_slopes = problem.filtered(*problem.residuals(tried))
            new = float(new_residual @ new_residual) if len(new_residual) == len(residual) else math.inf
        else:
            new, new_residual, new_slopes = math.inf, residual, slopes
        if new <= cost:
            done = float(np.abs(move).max()) < 1e-8 or cost - new < 1e-12 * cost
            at, residual, slopes, cost, damping = tried, new_residual, new_slopes, new, 0.1 * damping
            if done:
                break
        else:
            damping *= 10.0
            if damping > 1e12 or float(np.abs(move).max()) < 1e-12:
                break
    return at


def reweighted_fit(problem: FitProblem) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates of the estimate, and the information matrix there, with the residual's own colour."""
    at = np.zeros(len(problem.names))
    information = np.eye(len(at))
    for _ in range(FILTERINGS):
        before, at = at, minimised(problem, at)
        residual, slopes = problem.residuals(at)
        problem.reweighted(residual)
        white = problem.filtered(residual, slopes)[1]
        information = white.T @ white
        if np.abs(at - before).max() <= 1e-3 / math.sqrt(max(float(np.diag(information).max()), 1e-300)):
            break
    return at, information


def widening(problem: FitProblem, at: np.ndarray) -> np.ndarray:
    """Factors by which standard deviations exceed those of a residual of known colour; 1 where it is white.

    The colour is estimated from a residual that the numbers have been fitted to, so it looks whiter than the noise. A
    parametric bootstrap shows by how much that narrows the intervals: noise of the estimated colour is fitted by the
    linearised problem, in the same way, again and again.

    Args:
        problem: The problem, with the residual's estimated colour.
        at: Coordinates of the estimate.

    Returns:
        Root mean square of (estimate/its claimed standard deviation) over the replicates, at least 1, shape (n,).
    """
    if not any(len(own) for own in problem.filters):
        return np.ones(len(at))
    residual, slopes = problem.residuals(at)
    filters, noise, random = list(problem.filters), problem.noise.copy(), np.random.default_rng(0)
    ratios = []
    for _ in range(REPLICATES):
        shocks = random.normal(size=(len(residual), residual.shape[1] + SETTLING)) * noise[:, None]
        drawn = np.stack([ar_process(own, row)[SETTLING:] for own, row in zip(filters, shocks, strict=True)])
        drawn = np.where(np.isfinite(residual), drawn, np.nan)
        replicate = FitProblem(problem.study, problem.names, problem.predict, problem.logged, problem.commands)
        for _ in range(FILTERINGS - 1):
            white, own = replicate.filtered(drawn, slopes)
            change = np.linalg.lstsq(own, white, rcond=None)[0]
            replicate.reweighted(drawn - np.tensordot(change, slopes, axes=1))
        white, own = replicate.filtered(drawn, slopes)
        information = own.T @ own
        change = np.linalg.lstsq(information, own.T @ white, rcond=None)[0]
        ratios.append(change / np.sqrt(np.diag(np.linalg.pinv(information))))
    return np.maximum(1.0, np.sqrt(np.mean(np.square(ratios), axis=0)))
