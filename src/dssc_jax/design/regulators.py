"""First gains of LQG and of state feedback: regulators and filters of the plant at its start."""

import math
from collections.abc import Callable

import numpy as np
from scipy import optimize

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.toml import TomlTable
from dssc_jax.design.linear_plant import DesignProblem, LinearPlant
from dssc_jax.design.pid_gains import command_limits, has_gain_at_rest
from dssc_jax.models.controllers.linear_quadratic import filter_gain, gain_at_rest, regulator_gain, sampled_system

FILTER_RATIO = 4.0
"""Ratio of the filter's bandwidth to the regulator's."""
PLACES = 9
"""Decades from a guess within which a weight is sought."""
CROSSING_TOLERANCE = 1e-12
"""Tolerance of a weight's logarithm."""
FITS = 1e-9
"""Largest error, relative to the largest gain, with which gains of signals may replace gains of the states."""
STILL = 1e-12
"""Magnitude of a signal, relative to the largest one, up to which the signal counts as not moving."""


def lqg(problem: DesignProblem, omega: float, ratio: float) -> TomlTable:
    """The table ``[controller]`` of an LQG controller that takes the measured signals, or y if there are none.

    The weight of the command puts the crossover of the regulator's loop at the bandwidth. The size of the noise puts
    the crossover of the filter's loop at :data:`FILTER_RATIO` times the bandwidth, or at half the Nyquist frequency if
    that is lower.

    Args:
        problem: The plant and the limit of the command.
        omega: The bandwidth [rad/s].
        ratio: Corner frequency of the integral action, relative to the bandwidth.

    Raises:
        ConfigError: No weights give these crossovers, a disturbance at the command does not move a signal, or the limit
            excludes the resting command.
    """
    study = problem.study
    plant = problem.bare_plant
    nominal = problem.plant.nominal
    rows = nominal.signals if study.loop.measures else nominal.output[None, :]  # of the signals that the filter takes
    dt = plant.sample_time
    filter_bandwidth = min(FILTER_RATIO * omega, 0.5 * math.pi / dt)
    sampled = sampled_system(nominal.a, np.column_stack([nominal.command, nominal.disturbances]), dt)
    disturbance_column = sampled.disturbances[:, 0]  # of the disturbance at the command
    sizes = signal_sizes(problem, rows, responses(sampled.a, disturbance_column, filter_bandwidth, dt))
    scaled_rows = rows / sizes[:, None]
    process_noise = np.outer(disturbance_column, disturbance_column)  # of a disturbance with standard deviation 1

    def filter_loop_gain(deviation: float) -> float:
        """Loop gain of the filter at the filter's bandwidth, for noise of this standard deviation in scaled signals."""
        correction = filter_gain(sampled.a, scaled_rows, process_noise, deviation**2 * np.eye(len(rows)))
        response = responses(sampled.a, sampled.a @ correction, filter_bandwidth, dt)
        return float(np.linalg.norm(scaled_rows @ response, ord=2))

    deviation = crossing(filter_loop_gain, 1.0)
    table: TomlTable = {
        "kind": "lqg",
        "output_weight": 1.0,
        "command_weight": regulator_weight(sampled.a, sampled.b, nominal.output, omega, dt),
        "integral_weight": integral_weight(plant, ratio * omega),
        "signal_std": [float(deviation * size) for size in sizes],
        "disturbance_std": [1.0],
    }
    return table | command_limits(problem) | operating_point(problem) | stated_model(problem)


def signal_sizes(problem: DesignProblem, rows: np.ndarray, state_response: np.ndarray) -> np.ndarray:
    """Magnitude of each measured signal for a sinusoidal disturbance of amplitude 1 at the command, shape (m,).

    Args:
        problem: The design problem; it names the signals in messages.
        rows: Row of each signal, shape (m, n).
        state_response: Frequency response of the state to the disturbance, shape (n,), complex.

    Raises:
        ConfigError: A signal does not move, so that its noise has no scale.
    """
    study = problem.study
    names = [signal.name for signal in study.loop.measures] or ["y"]
    sizes = np.abs(rows @ state_response)
    for name, size in zip(names, sizes, strict=True):
        moves = size > STILL * np.max(sizes)
        if not moves:
            rule = f"'{name}' does not move with a disturbance at the command, so its noise has no scale"
            raise ConfigError(f"{study.source}: sensor.measures", f"{rule}; leave it out, or state weights of your own")
    return sizes


def stated_model(problem: DesignProblem) -> TomlTable:
    """The entry ``model`` of an LQG controller, with the plant's linearisation.

    The table is empty for a linear plant, since the controller then takes the study's plant as its model.
    """
    plant = problem.plant
    dynamics = problem.study.loop.plant
    is_linear = dynamics.linear is not None and dynamics.remainder is None
    if is_linear:
        return {}
    model: TomlTable = {"a": plant.a.tolist(), "b": plant.b.tolist(), "c": plant.c.tolist()}
    if len(plant.signals):
        model["signals"] = plant.signals.tolist()
        model["feedthrough"] = plant.feedthrough.tolist()
    model["disturbances"] = (plant.disturbances.T + 0.0).tolist()  # + 0.0 turns -0.0 into 0.0
    return {"model": model}


