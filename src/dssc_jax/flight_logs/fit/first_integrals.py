"""Whether the integrals of the software on board began a logged flight as in the study, by the outputs.

Other integrals at the first sample change the output in a way that the fitted numbers can hardly imitate. One
Gauss-Newton step over the fitted numbers and the integrals tells both how large the integrals were and how far the
estimates would move.
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.refusals import FitRefused
from dssc_jax.flight_logs.fit.shifts import Delay
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.hints.starts import fixed_integrals, start_remedy
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning
from dssc_jax.statistics.correlated_noise import weighted_products
from dssc_jax.study import Study

SIGNIFICANCE = 1e-4  # p-value below which integrals differ from those of the study
LARGE_MOVE = 1.0  # least move of an estimate by free integrals that matters, in its standard deviations
LARGE_PART = 0.5  # share of a channel's residual that may be left if integrals explain it
ROUNDING = 1e-9  # share of the information along each coordinate that is added, against rounding


class StartsElsewhere(FitRefused):
    """The flight's integrals at the first sample are not those of the study; the message has the numbers."""


class FreeIntegrals(NamedTuple):
    """The integrals at the first sample, estimated together with the numbers of a fit.

    Args:
        names: Names of the integrals.
        values: Value of each integral that the flight shows, to first order.
        deviations: Standard deviations of these values.
        p_value: Probability of as large a reduction of the sum of squares if the study's integrals were right.
        moves: How far the estimates would move, by number, in their standard deviations.
        residuals: Root mean square of the residual with these integrals, to first order, by position of the channel.
        falls: The same over the root mean square with the study's integrals, by position of the channel.
    """

    names: tuple[str, ...]
    values: np.ndarray
    deviations: np.ndarray
    p_value: float
    moves: dict[str, float]
    residuals: dict[int, float]
    falls: dict[int, float]

    @property
    def differ_and_matter(self) -> bool:
        """Whether the flight's integrals differ from the study's, and this moves an estimate far."""
        return self.p_value < SIGNIFICANCE and max(map(abs, self.moves.values())) > LARGE_MOVE

    @property
    def values_text(self) -> str:
        """The integrals with their standard deviations, in words."""
        rows = zip(self.names, self.values, self.deviations, strict=True)
        return ", ".join(f"{name} = {value:.3g} ± {deviation:.2g}" for name, value, deviation in rows)

    @property
    def explain_much(self) -> bool:
        """Whether the integrals leave a small part of the residual of any channel."""
        return min(self.falls.values()) < LARGE_PART

    def leave_less_than(self, delay: Delay) -> bool:
        """Whether the integrals explain the residuals of all channels better than a delay, if these are white noise."""
        shifted = dict(zip(delay.channels, delay.shifted, strict=True))
        difference = 0.0  # of the logarithms of the likelihoods, up to a factor
        for channel, residual in self.residuals.items():
            unshifted = residual / max(self.falls[channel], TINY)
            difference += math.log(max(residual, TINY)) - math.log(max(shifted.get(channel, unshifted), TINY))
        return difference < 0.0

    def explain_more_than(self, delay: Delay | None) -> bool:
        """Whether the integrals matter, explain much of the residual, and explain it better than a delay, if any."""
        is_cause = self.differ_and_matter and self.explain_much
        return is_cause and (delay is None or self.leave_less_than(delay))


class Step(NamedTuple):
    """A Gauss-Newton step over p numbers and q integrals.

    Args:
        change: Changes of the numbers' coordinates and of the integrals, shape (p + q,).
        deviations: Standard deviations of these changes, shape (p + q,).
        moves: Changes of the numbers, in the standard deviations that they have with the study's integrals, shape (p,).
        reduction: How much lower the weighted sum of squares is with free integrals than with those of the study.
    """

    change: np.ndarray
    deviations: np.ndarray
    moves: np.ndarray
    reduction: float


