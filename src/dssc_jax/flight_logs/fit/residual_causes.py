"""The likely causes of a residual, in the order of the warnings: where a fit is refused, and beside its estimates.

A cause that explains the residual leaves nothing to the next one: a constant in the command, lost commands, a delay, a
part that the study lacks, another start.
"""

import math
from dataclasses import replace

import numpy as np

from dssc_jax.flight_logs.fit.begun_actuators import begun_actuator
from dssc_jax.flight_logs.fit.command_dropouts import dropout_doubts
from dssc_jax.flight_logs.fit.command_offsets import MendedCommand, without_offset
from dssc_jax.flight_logs.fit.joint_causes import joint_doubts
from dssc_jax.flight_logs.fit.late_outputs import delay_doubts
from dssc_jax.flight_logs.fit.least_squares import FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.outliers import outlier_doubts
from dssc_jax.flight_logs.fit.part_doubts import NO_DOUBTS, PartDoubts, part_doubts, part_doubts_of_refusal
from dssc_jax.flight_logs.fit.refits import refit
from dssc_jax.flight_logs.fit.refusals import Explained, doubts, noise_doubts
from dssc_jax.flight_logs.fit.search_limits import SearchCount
from dssc_jax.flight_logs.fit.shifts import Delay
from dssc_jax.flight_logs.fit.start_doubts import output_start_doubts
from dssc_jax.flight_logs.fit.start_speeds import AS_SMALL, fitted_start, start_speed_doubts
from dssc_jax.flight_logs.signal_warnings import SignalWarning, hedged


def explaining_command(problem: FitProblem, best: Minimum, results: list[Explained]) -> MendedCommand | None:
    """The fit without a fault of the logged command that explains a doubtful residual; None if there is no such fault.

    The fault is an actuator that has already followed the first command, or else a constant that the vehicle did not
    answer. Both are told in studies of one channel only.

    Args:
        problem: The least-squares problem of the log.
        best: Its minimum.
        results: How well each channel is described.
    """
    log = problem.log
    has_one_command = len(log.commands) == len(problem.readings) == 1 and not log.replayed
    is_doubtful = any(result.is_doubtful for result in results)
    if problem.count.is_stopped or not has_one_command or not is_doubtful:
        return None
    logged = refit(problem, best, log)
    begun = begun_actuator(problem, best, results, logged)
    mended = without_offset(problem, best, results, logged)
    if begun is not None and (mended is None or begun.residual <= AS_SMALL * mended.residual):
        return begun
    return mended


def start_in_place_of(
    mended: MendedCommand, problem: FitProblem, best: Minimum
) -> tuple[tuple[SignalWarning, ...], float]:
    """The doubt about the speed at the start, if another start makes the mended command needless.

    That is so if another start leaves as little of the residual with the logged command as with the mended one.

    Args:
        mended: The fit with the mended command.
        problem: The least-squares problem of the log.
        best: The minimum of that problem.

    Returns:
        The doubt, or none. Then the root mean square of the residual with that start; infinite without a doubt.
    """
    if mended.leaves_noise:
        return (), math.inf
    uncounted = replace(problem, count=SearchCount())
    uncounted.noises, uncounted.variances = list(problem.noises), list(problem.variances)
    start = fitted_start(uncounted, best)
    start_of_mended = fitted_start(mended.problem, mended.minimum)
    if start is None or start_of_mended is None or start.residual > AS_SMALL * start_of_mended.residual:
        return (), math.inf
    return start_speed_doubts(uncounted, best, mended.residual, start), start.residual


