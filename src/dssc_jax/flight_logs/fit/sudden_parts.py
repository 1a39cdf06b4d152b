"""Parts that a study lacks and that begin at a moment of the flight: a constant force, and a step of the gain.

At the minimum without the part, the output's slopes by the size of the part are computed for some times, then for those
around the best one. The time with the least linearised sum of squares gives a part like those of
:mod:`~dssc_jax.flight_logs.fit.missing_parts`; its gain of likelihood is reduced for all times and sudden parts that
were compared. Gauss-Newton steps then refine the time between the samples, and tell its standard deviation.

References:
    D. W. K. Andrews, "Tests for parameter instability and structural change with unknown change point", Econometrica 61
        (1993) 821-856.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from dssc_jax.flight_logs.fit.flown_course import Flight
from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.missing_parts import FADING, STEADY_WIND, Part
from dssc_jax.flight_logs.fit.part_fits import FitWithoutPart, PartFit, PartPoint, PartProblem, fitted_part
from dssc_jax.flight_logs.fit.shifts import linear_cost
from dssc_jax.statistics.correlated_noise import WHITE, Noise, weighted_products
from dssc_jax.study import Study

TIMES = 32  # number of moments that are compared at first
ROUNDS = 4  # of fits, each with the time that is the likeliest by the fit before
REFINEMENTS = 4  # most Gauss-Newton steps from the best sample to a moment between the samples
SMALL = 0.1  # share of the time's deviation: a smaller step is the last one
MARGIN_DEVIATIONS = 4.0  # standard deviations of the time that, with one sample, are half the span of the remedy
DIFFERENCE = 0.5  # samples, either side of a time: the step of the derivative by it
LEAST_SAMPLES = 2 * TIMES
MARGIN = 0.05  # share of the flight at either end without such a time
SLOTS = ("disturbance.", "wind.")


def share_after(begin: float, flight: Flight) -> np.ndarray:
    """The share of each sample that lies after a moment, between 0 and 1; shape (n,).

    Args:
        begin: Samples from the first one to the moment.
        flight: The flight.
    """
    return np.clip(np.arange(1, len(flight.commands) + 1) - begin, 0.0, 1.0)


def weakened(flight: Flight, size: float) -> np.ndarray:
    """The commands, multiplied by a gain of 1 - size, shape (n,)."""
    return (1.0 - size) * flight.commands


WIND_STEP = STEADY_WIND._replace(
    words="a constant force ({size:.3g} {command}, as of a wind) that begins at",
    remedy='Give the study that force (disturbance, kind = "step") with laws of its value and of its time, such as '
    "at = {{ uniform = [{lower:.6g}, {upper:.6g}] }}, or fit the part before or after",
)
GAIN_STEP = FADING._replace(
    words="a gain of the command that {verb} by {percent:.3g} %, as where a blade breaks or a cell fails, at",
    remedy="Fit the part that ends before {lower:.4g} s or the one that begins after {upper:.4g} s, or log the command "
    "times the gain",
    commands=weakened,
)
"""Both as they are after the moment. The words end before the time, and the remedy has ``{lower}`` and ``{upper}``,
between which the time lies [s]."""


def lacking_sudden_parts(study: Study) -> list[Part]:
    """The sudden parts that a study lacks; no force if a disturbance or a wind of the study begins in flight."""
    has_wind_step = any(number.quantity.begins for name, number in study.numbers.items() if name.startswith(SLOTS))
    return [GAIN_STEP] if has_wind_step else [WIND_STEP, GAIN_STEP]


def fitted_sudden_part(problem: FitProblem, without: FitWithoutPart, flight: Flight, sudden: Part) -> PartFit | None:
    """Fit a log with a part that begins at the likeliest time; None if it does not explain the residual.

    The likeliest time depends on the noise. The search begins once with the noise of the fit without the part and once
    with white noise, goes on with the noise of the fit with the part, and the better end counts.

    Args:
        problem: The problem of one channel, with the noise of its minimum.
        without: The fit without a part.
        flight: The flight.
        sudden: The part.
    """
    if len(flight.commands) < LEAST_SAMPLES:
        return None
    fits = []
    for weighted in (problem, with_noise(problem, WHITE)):  # a step of the output is likely, too, if noise may drift
        fit = fit_from(weighted, problem, without, flight, sudden)
        if fit is not None:
            fits.append(fit)
    return max(fits, key=lambda fit: fit.gain, default=None)


def fit_from(
    weighted: FitProblem, problem: FitProblem, without: FitWithoutPart, flight: Flight, sudden: Part
) -> PartFit | None:
    """Fit a log with a part, starting at the likeliest time under a first noise; None if the part explains nothing.

    Args:
        weighted: The problem with the first noise.
        problem: The problem with the noise of its minimum.
        without: The fit without a part.
        flight: The flight.
        sudden: The part.
    """
    samples = len(flight.commands)
    first = math.ceil(MARGIN * samples)
    begins = np.unique(np.linspace(first, samples - 1 - first, TIMES).round().astype(int))
    x = without.minimum.x
    begin = likeliest_begin(weighted, x, flight, sudden, begins)
    reach = math.ceil(samples / TIMES)
    choices = (samples - 2 * first) * len(lacking_sudden_parts(problem.study))
    best = None
    best_begin = begin
    for _ in range(ROUNDS):
        around = np.arange(max(first, begin - reach), min(samples - 1 - first, begin + reach) + 1)
        begin = likeliest_begin(weighted, x, flight, sudden, around)
        fit = fitted_part(problem, without, flight, part_from(sudden, begin, choices))
        if fit is None or (best is not None and fit.gain <= best.gain):
            break
        best = fit
        best_begin = begin
        weighted = with_noise(problem, fit.noise)
        x = fit.x
    return None if best is None else refined(problem, without, flight, sudden, best, best_begin)


def refined(
    problem: FitProblem, without: FitWithoutPart, flight: Flight, sudden: Part, fit: PartFit, begin: float
) -> PartFit:
    """The fit with a part whose time is refined between the samples; its words have the time and its deviation.

    Args:
        problem: The problem with the noise of its minimum.
        without: The fit without a part.
        flight: The flight.
        sudden: The part.
        fit: The fit with the part from a sample on.
        begin: Samples from the first one to that sample.
    """
    correction = begin_correction(problem, flight, sudden, fit, begin)
    for _ in range(REFINEMENTS):
        trial_begin = begin + float(np.clip(correction.step, -1.0, 1.0))
        trial = fitted_part(problem, without, flight, part_from(sudden, trial_begin, fit.part.choices))
        if trial is None or trial.gain <= fit.gain:
            break
        is_small = abs(trial_begin - begin) < SMALL * correction.deviation
        fit, begin = trial, trial_begin
        correction = begin_correction(problem, flight, sudden, fit, begin)
        if is_small:
            break
    deviation = max(correction.deviation, spread_of_begin(problem, flight, sudden, fit, begin))
    return fit._replace(part=told_part(fit.part, flight.sample_time, begin, deviation))


class BeginCorrection(NamedTuple):
    """The Gauss-Newton step to the likeliest time, and the standard deviation of that time, both in samples."""

    step: float
    deviation: float


def begin_correction(problem: FitProblem, flight: Flight, sudden: Part, fit: PartFit, begin: float) -> BeginCorrection:
    """How far the time of a part is from the likeliest one, to first order, while the numbers and the size are free.

    Args:
        problem: The problem.
        flight: The flight.
        sudden: The part.
        fit: The fit with the part.
        begin: Samples from the first one to the beginning of the part.
    """
    point = PartPoint(fit.x, fit.size, 1.0)
    part_problem = PartProblem(problem, flight, fit.part)
    sides = []
    for move in (-DIFFERENCE, DIFFERENCE):
        moved = PartProblem(problem, flight, part_from(sudden, begin + move, fit.part.choices))
        sides.append(moved.residual_columns(point)[:, 0])
    slope = (sides[0] - sides[1]) / (2.0 * DIFFERENCE)
    columns = np.column_stack([part_problem.columns(point), slope])
    products = part_problem.products(fit.noise, columns)
    if not np.isfinite(products).all():
        return BeginCorrection(0.0, math.inf)
    products = products / max(linear_cost(products) / len(columns), TINY)
    free = np.zeros(2)  # the size and the time have no law
    gradient = products[1:, 0] - np.append(problem.prior * fit.x, free)
    information = products[1:, 1:] + np.diag(np.append(problem.prior, free))
    scale = 1.0 / np.sqrt(np.maximum(np.diag(information), TINY))
    covariance = np.linalg.pinv(information * np.outer(scale, scale), hermitian=True) * np.outer(scale, scale)
    return BeginCorrection(float(covariance[-1] @ gradient), math.sqrt(max(float(covariance[-1, -1]), 0.0)))


def with_noise(problem: FitProblem, noise: Noise) -> FitProblem:
    """The problem of one channel with another noise."""
    weighted = replace(problem)
    weighted.noises = [noise]
    weighted.variances = list(problem.variances)
    return weighted


def part_from(sudden: Part, begin: float, choices: int) -> Part:
    """A part that acts from a moment on.

    Args:
        sudden: The part, as it is after the moment.
        begin: Samples from the first one to the moment.
        choices: Number of moments times that of sudden parts from which it was chosen.
    """
    lasting_forces = sudden.forces

    def commands(flight: Flight, size: float) -> np.ndarray:
        """The flight's commands up to the moment, and those of the part after it."""
        return flight.commands + share_after(begin, flight) * (sudden.commands(flight, size) - flight.commands)

    if lasting_forces is None:
        return sudden._replace(commands=commands, choices=choices)

    def forces(flight: Flight, size: float) -> np.ndarray:
        """The part's forces after the moment."""
        return share_after(begin, flight) * lasting_forces(flight, size)

    return sudden._replace(commands=commands, forces=forces, choices=choices)


