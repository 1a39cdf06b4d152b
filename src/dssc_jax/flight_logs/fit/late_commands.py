"""Whether a vehicle gets its commands later or earlier than they are logged: a dead time that a fit takes for a lag.

Where a force acts from the start, or the plant does not begin at rest, a shift of the outputs differs from a shift of
the commands. So the commands are shifted, too. Each shift is another simulation, for which the prediction of several
channels would have to be compiled again, so that only studies of one channel are checked.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from dssc_jax.flight_logs.fit.least_squares import FitProblem, NormalEquations
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.prediction import declares_noise
from dssc_jax.flight_logs.fit.refusals import Explained
from dssc_jax.flight_logs.fit.remaining_residuals import remaining_text
from dssc_jax.flight_logs.fit.search_limits import SearchCount
from dssc_jax.flight_logs.fit.shifts import Delay, fitted_delay, longest_shift
from dssc_jax.flight_logs.reading.reader import signal_name
from dssc_jax.flight_logs.signal_warnings import SignalWarning


class ShiftedCommands:
    """The problem of a fit with commands that are shifted by whole samples; all shifts have the same readings.

    Args:
        problem: The problem, with the noise of its minimum. Simulations of the shifted problems are not counted.
    """

    def __init__(self, problem: FitProblem) -> None:
        self.problem = problem
        self.noises = problem.noises
        self.variances = problem.variances

    def at(self, channels: Sequence[int], shift: int) -> FitProblem:
        """The problem, with the same noise, in which commands act later than logged; until then the first one acts.

        Args:
            channels: Positions of the channels whose commands are shifted.
            shift: By how many samples they are later; negative: earlier.
        """
        commands = self.problem.log.commands.copy()
        samples = commands.shape[1]
        sources = np.clip(np.arange(samples) - shift, 0, samples - 1)
        for channel in channels:
            commands[channel] = commands[channel, sources]
        log = self.problem.log._replace(commands=commands)
        shifted = replace(self.problem, is_shifted=True, log=log, count=SearchCount())
        shifted.noises = list(self.noises)
        shifted.variances = list(self.variances)
        return shifted


def linearised_cost(equations: NormalEquations) -> float:
    """The weighted sum of squares after one Gauss-Newton step, as if the prediction were linear in the numbers."""
    if not math.isfinite(equations.cost):
        return math.inf
    step = np.linalg.lstsq(equations.information, equations.gradient, rcond=None)[0]
    return equations.cost - float(equations.gradient @ step)


def late_command(problem: FitProblem, minimum: Minimum) -> Delay | None:
    """The delay of the commands that lowers the residual at a minimum most, in a study of one channel.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.

    Returns:
        None if the log is too short, no shift is better, or the study has several channels.
    """
    margin = longest_shift(problem)
    channels = (0,)
    if len(problem.study.loop.channels) > 1 or margin < 1:
        return None
    shifts = ShiftedCommands(problem)
    costs = {}
    for shift in range(-margin, margin + 1):
        costs[shift] = linearised_cost(shifts.at(channels, shift).normal_equations(minimum.x))
    best = min(costs, key=lambda shift: (costs[shift], abs(shift)))
    if best == 0:
        return None
    return fitted_delay(shifts, minimum, channels, best, margin)


def command_delay_warning(
    problem: FitProblem, minimum: Minimum, results: Sequence[Explained], delay: Delay
) -> SignalWarning:
    """The doubt about commands that act later or earlier than they are logged, with the remedy.

    The estimates are those without a shift all the same: whether a delay is the log's or the vehicle's is not known.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
        results: How well the study describes each channel.
        delay: The delay.
    """
    study = problem.study
    name = signal_name(study.loop.channels[0], "u_total")
    remedy = (
        "Log the time at which the vehicle gets the command, or give the study the delay that the vehicle has "
        "(unmodelled, actuator)"
        if delay.time > 0.0
        else "Log the time of the command itself, not that of its arrival, and look for a delay in the study that the "
        "vehicle does not have"
    )
    sizes = f"from {delay.unshifted[0]:.3g} to {delay.shifted[0]:.3g} {study.units[0].output} rms"
    falls = f"the residual falls {sizes}, and "
    if declares_noise(study):  # the residual then is mostly what the gusts did, whatever the delay
        falls = ""
    side = "later" if delay.time > 0.0 else "earlier"
    text = (
        f"{name} acts {delay.size_text} {side} than it is logged (p = {delay.p_value:.1g}): moved by that, {falls}"
        f"{delay.move_text(problem.named_values(minimum.x))}. {remedy}"
        f"{remaining_text(problem, minimum, delay, results)}"
    )
    return SignalWarning(name, "delayed-command", text)
