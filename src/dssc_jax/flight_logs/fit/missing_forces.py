"""Whether a force that the study lacks, such as quadratic drag or friction, would explain part of the residual.

Each force is a small addition to the command, of a known course over the predicted speed. Its effect on the output
joins the least squares as one more number, and the gain of the likelihood tells whether the force is there.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.refusals import signal_and_unit
from dssc_jax.flight_logs.fit.shifts import LARGE_MOVE, SIGNIFICANCE, likelihood_of_cost, linear_cost
from dssc_jax.flight_logs.hints.conversions import rms
from dssc_jax.flight_logs.signal_warnings import SignalWarning
from dssc_jax.statistics.correlated_noise import weighted_products
from dssc_jax.statistics.noise_posterior import NoiseSearch

PROBE = 1e-3  # root mean square of the probing force, as a share of that of the command
REST = 1e-2  # share of the largest speed below which friction passes through 0


def quadratic_drag(speed: np.ndarray) -> np.ndarray:
    """The course of a force that grows with the square of the speed, and acts against it; shape (n,)."""
    return -speed * np.abs(speed)


def friction(speed: np.ndarray) -> np.ndarray:
    """The course of a force of constant size against the speed, which passes through 0 at rest; shape (n,)."""
    return -speed / np.hypot(speed, REST * float(np.abs(speed).max()) + TINY)


class Force(NamedTuple):
    """A force against the speed.

    Args:
        words: What it is, in words.
        course: The course of the force over the speed, shape (n,) to (n,); its size does not matter.
    """

    words: str
    course: Callable[[np.ndarray], np.ndarray]


FORCES = (
    Force("that grows with the square of the speed (drag)", quadratic_drag),
    Force("of constant size against it (friction)", friction),
)


class ForceEffect(NamedTuple):
    """What a fit with a force says.

    Args:
        force: The force.
        p_value: Largest probability of as large a gain of the likelihood by one of the forces, if there is none.
        moves: How far the force moves the coordinates, shape (p,).
    """

    force: Force
    p_value: float
    moves: np.ndarray


def force_doubts(problem: FitProblem, minimum: Minimum, deviations: np.ndarray) -> tuple[SignalWarning, ...]:
    """The doubt about a force against the speed that the study lacks, in a study of one channel, with the remedy.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
        deviations: Standard deviations of the fitted coordinates, shape (f,).
    """
    if len(problem.study.loop.channels) > 1 or len(problem.readings) != 1:
        return ()
    certain = []
    for effect in force_effects(problem, minimum):
        largest_move = float(np.max(np.abs(effect.moves[problem.fitted]) / deviations))
        if effect.p_value < SIGNIFICANCE and largest_move > LARGE_MOVE:
            certain.append(effect)
    if not certain:
        return ()
    effect = min(certain, key=lambda effect: effect.p_value)
    place = problem.fitted[int(np.argmax(np.abs(effect.moves[problem.fitted]) / deviations))]
    better = problem.values(minimum.x + effect.moves)[place]
    signal, _ = signal_and_unit(problem, 0)
    text = (
        f"a force against the speed {effect.force.words}, which the study lacks, would explain part of the residual of "
        f"{signal} (p = {effect.p_value:.1g}): with it, {problem.names[place]} is about {better:.4g} in place of "
        f"{problem.values(minimum.x)[place]:.4g}. Estimates are wrong by more than their intervals. Give the plant "
        "that force (docs/extending.md), or fly at the speeds that count"
    )
    return (SignalWarning(signal, "missing-force", text),)


def force_effects(problem: FitProblem, minimum: Minimum) -> list[ForceEffect]:
    """The effects of all forces on a fit; without those whose simulated output is not finite.

    Args:
        problem: The problem of one channel, with the noise of the minimum.
        minimum: The minimum.
    """
    commands = problem.log.commands
    values = problem.values(minimum.x)
    simulated = problem.disturbances.simulate(problem.study, problem.names, values, commands)
    predicted, _ = problem.predict(values, commands)
    speed = np.gradient(predicted[0], problem.study.loop.sample_time)
    (columns,) = problem.columns(minimum.x)
    effects = []
    for force in FORCES:
        course = force.course(speed)
        size = PROBE * rms(commands) / max(rms(course), TINY)
        (probed,) = problem.columns(minimum.x, commands + size * course)
        response = columns[:, 0] - probed[:, 0]
        if np.isfinite(response).all():
            extended = np.column_stack([columns, response / max(rms(response), TINY)])
            search = problem.noise_search(0, extended, simulated)
            effects.append(effect_of(force, problem, columns, extended, search))
    return effects


def effect_of(
    force: Force, problem: FitProblem, columns: np.ndarray, extended: np.ndarray, search: NoiseSearch
) -> ForceEffect:
    """Least squares with the response to a force as one more number.

    Either least squares has the noise of its residual: without the force, correlated noise takes its place.

    Args:
        force: The force.
        problem: The problem of one channel, with the noise of its minimum.
        columns: Residual and slopes at the minimum, shape (n, 1 + p).
        extended: The same with the response of the output to the force, shape (n, 2 + p).
        search: The search for the noise of the residual with the force.
    """
    (readings,) = problem.readings
    noise, fit = search.likeliest()
    products, log_det = weighted_products(noise, readings.times, extended)
    products_without, log_det_without = weighted_products(problem.noises[0], readings.times, columns)
    likelihood = likelihood_of_cost(readings, linear_cost(products), log_det)
    gain = 2.0 * (likelihood - likelihood_of_cost(readings, linear_cost(products_without), log_det_without))
    p_value = len(FORCES) * float(stats.chi2.sf(max(gain, 0.0), 1))
    information = products[1:, 1:] / fit.variance + np.diag(np.append(problem.prior, 0.0))
    moves = np.linalg.lstsq(information, products[1:, 0] / fit.variance, rcond=None)[0][:-1]
    return ForceEffect(force, min(1.0, p_value) if math.isfinite(p_value) else 1.0, moves)