def free_integrals(problem: FitProblem, minimum: Minimum) -> FreeIntegrals | None:
    """Estimate the first integrals from the residual at a minimum, by one Gauss-Newton step.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.

    Returns:
        None if the study does not give its first integrals as plain numbers.
    """
    fixed_values = fixed_integrals(problem.study)
    if not fixed_values:
        return None
    study_integrals = np.array(list(fixed_values.values()))
    p = len(problem.names)
    # The prediction was compiled with the integrals as further inputs, so that it has the slopes by them, too.
    _, slopes = problem.predict(np.concatenate([problem.values(minimum.x), study_integrals]), problem.log.commands)
    products = np.zeros((1 + p + len(fixed_values),) * 2)
    columns_of_channel = {}
    rows = zip(problem.readings, problem.noises, problem.variances, problem.columns(minimum.x), strict=True)
    for readings, noise, variance, columns in rows:
        extended = np.column_stack([columns, readings.interpolate(slopes[p:, readings.channel]).T])
        products += weighted_products(noise, readings.times, extended)[0] / variance
        columns_of_channel[readings.channel] = extended
    products[1 : 1 + p, 0] -= problem.prior * minimum.x
    products[1 : 1 + p, 1 : 1 + p] += np.diag(problem.prior)
    step = gauss_newton_step(p, products)
    moves = dict(zip(problem.names, step.moves.tolist(), strict=True))
    residuals = {}
    falls = {}
    for channel, columns in columns_of_channel.items():
        residuals[channel] = rms(columns[:, 0] - columns[:, 1:] @ step.change)
        falls[channel] = residuals[channel] / max(rms(columns[:, 0]), TINY)
    return FreeIntegrals(
        names=tuple(fixed_values),
        values=study_integrals + step.change[p:],
        deviations=step.deviations[p:],
        p_value=float(stats.chi2.sf(step.reduction, len(fixed_values))),
        moves={name: moves[name] for name in problem.fitted_names},
        residuals=residuals,
        falls=falls,
    )


def gauss_newton_step(p: int, products: np.ndarray) -> Step:
    """The step to the minimum over numbers and integrals, from the products of residual and slopes.

    Args:
        p: Number of fitted numbers.
        products: Weighted products of the columns, shape (1 + p + q, 1 + p + q). The columns are the residual, its
            slopes by the numbers, and its slopes by the integrals.
    """
    scale = np.sqrt(np.maximum(np.diag(products)[1:], TINY))
    information = products[1:, 1:] / np.outer(scale, scale) + ROUNDING * np.eye(len(scale))
    gradient = products[1:, 0] / scale
    number_information = information[:p, :p]
    inverse = np.linalg.inv(information)
    step = inverse @ gradient
    return Step(
        change=step / scale,
        deviations=np.sqrt(np.diag(inverse)) / scale,
        moves=step[:p] / np.sqrt(np.diag(np.linalg.inv(number_information))),
        reduction=float(gradient @ step - gradient[:p] @ np.linalg.solve(number_information, gradient[:p])),
    )


def integral_doubt(problem: FitProblem, integrals: FreeIntegrals) -> SignalWarning:
    """The doubt about integrals at the first sample that the outputs show, with the remedy.

    Args:
        problem: The problem.
        integrals: The integrals.
    """
    channel = min(integrals.falls, key=lambda channel: integrals.falls[channel])
    signal = signal_name(problem.study.loop.channels[channel], "y")
    text = (
        f"the flight seems to begin with other integrals than the study: its outputs show {integrals.values_text} "
        f"(p = {integrals.p_value:.1g}), with which {100.0 * integrals.falls[channel]:.2g} % of the residual of "
        f"{signal} would be left. "
        f"{start_remedy(problem.study, integrals.names[-1])}"
    )
    return SignalWarning(signal, "first-integrals", text)


def starts_elsewhere(study: Study, integrals: FreeIntegrals) -> StartsElsewhere:
    """The refusal of a flight whose first integrals are not those of the study, on which the estimates depend.

    Args:
        study: The study.
        integrals: The integrals that the flight shows.
    """
    number, move = max(integrals.moves.items(), key=lambda pair: abs(pair[1]))
    return StartsElsewhere(
        f"the flight did not begin with the study's integrals: its outputs show {integrals.values_text} "
        f"(p = {integrals.p_value:.1g}), and {number} would be {abs(move):.3g} of its standard deviations off. "
        f"{start_remedy(study, integrals.names[-1])}"
    )
