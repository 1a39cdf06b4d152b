"""The worst case of the loop broken at one place: of the draws, of searches in the box, and bounds for all of it."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.worst_loop.box import admissible_growths, grown_box
from dssc_jax.analyses.worst_loop.cells import GAP, UNBOUNDED, CoverBounds, cover_box
from dssc_jax.analyses.worst_loop.dataset import LoopCase
from dssc_jax.analyses.worst_loop.family import BrokenFamily, RemainingPoints
from dssc_jax.analyses.worst_loop.readouts import GAINS
from dssc_jax.analyses.worst_loop.search import (
    MARGINS,
    Instability,
    WorstPoint,
    badness,
    margins_at,
    nearest_instability,
    spectral_radii,
    worst_margins,
)
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.linearisation.matrices import StateMatrices
from dssc_jax.engine.linearisation.response import common_grid
from dssc_jax.study import Study
from dssc_jax.study.known_draws import study_of_draw

SHARES = (0.95, 0.85, 0.7, 0.5, 0.3, 0.15)
"""The growths for which a proof of stability is tried, relative to the smallest one with an unstable loop."""
SEARCHED = 0.25  # share of the points for each of the two searches
TRIALS = 3  # each further bound gets the remaining points divided by this number
FREE_DELAY_GAIN = 1e-3  # goal for the gain of the delay where no delay found makes the loop unstable
LOOSEST = np.full(len(GAINS), 1e300)
"""Goals that any finite bounds meet."""


class GainBounds(NamedTuple):
    """Bounds for one broken loop.

    Args:
        covered: Bounds of the gains on all of the box.
        growth: Factor of growth of the box up to which the bounds show that the loop is stable.
    """

    covered: CoverBounds
    growth: float


class WorstFound(NamedTuple):
    """Results of the two searches of one broken loop.

    Args:
        margins: The worst value of each of the :data:`MARGINS` within the box.
        instability: The unstable loop nearest to the middle of the box.
        growable: Largest factor of growth of the box in which an unstable loop was searched.
    """

    margins: list[WorstPoint]
    instability: Instability
    growable: float


def loop_case(study: Study, broken: BrokenFamily, drawn: StateMatrices, cells: int, points: int) -> LoopCase:
    """Find the worst case of one broken loop: of the draws, of two searches, and bounds for the whole box.

    Args:
        study: The study.
        broken: The broken loop over the box.
        drawn: The loops of the draws that have an operating point.
        cells: Largest number of cells.
        points: Largest number of points to linearise.
    """
    remaining_points = broken.family.allowance(points)
    drawn_loops = broken.break_loops(drawn)
    common_angles = common_grid(np.linalg.eigvals(drawn_loops[:, :-1, :-1]))
    drawn_margins = margins_at(drawn_loops, common_angles, broken.sample_time)
    worst_draws = np.argmax(badness(drawn_margins), axis=0)  # one for each margin
    found = search_box(study, broken, common_angles, round(SEARCHED * points))
    bounds = find_bounds(broken, found, cells, remaining_points)
    growth_found, unstable_point = found.instability
    return LoopCase(
        names=broken.names,
        drawn=drawn_margins[worst_draws, range(len(MARGINS))],
        found=np.array([worst.value for worst in found.margins]),
        numbers=[broken.numbers(worst.point) for worst in found.margins],
        bounded=bounded_margins(bounds.covered.gains, broken.sample_time),
        growth_found=growth_found,
        unstable=broken.numbers(unstable_point),
        has_operating_point=not np.isfinite(growth_found) or broken.has_operating_point(unstable_point),
        growth_bounded=bounds.growth,
        growable=found.growable,
        cells=bounds.covered.cells,
    )


def search_box(study: Study, broken: BrokenFamily, common_angles: np.ndarray, points: int) -> WorstFound:
    """Search the box for the worst margins, and the box and its growths for the nearest unstable loop.

    Args:
        study: The study.
        broken: The broken loop over the box.
        common_angles: omega T_s at which every loop is evaluated.
        points: Largest number of points to linearise in each of the two searches.
    """
    family = broken.family
    worst_points = worst_margins(
        broken.at, len(broken.sides), common_angles, broken.sample_time, family.allowance(points)
    )
    growable, instability = defined_instability(study, broken, lambda: family.allowance(points))
    worst_disk = worst_points[MARGINS.index("disk")]
    return WorstFound(worst_points, nearer_instability(instability, worst_disk), growable)


def nearer_instability(instability: Instability, worst_disk: WorstPoint) -> Instability:
    """The nearer of the unstable loops that the two searches found.

    The search for the worst margins may meet an island of unstable loops that lies between the growths tested by the
    search for the nearest instability.

    Args:
        instability: The unstable loop that the search for the nearest one found.
        worst_disk: The worst disk margin that the other search found; 0: that loop is unstable.
    """
    growth = float(np.abs(worst_disk.point).max())
    if worst_disk.value > 0.0 or growth >= instability.growth:
        return instability
    return Instability(growth, worst_disk.point)


def defined_instability(
    study: Study, broken: BrokenFamily, allowance: Callable[[], RemainingPoints]
) -> tuple[float, Instability]:
    """Find the nearest unstable loop, in the largest growth of the box in which the numbers of this loop are defined.

    Inside a grown box a number may be undefined although it is defined at the ends, such as the root of a difference. A
    point with such a number is neither stable nor unstable; a smaller growth is then searched.

    Args:
        study: The study.
        broken: The broken loop over the box.
        allowance: () -> the number of points that a further search may evaluate.

    Returns:
        The growth that was searched last, and the unstable loop.

    Raises:
        ConfigError: A number is undefined within the box itself.
    """
    for growth in admissible_growths(study, broken.family.box):
        instability = nearest_instability(broken.at, len(broken.sides), growth, allowance())
        if not np.isfinite(instability.growth):
            return growth, instability
        try:
            study_of_draw(study, broken.numbers(instability.point))
        except ConfigError:
            if growth == 1.0:
                raise
            continue
        return growth, instability
    raise AssertionError("the box is always one of its growths")


def find_bounds(broken: BrokenFamily, found: WorstFound, cells: int, remaining_points: RemainingPoints) -> GainBounds:
    """Bound the gains of one broken loop on the box, and the growth of the box up to which the loop is stable.

    Args:
        broken: The broken loop over the box.
        found: Results of the searches, which set the goals of the bounds.
        cells: Largest number of cells.
        remaining_points: Number of points that may still be linearised.
    """
    sides = len(broken.sides)
    no_bounds = CoverBounds(np.full(len(GAINS), UNBOUNDED), cells=0)
    (middle_radius,) = spectral_radii(broken.at(np.zeros((1, sides))))
    if middle_radius >= 1.0:
        return GainBounds(no_bounds, growth=0.0)
    covered = no_bounds
    growth = 0.0
    if found.instability.growth > 1.0:  # no loop of the box was found to be unstable
        goals = GAP * found_gains(found.margins, broken.sample_time)
        budget = broken.family.allowance(2 * remaining_points() // TRIALS)
        covered = cover_box(broken.at, grown_box(sides, 1.0), goals, cells, budget)
        growth = 1.0 if covered.stable else 0.0
    cell_count = covered.cells
    for trial_growth in trial_growths(found):
        if trial_growth <= growth:
            break
        budget = broken.family.allowance(remaining_points() // TRIALS)
        trial = cover_box(broken.at, grown_box(sides, trial_growth), LOOSEST, cells // 4, budget)
        cell_count += trial.cells
        if trial.stable:
            growth = trial_growth
            break
    return GainBounds(covered._replace(cells=cell_count), growth)


def trial_growths(found: WorstFound) -> list[float]:
    """Growths of the box for which bounds that show stability are tried, the largest first.

    They are shares of the growth at which an unstable loop was found, or of the largest growth searched.
    """
    largest = min(found.instability.growth, found.growable)
    shares = SHARES
    if found.instability.growth > found.growable:  # the largest growth itself may be stable
        shares = (1.0, *SHARES)
    return [share * largest for share in shares]


def found_gains(worst_points: list[WorstPoint], sample_time: float) -> np.ndarray:
    """The :data:`GAINS` that the worst margins found correspond to, shape (gains,). No valid bound can be lower.

    Args:
        worst_points: The worst value found of each of the :data:`MARGINS`, and where it was found.
        sample_time: T_s [s].
    """
    worst = {name: found.value for name, found in zip(MARGINS, worst_points, strict=True)}
    delay_gain = sample_time / worst["delay"] if np.isfinite(worst["delay"]) else FREE_DELAY_GAIN
    gains = {
        "sensitivity_peak": worst["sensitivity_peak"],
        "complementary_peak": worst["complementary_peak"],
        "disk": 1.0 / worst["disk"],
        "delay": delay_gain,
    }
    return np.array([gains[name] for name in GAINS])


def bounded_margins(gains: np.ndarray, sample_time: float) -> np.ndarray:
    """The :data:`MARGINS` that bounds of the gains guarantee, shape (margins,); NaN if a bound is not finite.

    The bounds of S, of T and of (S - T)/2 each guarantee a range of gains and phases. The widest of the three counts.

    Args:
        gains: Bounds of |S|, |T|, |S - T|/2 and |T| theta, the order of :data:`GAINS`; theta is the angle per sample.
        sample_time: T_s [s].

    Reference:
        P. Seiler, A. Packard, P. Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020).
    """
    if not np.all(np.isfinite(gains)):
        return np.full(len(MARGINS), np.nan)
    s, t, half_difference, delay_gain = gains  # in the order of GAINS
    alpha = 1.0 / half_difference  # the disk margin
    upper_by_disk = (2.0 + alpha) / (2.0 - alpha) if alpha < 2.0 else np.inf
    upper_by_s = s / (s - 1.0) if s > 1.0 else np.inf
    lower_by_disk = (2.0 - alpha) / (2.0 + alpha)
    phase_by_s = 2.0 * np.arcsin(min(1.0, 0.5 / s))
    phase_by_t = 2.0 * np.arcsin(min(1.0, 0.5 / t))
    margins = {
        "gain_upper": max(1.0 + 1.0 / t, upper_by_disk, upper_by_s),
        "gain_lower": max(0.0, min(lower_by_disk, s / (s + 1.0), 1.0 - 1.0 / t)),
        "phase": max(2.0 * np.arctan(0.5 * alpha), phase_by_s, phase_by_t),
        "delay": sample_time / delay_gain,
        "disk": alpha,
        "sensitivity_peak": s,
        "complementary_peak": t,
    }
    return np.array([margins[name] for name in MARGINS])