def told_part(part: Part, sample_time: float, begin: float, deviation: float) -> Part:
    """A part from a moment on, with the time in its words, and in its remedy a span that safely contains the time.

    Args:
        part: The part.
        sample_time: Time between two samples [s].
        begin: Samples from the first one to the moment.
        deviation: Standard deviation of ``begin``.
    """
    time = sample_time * begin
    margin = sample_time * min(MARGIN_DEVIATIONS * deviation + 1.0, begin)
    return part._replace(
        words=f"{part.words} {time:.4g} ± {sample_time * deviation:.2g} s of the study",
        remedy=part.remedy.format(lower=time - margin, upper=time + margin),
    )


def likeliest_begin(problem: FitProblem, x: np.ndarray, flight: Flight, sudden: Part, begins: np.ndarray) -> int:
    """The sample from which on a part leaves the least sum of squares; the arguments are of :func:`costs_by_begin`."""
    return int(begins[int(np.argmin(costs_by_begin(problem, x, flight, sudden, begins)))])


def costs_by_begin(problem: FitProblem, x: np.ndarray, flight: Flight, sudden: Part, begins: np.ndarray) -> np.ndarray:
    """The least weighted sum of squares with a part from each of k moments on, to first order, shape (k,).

    Args:
        problem: The problem of one channel, with a noise.
        x: Coordinates of the numbers, shape (p,).
        flight: The flight.
        sudden: The part.
        begins: Samples from the first one to the moments, shape (k,).
    """
    (readings,) = problem.readings
    (columns,) = problem.columns(x)
    (size,) = sudden.sizes(flight)
    slopes = []
    for begin in begins.tolist():
        part = part_from(sudden, begin, choices=1)
        (moved,) = problem.columns(x, part.commands(flight, size)[None, :], part.forces_on(flight, size))
        slopes.append((columns[:, 0] - moved[:, 0]) / size)
    extended = np.column_stack([columns, *slopes])
    if not np.isfinite(extended).all():
        return np.zeros(len(begins))
    products, _ = weighted_products(problem.noises[0], readings.times, extended)
    count = columns.shape[1]
    costs = []
    for place in range(len(begins)):
        chosen = np.append(np.arange(count), count + place)
        costs.append(linear_cost(products[np.ix_(chosen, chosen)]))
    return np.array(costs)


def spread_of_begin(problem: FitProblem, flight: Flight, sudden: Part, fit: PartFit, begin: float) -> float:
    """The standard deviation of a moment by its likelihood around the likeliest one, in samples.

    While the command is small, a change of the gain hardly shows, so no single moment is the likeliest. The curvature
    of the likelihood at one moment then says little about its whole width.

    Args:
        problem: The problem of one channel.
        flight: The flight.
        sudden: The part.
        fit: The fit with the part.
        begin: Samples from the first one to the beginning of the part.
    """
    reach = 2.0 * len(flight.commands) / TIMES
    begins = np.clip(begin + np.linspace(-reach, reach, 2 * TIMES + 1), 0.0, len(flight.commands) - 1.0)
    costs = costs_by_begin(with_noise(problem, fit.noise), fit.x, flight, sudden, begins)
    variance = max(float(costs.min()) / len(problem.readings[0].times), TINY)
    likelihoods = np.exp(-0.5 * (costs - costs.min()) / variance)
    return math.sqrt(float(likelihoods @ (begins - begin) ** 2 / likelihoods.sum()))
