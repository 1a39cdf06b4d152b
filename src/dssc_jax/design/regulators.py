"""First gains of LQG and of state feedback: regulators and filters of the plant at its start."""

import math
from collections.abc import Callable

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.toml import TomlTable
from dssc_jax.design.linear_plant import DesignProblem, LinearPlant
from dssc_jax.design.pid_gains import acts_at_rest, limits
from dssc_jax.models.controllers.linear_quadratic import filter_gain, gain_at_rest, regulator_gain, sampled_system

FILTER_RATIO = 4.0  # ratio of the filter's bandwidth to the regulator's
PLACES = 9  # bisections' decades of a weight on either side
FITS = 1e-9  # share of the regulator's gains that measured signals may leave out


def lqg(problem: DesignProblem, omega: float, ratio: float) -> TomlTable:
    """The table of an LQG controller of y, or of all measured signals.

    The weight of the command gives the regulator's loop its crossover at the bandwidth. The size of the noise gives the
    filter's loop its crossover at ``FILTER_RATIO`` times that.

    Args:
        problem: The plant and the limit of the command.
        omega: The bandwidth [rad/s].
        ratio: Corner frequency of the integral action, in bandwidths.

    Raises:
        ConfigError: No weights give these crossovers, or a signal does not move with the disturbance.
    """
    study, plant = problem.study, problem.bare_plant
    nominal = problem.plant.nominal
    rows = nominal.signals if study.loop.measures else nominal.output[None, :]
    dt = plant.sample_time
    filter_bandwidth = min(FILTER_RATIO * omega, 0.5 * math.pi / dt)
    sampled = sampled_system(nominal.a, np.column_stack([nominal.command, nominal.disturbances]), dt)
    disturbance_column = sampled.disturbances[:, 0]
    sizes = signal_sizes(problem, rows, responses(sampled.a, disturbance_column, filter_bandwidth, dt))
    scaled_rows = rows / sizes[:, None]
    noise = np.outer(disturbance_column, disturbance_column)

    def filter_loop_gain(deviation: float) -> float:
        correction = filter_gain(sampled.a, scaled_rows, noise, deviation**2 * np.eye(len(rows)))
        response = responses(sampled.a, sampled.a @ correction, filter_bandwidth, dt)
        return float(np.linalg.norm(scaled_rows @ response, 2))

    deviation = crossing(filter_loop_gain, 1.0)
    table: TomlTable = {
        "kind": "lqg",
        "output_weight": 1.0,
        "command_weight": regulator_weight(sampled.a, sampled.b, nominal.output, omega, dt),
        "integral_weight": integral_weight(plant, ratio * omega),
        "signal_std": [float(deviation * size) for size in sizes],
        "disturbance_std": [1.0],
    }
    return table | limits(problem) | operating_point(problem) | stated_model(problem)


def signal_sizes(problem: DesignProblem, rows: np.ndarray, state_response: np.ndarray) -> np.ndarray:
    """The magnitudes with which the measured signals move with a disturbance at the command, (signals,).

    Args:
        problem: The design problem, for the signals' names.
        rows: Row of each signal, (signals, n).
        state_response: Frequency response of the state, (n,).

    Raises:
        ConfigError: A signal does not move, so that its noise has no scale.
    """
    study = problem.study
    names = [signal.name for signal in study.loop.measures] or ["y"]
    sizes = np.abs(rows @ state_response)
    for name, size in zip(names, sizes, strict=True):
        if not size > 1e-12 * np.max(sizes):
            rule = f"'{name}' does not move with a disturbance at the command, so its noise has no scale"
            raise ConfigError(f"{study.source}: sensor.measures", f"{rule}; leave it out, or state weights of your own")
    return sizes