def operating_point(problem: DesignProblem) -> TomlTable:
    """The entries of a controller for the operating point about which its law acts.

    The table is empty for a linear plant, and for a plant that no command holds at its start.

    Raises:
        ConfigError: The limit excludes the command that holds the plant at the operating point.
    """
    resting = problem.plant.resting
    if resting is None:
        return {}
    if problem.limit is not None and abs(resting.command) >= problem.limit:
        rule = f"must be above the command {resting.command:.4g} that holds the plant at its start"
        raise ConfigError("`limit`", f"{rule}, got {problem.limit:g}")
    entries: TomlTable = {}
    if resting.output:
        entries["resting_output"] = resting.output
    if resting.command:
        entries["resting_command"] = resting.command
    if any(resting.signals):
        entries["resting_signals"] = list(resting.signals)
    return entries  # an absent entry is 0


def integral_weight(plant: LinearPlant, corner: float) -> float:
    """Weight of the squared integral of y [1/s^2], relative to that of y^2, for an integral below a corner frequency.

    The weight is 0 if the plant has no gain at rest, where an integral would have no effect.

    Args:
        plant: The sampled plant.
        corner: The corner frequency [rad/s].
    """
    return corner**2 if has_gain_at_rest(plant, corner) else 0.0


def regulator_weight(a: np.ndarray, b: np.ndarray, c: np.ndarray, omega: float, sample_time: float) -> float:
    """The weight of u^2, relative to that of y^2, at which the regulator's loop gain crosses 1 at a frequency.

    Args:
        a: A of the sampled plant, shape (n, n).
        b: Column of its input, shape (n,).
        c: Row of y, shape (n,).
        omega: The frequency [rad/s].
        sample_time: Sample time T_s [s].

    Raises:
        ConfigError: There is no such weight.
    """
    output_weight = np.outer(c, c)  # of the state, for y^2
    response = responses(a, b, omega, sample_time)

    def regulator_loop_gain(weight: float) -> float:
        """Loop gain at the frequency, for a weight of u^2."""
        return float(np.abs(regulator_gain(a, b[:, None], output_weight, weight) @ response))

    guess = float(np.abs(c @ response)) ** 2  # |G|^2, as |1 + L|^2 = 1 + |G|^2/weight in continuous time
    return crossing(regulator_loop_gain, guess)


def responses(a: np.ndarray, columns: np.ndarray, omega: float, sample_time: float) -> np.ndarray:
    """Frequency response (z - A)^-1 B of a sampled state to inputs, in the shape of ``columns``.

    Args:
        a: A, shape (n, n).
        columns: Column B of one input, shape (n,), or of several inputs, shape (n, m).
        omega: Angular frequency [rad/s].
        sample_time: Sample time T_s [s].
    """
    z = np.exp(1j * omega * sample_time)
    return np.linalg.solve(z * np.eye(len(a)) - a, columns)


def state_feedback(problem: DesignProblem, omega: float, ratio: float) -> TomlTable:
    """The table ``[controller]`` of a state feedback with the gains of LQG's regulator.

    The controller feeds back the measured signals. If the study measures none, it feeds back y and y', or y alone for a
    plant of order one.

    Args:
        problem: The plant and the limit of the command.
        omega: The bandwidth [rad/s].
        ratio: Corner frequency of the integral action, relative to the bandwidth.

    Raises:
        ConfigError: The signals do not show all states, a gain would be negative, or no weight gives the crossover.
    """
    plant = problem.plant
    dt = problem.bare_plant.sample_time
    sampled = sampled_system(plant.a, plant.b[:, None], dt)
    weight = regulator_weight(sampled.a, sampled.b, plant.c, omega, dt)
    n = len(plant.a)
    integral = integral_weight(problem.bare_plant, ratio * omega)
    if integral > 0.0:
        gains = integral_regulator_gain(sampled.a, sampled.b, plant.c, weight, integral, dt)
    else:
        gains = regulator_gain(sampled.a, sampled.b[:, None], np.outer(plant.c, plant.c), weight)
    feedback = gains[:n]
    signal_gains = gains_of_signals(problem, feedback)
    forward = gain_at_rest(sampled, plant.c, feedback)
    k_i = float(gains[n]) if integral > 0.0 else 0.0
    if problem.study.loop.measures:
        proportional: TomlTable = {"signals": list(map(float, signal_gains)), "feedforward": forward}
    else:
        proportional = gains_of_output(problem, signal_gains, forward)
    if k_i < 0.0:
        raise ConfigError(f"{problem.study.source}: plant", "has a negative gain at rest; turn the command's sign")
    table: TomlTable = {"kind": "state_feedback"} | proportional
    if k_i > 0.0:
        table["k_i"] = k_i
        if problem.limit is not None:
            table["tracking"] = 1.0 / (ratio * omega)
    return table | command_limits(problem) | operating_point(problem)


