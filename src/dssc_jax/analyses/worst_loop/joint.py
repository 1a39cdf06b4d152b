"""The worst disk margin of all commands at once over the box of uncertain numbers.

The command of every channel is multiplied by a complex factor. The disk margin alpha is the size of the smallest
factors' perturbations that make the loop oscillate; it is the inverse of the structured singular value mu.
"""

from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.loop_margins.multiloop import (
    JointLoops,
    JointMargins,
    JointPlaces,
    balanced_bounds,
    joint_margins,
    joint_places,
)
from dssc_jax.analyses.worst_loop.box import grown_box
from dssc_jax.analyses.worst_loop.cells import GAP, UNBOUNDED, CoverBounds, cover_box
from dssc_jax.analyses.worst_loop.family import BrokenFamily, Evaluate, LoopFamily, RemainingPoints, with_all_states
from dssc_jax.analyses.worst_loop.readouts import joint_readout
from dssc_jax.analyses.worst_loop.search import WorstPoint, spectral_radii, worst_values
from dssc_jax.engine.linearisation.matrices import StateMatrices
from dssc_jax.study import Study


class JointCase(NamedTuple):
    """The worst case of the disk margin alpha of all commands at once.

    Args:
        channels: Names of the channels whose commands are perturbed.
        names: Dotted names of the numbers that change the loop.
        drawn: Worst margin of the draws; 0: a loop is unstable.
        found: Worst margin found in the box; 0: a loop is unstable.
        numbers: The numbers of the loop with the worst margin found, by name.
        frequency: Frequency at which this loop oscillates with the perturbation found [rad/s].
        factors: Complex factor of each command in that perturbation, shape (channels,).
        bounded: Margin that holds on all of the box; NaN if no bound was found.
        cells: Number of cells for which bounds were computed.
    """

    channels: tuple[str, ...]
    names: tuple[str, ...]
    drawn: float
    found: float
    numbers: dict[str, float]
    frequency: float
    factors: np.ndarray
    bounded: float
    cells: int


def joint_disk_margins(matrices: np.ndarray, channels: int, sample_time: float) -> JointMargins:
    """The disk margins of n loops, by the balanced bound of mu, and perturbations that make the loops singular.

    An unstable loop has the margins 0, and NaN for frequency and factors.

    Args:
        matrices: [[A, B], [C, 0]], shape (n, states + channels, states + channels).
        channels: Columns of B.
        sample_time: T_s [s].
    """
    count = len(matrices)
    result = JointMargins(
        guaranteed=np.zeros(count),
        attained=np.zeros(count),
        frequency=np.full(count, np.nan),
        factors=np.full((count, channels), np.nan, complex),
    )
    is_stable = spectral_radii(matrices, channels) < 1.0
    if is_stable.any():
        a = matrices[is_stable, :-channels, :-channels]
        b = matrices[is_stable, :-channels, -channels:]
        c = matrices[is_stable, -channels:, :-channels]
        margins = joint_margins(JointLoops(a, b, c), np.linalg.eigvals(a), sample_time, balanced_bounds)
        for values, stable_values in zip(result, margins, strict=True):
            values[is_stable] = stable_values
    return result


def worst_joint_margin(
    evaluate: Evaluate, sides: int, channels: int, sample_time: float, budget: RemainingPoints
) -> WorstPoint:
    """Search the box for the worst disk margin of all commands at once.

    Args:
        evaluate: Gives the loops at points of the box [-1, 1]^n.
        sides: Number n of coordinates.
        channels: Number of commands.
        sample_time: T_s [s].
        budget: Number of points that may still be evaluated.
    """

    def attained_margins(points: np.ndarray) -> np.ndarray:
        """The attained disk margin at each point, shape (n, 1): the search has this one quantity."""
        return joint_disk_margins(evaluate(points), channels, sample_time).attained[:, None]

    (worst,) = worst_values(attained_margins, np.negative, sides, budget)  # a smaller margin is worse
    return worst