def stated_model(problem: DesignProblem) -> TomlTable:
    """The entry ``model`` of LQG: the plant's linearisation; empty for a linear plant, which is known anyway."""
    plant = problem.plant
    dynamics = problem.study.loop.plant
    if dynamics.linear is not None and dynamics.remainder is None:
        return {}
    model: TomlTable = {"a": plant.a.tolist(), "b": plant.b.tolist(), "c": plant.c.tolist()}
    if len(plant.signals):
        model |= {"signals": plant.signals.tolist(), "feedthrough": plant.feedthrough.tolist()}
    return {"model": model | {"disturbances": (plant.disturbances.T + 0.0).tolist()}}


def operating_point(problem: DesignProblem) -> TomlTable:
    """The entries of a controller for the operating point about which its law acts; empty for a linear plant.

    Raises:
        ConfigError: The limit excludes the command that holds the plant there.
    """
    resting = problem.plant.resting
    if resting is None:
        return {}
    if problem.limit is not None and abs(resting.command) >= problem.limit:
        rule = f"must be above the command {resting.command:.4g} that holds the plant at its start"
        raise ConfigError("`limit`", f"{rule}, got {problem.limit:g}")
    entries: TomlTable = {"resting_output": resting.output, "resting_command": resting.command}
    entries |= {"resting_signals": list(resting.signals)} if any(resting.signals) else {}
    return {name: value for name, value in entries.items() if value}


def integral_weight(plant: LinearPlant, corner: float) -> float:
    """The weight of the integral of y with which it acts below a corner frequency [rad/s]; 0 without a gain at rest."""
    return corner**2 if acts_at_rest(plant, corner) else 0.0


def regulator_weight(a: np.ndarray, b: np.ndarray, c: np.ndarray, omega: float, sample_time: float) -> float:
    """The weight of u^2 beside y^2 at which the regulator's loop gain crosses 1 at a frequency.

    Args:
        a: A of the sampled plant, shape (n, n).
        b: Its input, shape (n,).
        c: Row of y, shape (n,).
        omega: The frequency [rad/s].
        sample_time: T_s [s].

    Raises:
        ConfigError: No weight does.
    """
    q = np.outer(c, c)
    response = responses(a, b, omega, sample_time)

    def regulator_loop_gain(weight: float) -> float:
        return float(np.abs(regulator_gain(a, b[:, None], q, weight) @ response))

    guess = float(np.abs(c @ response)) ** 2  # |G|^2, as |1 + L|^2 = 1 + |G|^2/weight in continuous time
    return crossing(regulator_loop_gain, guess)


def responses(a: np.ndarray, columns: np.ndarray, omega: float, sample_time: float) -> np.ndarray:
    """(z - A)^-1 columns, the frequency response of the state to inputs, at an angular frequency [rad/s]."""
    return np.linalg.solve(np.exp(1j * omega * sample_time) * np.eye(len(a)) - a, columns)


def state_feedback(problem: DesignProblem, omega: float, ratio: float) -> TomlTable:
    """The table of a state feedback, the regulator of LQG: of all measured states, or of y and y' (order two).

    Args:
        problem: The plant and the limit of the command.
        omega: The bandwidth [rad/s].
        ratio: Corner frequency of the integral action, in bandwidths.

    Raises:
        ConfigError: The signals do not show all states, or a gain would be negative.
    """
    plant = problem.plant
    dt = problem.bare_plant.sample_time
    sampled = sampled_system(plant.a, plant.b[:, None], dt)
    weight = regulator_weight(sampled.a, sampled.b, plant.c, omega, dt)
    n = len(plant.a)
    integral = integral_weight(problem.bare_plant, ratio * omega)
    a, b, q = sampled.a, sampled.b[:, None], np.outer(plant.c, plant.c)
    if integral:
        a = np.block([[a, np.zeros((n, 1))], [dt * plant.c[None, :], np.ones((1, 1))]])
        b = np.append(b, [[0.0]], axis=0)
        q = np.block([[q, np.zeros((n, 1))], [np.zeros((1, n)), integral * np.ones((1, 1))]])
    gains = regulator_gain(a, b, q, weight)
    feedback = gains[:n]
    signal_gains = gains_of_signals(problem, feedback)
    forward = gain_at_rest(sampled, plant.c, feedback)
    k_i = float(gains[n]) if integral else 0.0
    if problem.study.loop.measures:
        proportional: TomlTable = {"signals": list(map(float, signal_gains)), "feedforward": forward}
    else:
        proportional = gains_of_output(problem, signal_gains, forward)
    if k_i < 0.0:
        raise ConfigError(f"{problem.study.source}: plant", "has a negative gain at rest; turn the command's sign")
    table: TomlTable = {"kind": "state_feedback"} | proportional
    if k_i:
        table["k_i"] = k_i
    if k_i and problem.limit is not None:
        table["tracking"] = 1.0 / (ratio * omega)
    return table | limits(problem) | operating_point(problem)


