"""Whether a force that the study lacks, such as quadratic drag or friction, would explain part of the residual.

Each force is a small addition to the command, of a known course over the predicted speed. Its effect on the output
joins the least squares as one more number, and the gain of the likelihood tells whether the force is there.
"""

import math
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.refusals import Doubt, signal_and_unit
from dssc_jax.flight_logs.fit.shifts import LARGE_MOVE, SIGNIFICANCE, linear_cost
from dssc_jax.statistics.correlated_noise import Noise, weighted_products

PROBE = 1e-3  # root mean square of the probing force, as a share of that of the command
REST = 1e-2  # share of the largest speed below which friction passes through 0


def quadratic_drag(speed: np.ndarray) -> np.ndarray:
    """The course of a force that grows with the square of the speed, and acts against it; shape (n,)."""
    return -speed * np.abs(speed)


def friction(speed: np.ndarray) -> np.ndarray:
    """The course of a force of constant size against the speed, which passes through 0 at rest; shape (n,)."""
    return -speed / np.hypot(speed, REST * float(np.abs(speed).max()) + TINY)


FORCES: Mapping[str, Callable[[np.ndarray], np.ndarray]] = MappingProxyType(
    {
        "that grows with the square of the speed (drag)": quadratic_drag,
        "of constant size against it (friction)": friction,
    }
)


def force_doubts(problem: FitProblem, minimum: Minimum, deviations: np.ndarray) -> tuple[Doubt, ...]:
    """The doubt about a force against the speed that the study lacks, in a study of one channel, with the remedy.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
        deviations: Standard deviations of the fitted coordinates, shape (f,).
    """
    if len(problem.study.loop.channels) > 1 or len(problem.readings) != 1:
        return ()
    commands = problem.log.commands
    values = problem.values(minimum.x)
    simulated = problem.disturbances.simulate(problem.study, problem.names, values, commands)
    predicted, _ = problem.predict(values, commands)
    speed = np.gradient(predicted[0], problem.study.loop.sample_time)
    (columns,) = problem.columns(minimum.x)
    likeliest: tuple[float, str, np.ndarray] = (SIGNIFICANCE, "", np.zeros(0))
    for name, course_of in FORCES.items():
        course = course_of(speed)
        size = PROBE * float(np.sqrt(np.mean(commands**2))) / max(float(np.sqrt(np.mean(course**2))), TINY)
        (probed,) = problem.columns(minimum.x, commands + size * course)
        effect = columns[:, 0] - probed[:, 0]
        if not np.isfinite(effect).all():
            continue
        p_value, moves = effect_of_force(problem, columns, effect, simulated)
        is_large = np.max(np.abs(moves[problem.fitted]) / deviations) > LARGE_MOVE
        if is_large and p_value < likeliest[0]:
            likeliest = (p_value, name, moves)
    p_value, name, moves = likeliest
    if not name:
        return ()
    largest = problem.fitted[int(np.argmax(np.abs(moves[problem.fitted]) / deviations))]
    number = problem.names[largest]
    better = problem.values(minimum.x + moves)[largest]
    signal, _ = signal_and_unit(problem, 0)
    text = (
        f"a force against the speed {name}, which the study lacks, would explain part of the residual of {signal} "
        f"(p = {p_value:.1g}): with it, {number} is about {better:.4g} in place of "
        f"{values[largest]:.4g}. Estimates are wrong by more than their intervals. Give the plant "
        "that force (docs/extending.md), or fly at the speeds that count"
    )
    return (Doubt(signal, text),)


def effect_of_force(
    problem: FitProblem, columns: np.ndarray, effect: np.ndarray, simulated: np.ndarray | None
) -> tuple[float, np.ndarray]:
    """Least squares with the effect of a force on the output as one more number.

    Either least squares has the noise of its residual: without the force, correlated noise takes its place.

    Args:
        problem: The problem, with the noise of its minimum.
        columns: Residual and slopes at the minimum, shape (n, 1 + p).
        effect: Effect of the force on the output, shape (n,).
        simulated: Simulations of random disturbances, shape (replicates, channels, samples); None: there are none.

    Returns:
        - Largest probability of as large a gain of the likelihood by one of the forces, if there is none.
        - Moves of the coordinates, shape (p,).
    """
    extended = np.column_stack([columns, effect / max(float(np.sqrt(np.mean(effect**2))), TINY)])
    noise, fit = problem.noise_search(0, extended, simulated).likeliest()
    times = problem.readings[0].times
    gain = 2.0 * (log_likelihood(noise, times, extended) - log_likelihood(problem.noises[0], times, columns))
    p_value = len(FORCES) * float(stats.chi2.sf(max(gain, 0.0), 1))
    products = weighted_products(noise, times, extended)[0] / fit.variance
    information = products[1:, 1:] + np.diag(np.append(problem.prior, 0.0))
    steps = np.linalg.lstsq(information, products[1:, 0], rcond=None)[0]
    return (min(1.0, p_value) if math.isfinite(p_value) else 1.0), steps[:-1]


def log_likelihood(noise: Noise, times: np.ndarray, columns: np.ndarray) -> float:
    """Logarithm of the likelihood of a residual at the best numbers and the likeliest variance of its noise.

    Args:
        noise: The noise.
        times: Times of the readings [s], shape (n,).
        columns: Residual and slopes, shape (n, 1 + p).
    """
    products, log_det = weighted_products(noise, times, columns)
    return -0.5 * (log_det + len(times) * math.log(max(linear_cost(products), TINY)))
