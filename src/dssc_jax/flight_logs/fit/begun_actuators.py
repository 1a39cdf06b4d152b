"""Logs whose first command is not 0: the flown actuator has followed it already, and the study's begins at rest.

Until the study's actuator has caught up, the simulated plant lacks a force. A linear actuator that begins in its
equilibrium under the first command acts like one that begins at rest and gets the commands less the first one, beside
a constant force: the steady gain times the first command.
"""

from dataclasses import replace

import numpy as np

from dssc_jax.flight_logs.fit.command_offsets import LARGE_PART, MendedCommand
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum, reweighted_minimum
from dssc_jax.flight_logs.fit.prediction import Prediction
from dssc_jax.flight_logs.fit.refits import Refit, refit
from dssc_jax.flight_logs.fit.refusals import Explained, explain, signal_and_unit
from dssc_jax.flight_logs.hints.references import median_values
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning
from dssc_jax.study import Study


def steady_gain(study: Study) -> float | None:
    """The ratio of steady output to constant input of the actuator, in a study of one channel.

    Returns:
        None if the actuator has no linear part, or this has no state, or integrates its input. Elements before the
        linear part count as if they passed the command on, which the residual tells.
    """
    (model,) = study.loop.unmodelled
    (params,) = study.params(median_values(study)).unmodelled
    if model.linear is None:
        return None
    system = model.linear(params)
    a = np.array(system.a, float).reshape(len(system.b), len(system.b))
    if not len(a) or np.linalg.matrix_rank(a) < len(a):  # without a memory, or with an integral
        return None
    through_state = np.array(system.c, float) @ np.linalg.solve(a, np.array(system.b, float))
    return float(system.d) - float(through_state)


def prediction_from_equilibrium(predict: Prediction, first: float, gain: float) -> Prediction:
    """The prediction with an actuator that begins in its equilibrium under a command.

    Args:
        predict: The prediction with an actuator that begins at rest.
        first: The command of the equilibrium [u].
        gain: Steady gain of the actuator.
    """

    def prediction(
        values: np.ndarray, commands: np.ndarray, forces: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Predict for the commands less the first one, with the steady output under the first one as a force."""
        force = gain * first + (np.zeros(commands.shape[1]) if forces is None else forces)
        return predict(values, commands - first, force)

    return prediction


def begun_actuator(
    problem: FitProblem, minimum: Minimum, results: list[Explained], logged: Refit
) -> MendedCommand | None:
    """Fit a log with an actuator that begins in its equilibrium under the first command.

    Args:
        problem: The problem of one channel, with the noise of the minimum.
        minimum: The minimum with an actuator that begins at rest.
        results: How well the study describes each channel.
        logged: The fit of the log with such an actuator, with white noise.

    Returns:
        None unless this lowers the residual to noise. None, too, if the first command is 0, or the actuator has no
        steady gain.
    """
    log = problem.log
    first = float(log.commands[0, 0])
    gain = steady_gain(problem.study)
    if gain is None or first == 0.0:
        return None
    mended = refit(replace(problem, predict=prediction_from_equilibrium(problem.predict, first, gain)), minimum, log)
    residual = mended.residual(0)
    logged_residual = logged.residual(0)
    if not residual < LARGE_PART * min(results[0].residual, logged_residual):
        return None
    end = reweighted_minimum(mended.problem, mended.minimum)
    explained = explain(mended.problem, end.x)
    if any(result.is_doubtful for result in explained):
        return None
    name = signal_name(problem.study.loop.channels[0], "u_total")
    y, unit = signal_and_unit(problem, 0)
    command = problem.study.units[0].of("u")
    text = (
        f"{name} begins at {first:.4g} {command}, and the actuator seems to have followed it before, where the study's "
        f"begins at rest: with an actuator in equilibrium under that command the residual of {y} falls from "
        f"{logged_residual:.3g} to {residual:.3g} {unit} rms"
        f"{moved_text(problem, minimum, Refit(mended.problem, end))}. Begin the log where the command "
        f"has been 0 for a while. Or give its column an offset of {-first:.4g} and the study a constant disturbance "
        f"with a law: {gain * first:.4g} {command} of its estimate is then the actuator's"
    )
    warning = SignalWarning(name, "actuator-start", text)
    return MendedCommand(warning, mended.problem, end, explained)


def moved_text(problem: FitProblem, minimum: Minimum, mended: Refit) -> str:
    """The number that the first state of the actuator moves farthest, with both values, in words.

    Args:
        problem: The problem with an actuator that begins at rest.
        minimum: The minimum of that problem.
        mended: The fit with an actuator that begins in its equilibrium.
    """
    moves = np.abs(mended.minimum.x - minimum.x)[problem.fitted]
    place = problem.fitted[int(np.argmax(moves))]
    value, value_without = problem.values(mended.minimum.x)[place], problem.values(minimum.x)[place]
    return f", and {problem.names[place]} is {value:.4g} in place of {value_without:.4g}"