def gains_of_signals(problem: DesignProblem, feedback: np.ndarray) -> np.ndarray:
    """The gains of the measured signals, or of y and y', that are equal to a feedback of the states, (signals,).

    Args:
        problem: The plant and its signals.
        feedback: Gain of each state, (n,).

    Raises:
        ConfigError: There are none, or a signal contains the last command.
    """
    plant = problem.plant
    n = len(feedback)
    names = tuple(signal.name for signal in problem.study.loop.measures)
    rows = plant.signals if names else np.stack([plant.c, plant.rate])[:n]
    through = plant.feedthrough if names else np.array([0.0, plant.rate_through])[:n]
    signal_gains = np.linalg.lstsq(rows.T, feedback, rcond=None)[0]
    has_feedthrough = bool(np.any(through * signal_gains[: len(through)] != 0.0))
    if has_feedthrough or np.max(np.abs(rows.T @ signal_gains - feedback)) > FITS * np.max(np.abs(feedback)):
        signal_text = ", ".join(names) if names else "y and y'"
        signal_text += ", which contain the last command" if has_feedthrough else ""
        rule = f"shows {signal_text}, and the regulator feeds back all {n} states"
        remedy = "add measures = \"state\" to [sensor], or ask for 'lqg', which estimates them"
        raise ConfigError(f"{problem.study.source}: sensor", f"{rule}; {remedy}")
    return signal_gains


def gains_of_output(problem: DesignProblem, signal_gains: np.ndarray, forward: float) -> TomlTable:
    """The gains of a feedback of y and y', as fields of a controller.

    Args:
        problem: The design problem, for the study's name.
        signal_gains: Gains of y and, for a plant of order two, y'.
        forward: Gain from the reference to the command with which y settles at the reference.

    Raises:
        ConfigError: A gain is negative, which the controller does not allow.
    """
    k_1 = float(signal_gains[0])
    k_2 = float(signal_gains[1]) if len(signal_gains) > 1 else 0.0
    if k_1 < 0.0 or k_2 < 0.0:
        rule = f"needs the gains k_1 = {k_1:.4g} and k_2 = {k_2:.4g}, and they are at least 0"
        raise ConfigError(f"{problem.study.source}: plant", f"{rule}; turn the command's sign, or ask for 'lqg'")
    return {"k_1": k_1, "k_2": k_2, "feedforward": forward - k_1}


def crossing(size: Callable[[float], float], guess: float) -> float:
    """The positive number at which a falling function is 1, by bisection of its logarithm.

    Args:
        size: The function.
        guess: A number from which the bracket grows by decades on either side.

    Raises:
        ConfigError: The function does not cross 1 within ``PLACES`` decades.
    """
    low = high = guess
    # from the guess on, since a Riccati equation far from it may have no solution in floating point
    for _ in range(PLACES):
        low = low if size(low) > 1.0 else 0.1 * low
        high = high if size(high) < 1.0 else 10.0 * high
    if not size(low) > 1.0 > size(high):
        raise ConfigError(
            "`bandwidth`", "is out of reach of every weight for this plant; ask for another one, or sample faster"
        )
    for _ in range(80):
        middle = math.sqrt(low * high)
        if size(middle) > 1.0:
            low = middle
        else:
            high = middle
    return math.sqrt(low * high)
