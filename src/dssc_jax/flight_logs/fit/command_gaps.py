"""Commands that are logged more rarely than the controller gives them.

What flew between two logged commands is not known: the last one was held, or a controller of twice the rate gave one in
between. The flight tells which. Each reconstruction of the commands is compared by the sum of squares that it leaves:
the best one counts, and those that describe the flight as well widen the intervals by how far they move the estimates.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from scipy import stats

from dssc_jax.flight_logs.fit.least_squares import TINY, FitProblem
from dssc_jax.flight_logs.fit.minima import Minimum
from dssc_jax.flight_logs.fit.sampled_log import Reconstruction, SampledLog
from dssc_jax.flight_logs.reading.reader import forward_filled
from dssc_jax.flight_logs.signal_warnings import SignalWarning, WarningCode

LACKING = 0.25  # share of the samples: a command that lacks more is logged more rarely than it is given
STAIRCASE = 0.2  # share of the logged values that repeat the one before: with more, the controller itself is as slow
REGULAR = 2.5  # factor on the median gap: over longer gaps a command is held
JUMP = 5.0  # factor on the slopes before and after: a larger slope is a jump, and no straight line
LEVEL = 0.95  # level of chi squared, below which two reconstructions describe a flight equally well
TOLD = 0.5  # standard deviations: a reconstruction that moves an estimate by less is not reported

HELD = "its last value is held"
LATE = "it follows straight lines, and jumps with the next logged value"
EARLY = "it follows straight lines, and jumps right after the last logged value"


def reconstructions(commands: Sequence[np.ndarray]) -> tuple[Reconstruction, ...]:
    """The possible courses of the commands at all samples, the likeliest first.

    Args:
        commands: The command of each channel, NaN where the log lacks it, shape (samples,).

    Returns:
        Held commands alone if no command is logged more rarely than the controller gives it.
    """
    held_commands = np.array([forward_filled(command) for command in commands])
    if not any(is_rare(command) for command in commands):
        return (Reconstruction(HELD, held_commands),)
    candidates: list[Reconstruction] = []
    for text, early in ((LATE, False), (EARLY, True)):
        rows = []
        for command, row in zip(commands, held_commands, strict=True):
            rows.append(along_lines(command, early) if is_rare(command) else row)
        candidates.append(Reconstruction(text, np.array(rows)))
    candidates.append(Reconstruction(HELD, held_commands))
    distinct = [candidates[0]]
    for candidate in candidates[1:]:
        if not any(np.array_equal(candidate.commands, kept.commands) for kept in distinct):
            distinct.append(candidate)
    return tuple(distinct)


def is_rare(command: np.ndarray) -> bool:
    """Whether a command, NaN where the log lacks it, is logged more rarely than the controller gives it.

    Such a command lacks many samples, and its logged values hardly ever repeat.
    """
    values = command[np.isfinite(command)]
    if len(values) < 3 or np.mean(np.isnan(command)) < LACKING or np.ptp(values) == 0.0:
        return False
    return float(np.mean(np.diff(values) == 0.0)) < STAIRCASE


def along_lines(command: np.ndarray, jumps_early: bool, longest_gap: float | None = None) -> np.ndarray:
    """Interpolate a command linearly between its logged values; over long gaps, hold the last value.

    A jump is not interpolated. The command keeps the value before the jump until the next value is logged, or, with
    ``jumps_early``, takes the next value right after the last logged one.

    Args:
        command: The command, NaN where the log lacks it, shape (samples,).
        jumps_early: Whether the command jumps right after the last logged value.
        longest_gap: Longest gap that is interpolated, in samples; None: 2.5 times the median gap.
    """
    finite_rows = np.flatnonzero(np.isfinite(command))
    values = command[finite_rows]
    gaps = np.diff(finite_rows)
    slopes = np.abs(np.diff(values)) / gaps
    preceding = np.concatenate([[0.0], slopes[:-1]])
    following = np.concatenate([slopes[1:], [0.0]])
    jumps = slopes > JUMP * np.maximum(preceding, following)
    longest = REGULAR * float(np.median(gaps)) if longest_gap is None else longest_gap
    filled = forward_filled(command)
    lines = np.interp(np.arange(len(command)), finite_rows, values)
    for begin, end, value, is_jump, gap in zip(finite_rows[:-1], finite_rows[1:], values[1:], jumps, gaps, strict=True):
        if gap > longest:
            continue
        if not is_jump:
            filled[begin:end] = lines[begin:end]
        elif jumps_early:
            filled[begin + 1 : end] = value
    return filled


class ComparedCommands(NamedTuple):
    """A reconstruction of the commands other than that of the fit.

    Args:
        reconstruction: The reconstruction.
        cost: Weighted sum of squares that this reconstruction leaves.
        move: How far this reconstruction moves the coordinates, shape (p,).
    """

    reconstruction: Reconstruction
    cost: float
    move: np.ndarray


def compared_commands(problem: FitProblem, minimum: Minimum) -> list[ComparedCommands]:
    """Take one Gauss-Newton step from a minimum with each alternative reconstruction of a log's commands.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
    """
    comparisons = []
    for reconstruction in problem.log.alternatives:
        equations = problem.normal_equations(minimum.x, reconstruction.commands)
        diagonal = np.diag(np.maximum(np.diag(equations.information), TINY))
        move = np.linalg.lstsq(equations.information + 1e-9 * diagonal, equations.gradient, rcond=None)[0]
        x = minimum.x + move
        cost = equations.cost
        if problem.is_admissible(problem.values(x)):
            cost = min(cost, problem.normal_equations(x, reconstruction.commands).cost)
        comparisons.append(ComparedCommands(reconstruction, cost, move))
    return comparisons


def allowed_difference(problem: FitProblem) -> float:
    """Difference of weighted sums of squares below which two reconstructions describe the flight equally well."""
    return float(stats.chi2.ppf(LEVEL, len(problem.names)))


def better_commands(
    problem: FitProblem, minimum: Minimum, comparisons: Sequence[ComparedCommands]
) -> Reconstruction | None:
    """The reconstruction that describes the flight clearly better than that of the fit; None if there is none.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum with the present reconstruction.
        comparisons: The other reconstructions, by :func:`compared_commands`.
    """
    best = min(comparisons, key=lambda item: item.cost, default=None)
    if best is None or not best.cost < minimum.cost - allowed_difference(problem):
        return None
    return best.reconstruction


def with_commands(log: SampledLog, reconstruction: Reconstruction) -> SampledLog:
    """The log with the commands of one of its alternatives in place of its own, which are dropped."""
    alternatives = tuple(item for item in log.alternatives if item is not reconstruction)
    return log._replace(commands=reconstruction.commands, between=reconstruction.text, alternatives=alternatives)


def command_moves(problem: FitProblem, minimum: Minimum, comparisons: Sequence[ComparedCommands]) -> np.ndarray:
    """How far other possible commands move the coordinates, one row for each course of the commands, shape (k, p).

    The other courses are the reconstructions that describe the flight as well as that of the fit, and the deviations
    that commands estimated by the fit leave open.

    Args:
        problem: The problem, with the noise of the minimum.
        minimum: The minimum.
        comparisons: The other reconstructions, by :func:`compared_commands`.
    """
    highest_cost = minimum.cost + allowed_difference(problem)
    moves = [item.move for item in comparisons if item.cost <= highest_cost]
    if problem.log.freed is not None:
        moves.extend(problem.log.freed.moves)
    return np.array(moves).reshape(len(moves), len(problem.names))


def command_doubts(problem: FitProblem, moves: np.ndarray, deviations: np.ndarray) -> tuple[SignalWarning, ...]:
    """The doubt about commands that are logged more rarely than the controller gives them, with the numbers it moves.

    Args:
        problem: The least-squares problem of the log.
        moves: The moves by :func:`command_moves` of the f numbers that are fitted, shape (k, f).
        deviations: Standard deviations of the coordinates of these numbers without the moves, shape (f,).
    """
    move_texts = []
    if len(moves):
        distances = np.sqrt(np.sum(moves**2, axis=0))
        for name, distance, deviation in zip(problem.fitted_names, distances, deviations, strict=True):
            if distance > TOLD * deviation:
                move_texts.append(f"{name} by {distance / deviation:.2g} standard deviations")
    return rare_doubts(problem.log, move_texts)


def rare_doubts(log: SampledLog, move_texts: Sequence[str] = ()) -> tuple[SignalWarning, ...]:
    """The doubt about commands that are logged more rarely than the controller gives them.

    Args:
        log: The log.
        move_texts: How far another course of the commands moves numbers, in words.
    """
    if not log.rare:
        return ()
    text = (
        f"the study's controller gives commands more often than the log has them ({', '.join(log.rare)}). Between two "
        f"values of a command {log.between}, which describes the flight best"
    )
    if move_texts:
        text += f". Another course describes it as well, and moves {', '.join(move_texts)}: intervals are wider by that"
    text += ". Log every command, or set loop.sample_time to that of the flight's controller"
    return (SignalWarning("", "rare-command", text),)


def largest_jump(command: np.ndarray) -> float:
    """The largest change of a command over a gap [u]; 0 without a gap. The command is NaN where the log lacks it."""
    finite_rows = np.flatnonzero(np.isfinite(command))
    changes = np.abs(np.diff(command[finite_rows]))[np.diff(finite_rows) > 1]
    return float(changes.max(initial=0.0))


def held_doubts(log: SampledLog) -> tuple[SignalWarning, ...]:
    """The doubts about outputs that are held or interpolated, commands with large changes, and gaps in the log."""
    texts: tuple[tuple[Mapping[str, float], WarningCode, str], ...] = (
        (
            log.slow,
            "held-output",
            "is held for {:.3g} s at a time, and is taken where it changes. Leave repeated cells empty, or log the "
            "time of each measurement",
        ),
        (
            log.interpolated,
            "interpolated-output",
            "is a straight line from one reading to the next, {:.3g} s apart: the log was interpolated, and one value "
            "for each reading is taken. Log the readings alone, with the time of each measurement, and leave other "
            "cells empty",
        ),
        (
            log.jumps,
            "command-jump",
            "changes by {:.3g} where the log lacks it, and the moment of the change is not known: estimates of lags, "
            "delays, masses and gains may be wrong by more than their intervals. Log every command, with a time stamp "
            "of its own",
        ),
    )
    doubts = []
    for sizes, code, text in texts:
        for name, size in sizes.items():
            doubts.append(SignalWarning(name, code, f"{name} {text.format(size)}"))
    if log.gaps:
        names = dict.fromkeys(name for gap in log.gaps for name in gap.signals)
        longest = max(gap.end - gap.begin for gap in log.gaps)
        text = f"{', '.join(names)} lack messages for up to {longest:.3g} s, and no interval counts what this falsifies"
        doubts.append(SignalWarning("", "damaged-log", text))
    return tuple(doubts)


def freed_doubts(log: SampledLog) -> tuple[SignalWarning, ...]:
    """The doubts about commands that the fit has estimated where the log lacks them."""
    return () if log.freed is None else log.freed.warnings