def joint_mu_bound(
    evaluate: Evaluate, sides: int, channels: int, goal: float, cells: int, budget: RemainingPoints
) -> CoverBounds:
    """Bound mu from above over the whole box; 1/mu is the disk margin of all commands at once.

    Cells are halved until the bound is at most ``goal``, or until the number of cells or the budget is spent.

    Args:
        evaluate: Gives the loops at points of the box [-1, 1]^n; that in the middle is stable.
        sides: Number n of the box's coordinates.
        channels: Number of commands.
        goal: The bound at which halving ends.
        cells: Largest number of cells.
        budget: Number of points that may still be evaluated.
    """
    return cover_box(evaluate, grown_box(sides, 1.0), np.array([goal]), cells, budget, joint_readout(channels))


def joint_case(
    broken: BrokenFamily, channels: tuple[str, ...], drawn_loops: np.ndarray, cells: int, points: int
) -> JointCase:
    """Find the worst disk margin of all commands at once: of the draws, of a search, and a bound for the whole box.

    Args:
        broken: The loop over the box, broken at the commands.
        channels: Names of the channels.
        drawn_loops: [[A, B], [C, 0]] of the draws, shape (n, states + channels, states + channels).
        cells: Largest number of cells.
        points: Largest number of points to linearise; a third of them is for the search.
    """
    sides = len(broken.sides)
    count = len(channels)
    budget = broken.family.allowance(points)
    search_budget = broken.family.allowance(points // 3)
    drawn = joint_disk_margins(drawn_loops, count, broken.sample_time).attained
    worst = worst_joint_margin(broken.at, sides, count, broken.sample_time, search_budget)
    at_worst = joint_disk_margins(broken.at(worst.point[None]), count, broken.sample_time)
    covered = CoverBounds(np.array([UNBOUNDED]), cells=0)
    if worst.value > 0.0:  # an unstable loop has no bound
        covered = joint_mu_bound(broken.at, sides, count, GAP / worst.value, cells, budget)
    (mu,) = covered.gains
    return JointCase(
        channels=channels,
        names=broken.names,
        drawn=float(drawn.min()),
        found=worst.value,
        numbers=broken.numbers(worst.point),
        frequency=float(at_worst.frequency[0]),
        factors=at_worst.factors[0],
        bounded=float(1.0 / mu if covered.stable else np.nan),
        cells=covered.cells,
    )


def seen_joint_places(study: Study, family: LoopFamily, drawn: StateMatrices) -> JointPlaces | None:
    """The commands with an effect in a draw or at a point linearised so far; None if fewer than two have one.

    Args:
        study: The study.
        family: The whole loop over the box.
        drawn: The loops of the draws that have an operating point.
    """
    loops = family.seen_loops(drawn)
    all_loops = np.ones(len(loops.a), bool)
    return joint_places(study.loop.channels, loops, all_loops)


def multiloop_case(
    study: Study, family: LoopFamily, drawn: StateMatrices, cells: int, remaining_points: RemainingPoints
) -> JointCase | None:
    """Find the worst disk margin of all commands at once; None if fewer than two commands have an effect.

    Args:
        study: The study.
        family: The whole loop over the box.
        drawn: The loops of the draws that have an operating point.
        cells: Largest number of cells.
        remaining_points: Number of points that may still be linearised.
    """
    joint = seen_joint_places(study, family, drawn)
    if joint is None:
        return None
    channels = tuple(study.loop.channels[index] for index in joint.channels)

    def known_states() -> np.ndarray:
        """Indices of the states between the commands, in a draw or at any point linearised so far, shape (states,)."""
        places = seen_joint_places(study, family, drawn)
        assert places is not None  # the loops seen so far become more, never fewer
        return places.states

    def search(broken: BrokenFamily) -> JointCase:
        """Find the worst case of all commands at once, with as many points as are left."""
        return joint_case(broken, channels, broken.break_loops(drawn), cells, remaining_points())

    return with_all_states(BrokenFamily(family, joint.states, joint.points.tolist()), known_states, search)