def refusal_causes(
    problem: FitProblem, best: Minimum, results: list[Explained]
) -> tuple[tuple[SignalWarning, ...], bool]:
    """Likely causes, other than wrong columns, of a residual that is more than noise.

    Args:
        problem: The least-squares problem of the log.
        best: Its minimum.
        results: How well each channel is described.

    Returns:
        The causes, and whether one of them leaves nothing but noise.
    """
    mended = explaining_command(problem, best, results)
    if mended is not None:
        doubts_of_start, residual_with_start = start_in_place_of(mended, problem, best)
        if doubts_of_start:
            return hedged(doubts_of_start), residual_with_start <= results[0].limit
        return causes_beside_mend(mended), mended.leaves_noise
    doubts_of_outliers = outlier_doubts(problem, best.x)
    doubts_of_dropouts = dropout_doubts(problem, best)
    doubts_of_delays = doubts_of_dropouts or delay_doubts(problem, best, results)
    parts = NO_DOUBTS
    if not doubts_of_dropouts:
        parts = part_doubts_of_refusal(problem, best, results[0], bool(doubts_of_delays))
    if parts.exceeds_delays:
        doubts_of_delays = ()
    doubts_of_start = start_speed_doubts(problem, best, parts.residual)
    if doubts_of_start:
        parts = NO_DOUBTS
    elif not doubts_of_dropouts:
        joint = joint_doubts(problem, best, results[0], parts.residual)
        if joint:
            doubts_of_delays = ()
            parts = PartDoubts(joint)
    causes = (
        *(doubts_of_start or output_start_doubts(problem, best.x, results)),
        *doubts_of_outliers,
        *doubts_of_delays,
        *parts.warnings,
    )
    return hedged(causes), parts.residual <= results[0].limit


def causes_beside_mend(mended: MendedCommand) -> tuple[SignalWarning, ...]:
    """The warning about a mended command, then the likely causes of what it leaves, if this is more than noise."""
    others = () if mended.leaves_noise else refusal_causes(mended.problem, mended.minimum, mended.results)[0]
    return (mended.warning, *(warning for warning in others if warning.code != mended.warning.code))


def doubts_of_estimates(
    problem: FitProblem,
    best: Minimum,
    results: list[Explained],
    deviations: np.ndarray,
    known: tuple[SignalWarning, ...] = (),
    delay: Delay | None = None,
) -> tuple[SignalWarning, ...]:
    """The likely causes of a residual with which a fit is not refused, then the doubts about this residual.

    Args:
        problem: The least-squares problem of the log.
        best: Its minimum.
        results: How well each channel is described.
        deviations: Standard deviations of the fitted coordinates, shape (f,).
        known: Warnings of the replay, which may name the cause of a doubtful residual.
        delay: A certain delay of the outputs, where it has been fitted; None: it is looked for here.
    """
    doubts_of_noise = noise_doubts(problem, best.x, results)
    mended = explaining_command(problem, best, results)
    if mended is not None:
        doubts_of_start, _ = start_in_place_of(mended, problem, best)
        causes = doubts_of_start or causes_beside_mend(mended)
        return (*causes, *doubts(problem, best.x, results, (*causes, *known)), *doubts_of_noise)
    parts = NO_DOUBTS
    doubts_of_delays = dropout_doubts(problem, best)
    if not doubts_of_delays:
        doubts_of_delays = delay_doubts(problem, best, results, delay)
        parts = part_doubts(problem, best, deviations, results[0], bool(doubts_of_delays))
    if parts.exceeds_delays:
        doubts_of_delays = ()
    doubts_of_outliers = outlier_doubts(problem, best.x)
    doubts_of_start = output_start_doubts(problem, best.x, results)
    is_doubtful = any(result.is_doubtful for result in results)
    is_explained = parts.residual <= results[0].limit or bool(doubts_of_delays) or bool(doubts_of_outliers)
    if is_doubtful and not is_explained:
        doubts_of_speed = start_speed_doubts(problem, best, parts.residual)
        if doubts_of_speed:
            doubts_of_start = doubts_of_speed
            parts = NO_DOUBTS
    with_outliers = {doubt.signal for doubt in doubts_of_outliers}
    causes = (*doubts_of_start, *doubts_of_outliers, *doubts_of_delays, *parts.warnings)
    return (
        *causes,
        *doubts(problem, best.x, results, (*causes, *known)),
        *(doubt for doubt in doubts_of_noise if doubt.signal not in with_outliers),
    )