def integral_regulator_gain(
    a: np.ndarray, b: np.ndarray, c: np.ndarray, command_weight: float, integral: float, sample_time: float
) -> np.ndarray:
    """Regulator gains for a plant that is extended by an integral of y, the sum of T_s y, shape (n + 1,).

    Args:
        a: A of the sampled plant, shape (n, n).
        b: Column of its input, shape (n,).
        c: Row of y, shape (n,).
        command_weight: Weight of u^2, relative to that of y^2.
        integral: Weight of the squared integral of y, relative to that of y^2 [1/s^2].
        sample_time: Sample time T_s [s].
    """
    n = len(a)
    no_column = np.zeros((n, 1))
    no_row = np.zeros((1, n))
    one = np.ones((1, 1))
    extended_a = np.block([[a, no_column], [sample_time * c[None, :], one]])
    extended_b = np.append(b[:, None], [[0.0]], axis=0)
    state_weight = np.block([[np.outer(c, c), no_column], [no_row, integral * one]])
    return regulator_gain(extended_a, extended_b, state_weight, command_weight)


def gains_of_signals(problem: DesignProblem, feedback: np.ndarray) -> np.ndarray:
    """Gains of the measured signals that are equivalent to a feedback of the states, shape (m,).

    If the study measures no signals, the gains are those of y and y', or of y alone for a plant of order one.

    Args:
        problem: The plant and its signals.
        feedback: Gain of each state, shape (n,).

    Raises:
        ConfigError: The signals do not show all states, or a signal with a gain contains the last command.
    """
    plant = problem.plant
    n = len(feedback)
    names = tuple(signal.name for signal in problem.study.loop.measures)
    if names:
        rows = plant.signals
        feedthrough = plant.feedthrough
    else:  # y and y', or y alone for a plant of order one
        rows = np.stack([plant.c, plant.rate])[:n]
        feedthrough = np.array([0.0, plant.rate_through])[:n]
    signal_gains, *_ = np.linalg.lstsq(rows.T, feedback, rcond=None)
    has_feedthrough = bool(np.any(feedthrough * signal_gains != 0.0))
    left_out = np.max(np.abs(rows.T @ signal_gains - feedback))
    if has_feedthrough or left_out > FITS * np.max(np.abs(feedback)):
        signal_text = ", ".join(names) if names else "y and y'"
        if has_feedthrough:
            signal_text += ", which contain the last command"
        rule = f"shows {signal_text}, and the regulator feeds back all {n} states"
        remedy = "add measures = \"state\" to [sensor], or ask for 'lqg', which estimates them"
        raise ConfigError(f"{problem.study.source}: sensor", f"{rule}; {remedy}")
    return signal_gains


def gains_of_output(problem: DesignProblem, signal_gains: np.ndarray, forward: float) -> TomlTable:
    """The gains of a feedback of y and y', as entries of the table ``[controller]``.

    Args:
        problem: The design problem; it names the study in messages.
        signal_gains: Gains of y and, for a plant of order two, y'.
        forward: Gain from the reference to the command with which y settles at the reference.

    Raises:
        ConfigError: A gain is negative, which the controller does not allow.
    """
    k_1 = float(signal_gains[0])
    k_2 = float(signal_gains[1]) if len(signal_gains) == 2 else 0.0
    if k_1 < 0.0 or k_2 < 0.0:
        rule = f"needs the gains k_1 = {k_1:.4g} and k_2 = {k_2:.4g}, and they are at least 0"
        raise ConfigError(f"{problem.study.source}: plant", f"{rule}; turn the command's sign, or ask for 'lqg'")
    return {"k_1": k_1, "k_2": k_2, "feedforward": forward - k_1}


def crossing(size: Callable[[float], float], guess: float) -> float:
    """The positive weight at which a loop gain is 1.

    Args:
        size: (weight) -> loop gain, which falls as the weight rises.
        guess: Weight from which the search moves decade by decade towards the crossing. A Riccati equation far from the
            guess may have no solution in floating point.

    Raises:
        ConfigError: The loop gain does not cross 1 within :data:`PLACES` decades of the guess.
    """

    def excess(log_weight: float) -> float:
        """Loop gain minus 1, for the logarithm of a weight."""
        return size(math.exp(log_weight)) - 1.0

    start = math.log(guess)
    excess_at_start = excess(start)
    step = math.log(10.0) if excess_at_start > 0.0 else -math.log(10.0)
    for place in range(1, PLACES + 1):
        end = start + place * step
        if excess_at_start * excess(end) <= 0.0:  # not where a gain is not a number
            bracket = (end - step, end)
            return math.exp(optimize.root_scalar(excess, bracket=bracket, xtol=CROSSING_TOLERANCE).root)
    raise ConfigError(
        "`bandwidth`", "is out of reach of every weight for this plant; ask for another one, or sample faster"
    )
