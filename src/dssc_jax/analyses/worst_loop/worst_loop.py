"""Worst case of every loop of a study over the box of its laws: found perturbations beside bounds."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from dssc_jax.analyses.defaults import CELLS, DERIVATIVES, MOST_CELLS, MOST_LINEARISED, SIGMA
from dssc_jax.analyses.loop_margins.operating_points import equilibria
from dssc_jax.analyses.worst_loop.box import admissible_growths, box_of
from dssc_jax.analyses.worst_loop.cells import CoverBounds, cover_box
from dssc_jax.analyses.worst_loop.family import BrokenFamily, LoopFamily, RemainingPoints, with_all_states
from dssc_jax.analyses.worst_loop.joint import multiloop_case, seen_joint_places
from dssc_jax.analyses.worst_loop.readouts import GAINS
from dssc_jax.analyses.worst_loop.result import LoopCase, WorstLoop, multiloop_dataset, worst_dataset
from dssc_jax.analyses.worst_loop.search import (
    MARGINS,
    Instability,
    WorstPoint,
    badness,
    margins_at,
    nearest_instability,
    radii_of,
    start_points,
    worst_margins,
)
from dssc_jax.closed_loop.break_points import BreakPoint, place_names
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.engine.linearisation.equilibria import RestingLoop
from dssc_jax.engine.linearisation.matrices import StateMatrices
from dssc_jax.engine.linearisation.response import common_grid
from dssc_jax.engine.linearisation.smooth_parts import Finding, LoopPart, declared_places, substitute_notes
from dssc_jax.study import Study, takes_file
from dssc_jax.study.known_draws import study_of_draw

GAP = 1.05  # ratio of a bound to the value found, at which the search for a better bound ends
SHARES = (0.95, 0.85, 0.7, 0.5, 0.3, 0.15)
"""The growths for which stability is tried to be proved, relative to the smallest one with an unstable loop."""
SEARCHED = 0.25  # share of the points for each of the two searches
TRIALS = 3  # one part in so many of the remaining points is for each further bound
LOOSEST = np.full(len(GAINS), 1e300)
"""Goals that any finite bounds meet."""


@takes_file
def worst_loop(
    study: Study,
    *,
    broken_at: Sequence[str] = (),
    sigma: float = SIGMA,
    cells: int = CELLS,
    points: int | None = None,
    progress: ProgressCallback | None = None,
) -> WorstLoop:
    """Find the worst margins of the linearised loop over the box of the laws, and bounds that hold on all of it.

    The loop is linearised at its equilibrium, as for :func:`dssc_jax.loop_margins`. Every uncertain number may have any
    value between the ends of its law, together with any values of the others. A search finds the worst values; the
    bounds hold for all numbers of the box and at all frequencies. The robust stability factor is the growth of the box
    about its middle up to which the loop stays stable, 1/mu.

    Args:
        study: The study, or its file; its sweep is ignored.
        broken_at: Names of break points; none: the command of each channel.
        sigma: Laws without ends are cut at this number of standard deviations of a normal law.
        cells: Largest number of cells (parts of the box and of the frequencies) for each loop and kind of bound.
        points: Largest number of points of the box at which the loop is linearised, for all loops together; by
            default as many as take 1,000,000 derivatives.
        progress: Called with the number of points linearised, and the largest number.

    Raises:
        ConfigError: The study has no uncertain number, its loop cannot be linearised or differs between draws of the
            same numbers, or an option is not admissible.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/motor.toml").override({"unmodelled.mu": 0.01, "draws": 64})
        >>> worst = dj.worst_loop(study).summary()["loops"]["input"]["margins"]["disk"]
        >>> worst["bounded"] <= worst["found"] <= worst["drawn"]
        True
    """
    began = time.perf_counter()
    require_independent(study, "a sample of all draws")
    require_sizes(cells, points)
    study = study.without_sweep()
    names = selected_break_points(study, broken_at)
    box = box_of(study, sigma)
    places = declared_places(study, moving=False)
    if progress:
        progress(0, points)
    resting = RestingLoop(study, places)
    operating, findings = equilibria(resting, study.config.draws)
    settled_findings = findings[operating.reached]
    require_one_linear_loop(study, places, settled_findings)
    most = points or max(1, DERIVATIVES // sum(operating.matrices.b.shape[1:]))

    def advance(linearised_points: int) -> None:
        if progress:
            progress(min(linearised_points, most), most)

    family = LoopFamily(resting, box, settled_findings[0], advance)
    family.require_no_other_uncertainty()
    probes = start_points(len(box.sides))
    family.at(np.concatenate([probes, admissible_growths(study, box)[0] * probes])[: max(1, most // 4)])
    drawn = StateMatrices(*(part[operating.reached] for part in operating.matrices))
    broken_loops = loops_broken_at(study, names, family, drawn)

    joint = None if broken_at else seen_joint_places(study, family, drawn)
    remaining_loops = len(broken_loops) + (joint is not None)
    cases = {}
    for name, broken in broken_loops.items():
        share = family.remaining_points(most) // remaining_loops

        def search(loop: BrokenFamily, share: int = share) -> LoopCase:
            return loop_case(study, loop, drawn, cells, min(share, family.remaining_points(most)))

        cases[name] = with_all_states(broken, partial(family.states_at, drawn, broken.places[0]), search)
        remaining_loops -= 1
    multiloop = None
    if joint is not None:
        multiloop = multiloop_case(study, family, drawn, GAP, cells, partial(family.remaining_points, most))
    return WorstLoop(
        study=study,
        dataset=worst_dataset(box, cases).merge(multiloop_dataset(box, multiloop)),
        sigma=sigma,
        taken=(*substitute_notes(places), *operating.taken),
        points=len(family.cache),
        most_points=most,
        seconds=time.perf_counter() - began,
    )


def require_sizes(cells: int, points: int | None) -> None:
    """Require admissible numbers of cells and of points.

    Raises:
        ConfigError: A number is too large or not positive.
    """
    if not 0 < cells <= MOST_CELLS:
        raise ConfigError("cells", f"must be within [1, {MOST_CELLS}], got {cells}")
    if points is not None and not 0 < points <= MOST_LINEARISED:
        raise ConfigError("points", f"must be within [1, {MOST_LINEARISED}], got {points}")


def selected_break_points(study: Study, broken_at: Sequence[str]) -> tuple[str, ...]:
    """The break points of the given names; without names, the command of each channel.

    Raises:
        ConfigError: The loop has no break point of a name.
    """
    names = place_names(study.loop.channels)
    for name in broken_at:
        if name not in names:
            hint = f"{nearest(name, names)}{signal_hint(study, name)}"
            raise ConfigError("broken_at", f"has no break point '{name}'; {hint}")
    return tuple(broken_at) or tuple(name for name in names if name.endswith(BreakPoint.INPUT))


def require_one_linear_loop(study: Study, places: Sequence[LoopPart], findings: np.ndarray) -> None:
    """Require that every part of the loop has the same linear form in all draws.

    Args:
        study: The study.
        places: The parts.
        findings: The :class:`~dssc_jax.engine.linearisation.smooth_parts.Finding` on each part in each draw that has
            an equilibrium, shape (draws, parts).

    Raises:
        ConfigError: A part rests at or beyond a boundary of its smooth range in some of the draws.
    """
    differing_parts = np.flatnonzero(np.any(findings != findings[0], axis=0))
    if not differing_parts.size:
        return
    place = places[differing_parts[0]]
    boundary = place.remaining.meaning.partition(";")[0]
    count = int(np.count_nonzero(findings[:, differing_parts[0]] != Finding.SMOOTH))
    raise ConfigError(
        study.source,
        f"{place.label} rests at or beyond {boundary} in {count} of {len(findings)} draws, so that no one linear loop "
        "covers all; give it room, or narrow the laws that bring it there",
    )


def loops_broken_at(
    study: Study, names: Sequence[str], family: LoopFamily, drawn: StateMatrices
) -> dict[str, BrokenFamily]:
    """The loop over the box, broken at each of some break points, by name; those without an effect are left out.

    Args:
        study: The study.
        names: Names of the break points.
        family: The whole loop over the box.
        drawn: The loops of the draws that have an operating point.

    Raises:
        ConfigError: None has an effect, or no uncertain number changes one of the loops.
    """
    all_names = place_names(study.loop.channels)
    broken_loops = {}
    for name in names:
        index = all_names.index(name)
        states = family.states_at(drawn, index)
        if states.size:
            broken_loops[name] = BrokenFamily(family, states, [index])
    if not broken_loops:
        raise ConfigError(study.source, "no break point has an effect: the loop is open at its equilibrium")
    for name, broken in broken_loops.items():
        if not broken.sides:
            raise ConfigError(study.source, f"has no uncertain number that changes the loop broken at {name}")
    return broken_loops


def signal_hint(study: Study, name: str) -> str:
    """A hint for the message about an unknown break point that has the name of a measured signal; else empty."""
    measured_names = [signal.name for signal in study.loop.measures]
    if name not in measured_names and not name.startswith("measured_"):
        return ""
    return (
        "; a measured signal is no break point: 'input' has the margins for one factor of all measured signals, "
        "since they act through one command; `margin` walks the gain of one signal, such as controller.signals.0"
    )


class GainBounds(NamedTuple):
    """What is proved of one broken loop.

    Args:
        covered: Bounds of the gains on all of the box.
        growth: Growth of the box up to which the loop is proved to be stable.
    """

    covered: CoverBounds
    growth: float


def loop_case(study: Study, broken: BrokenFamily, drawn: StateMatrices, cells: int, points: int) -> LoopCase:
    """Find the worst case of one broken loop: that of the draws, that of searches, and bounds.

    Args:
        study: The study.
        broken: The broken loop over the box.
        drawn: The loops of the draws that have an operating point.
        cells: Largest number of cells.
        points: Largest number of points to linearise.
    """
    family = broken.family
    remaining_points = family.allowance(points)
    search_points = round(SEARCHED * points)
    sides = len(broken.sides)
    sample_time = study.config.loop.sample_time
    drawn_loops = broken.break_loops(drawn)
    common_angles = common_grid(np.linalg.eigvals(drawn_loops[:, :-1, :-1]))
    drawn_margins = margins_at(drawn_loops, common_angles, sample_time)
    worst_drawn = drawn_margins[np.argmax(badness(drawn_margins), axis=0), range(len(MARGINS))]
    worst_cases = worst_margins(broken.at, sides, common_angles, sample_time, family.allowance(search_points))
    growable, instability = defined_instability(study, broken, lambda: family.allowance(search_points))
    bounds = find_bounds(broken, worst_cases, instability, growable, sample_time, cells, remaining_points)
    return LoopCase(
        names=broken.names,
        drawn=worst_drawn,
        found=np.array([worst.value for worst in worst_cases]),
        numbers=[broken.numbers(worst.point) for worst in worst_cases],
        bounded=bounded_margins(bounds.covered.gains, sample_time),
        growth_found=instability.growth,
        unstable=broken.numbers(instability.point),
        has_operating_point=not np.isfinite(instability.growth) or broken.has_operating_point(instability.point),
        growth_bounded=bounds.growth,
        growable=growable,
        cells=bounds.covered.cells,
    )


def defined_instability(
    study: Study, broken: BrokenFamily, allowance: Callable[[], RemainingPoints]
) -> tuple[float, Instability]:
    """Find the nearest unstable loop, in the largest growth of the box in which that loop's numbers are defined.

    Within a grown box a number may be undefined although it is defined at the ends, such as the root of a difference.
    A point with such a number is neither stable nor unstable.

    Args:
        study: The study.
        broken: The broken loop over the box.
        allowance: () -> the number of points that a further search may evaluate.

    Returns:
        The growth that was searched, and the unstable loop.

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


def find_bounds(
    broken: BrokenFamily,
    worst_cases: list[WorstPoint],
    instability: Instability,
    growable: float,
    sample_time: float,
    cells: int,
    remaining_points: RemainingPoints,
) -> GainBounds:
    """Bound the gains of one broken loop on the box, and the growth of the box up to which the loop is stable.

    Args:
        broken: The broken loop over the box.
        worst_cases: The worst values found of the :data:`MARGINS`, which are the goals of the bounds.
        instability: The nearest unstable loop found.
        growable: Largest growth that was searched.
        sample_time: T_s [s].
        cells: Largest number of cells.
        remaining_points: Number of points that may still be linearised.
    """
    sides = len(broken.sides)
    unbounded = CoverBounds(np.full(len(GAINS), np.inf), 0)
    if radii_of(broken.at(np.zeros((1, sides))))[0] >= 1.0:
        return GainBounds(unbounded, 0.0)
    ones = np.ones(sides)
    covered = unbounded
    growth = 0.0
    if instability.growth > 1.0:
        worst = dict(zip(MARGINS, (case.value for case in worst_cases), strict=True))
        gains_found = (
            worst["sensitivity_peak"],
            worst["complementary_peak"],
            1.0 / worst["disk"],
            sample_time / worst["delay"] if np.isfinite(worst["delay"]) else 1e-3,
        )
        covered = cover_box(
            broken.at,
            (-ones, ones),
            GAP * np.array(gains_found),
            cells,
            broken.family.allowance(2 * remaining_points() // TRIALS),
        )
        growth = 1.0 if covered.stable else 0.0
    cell_count = covered.cells
    farthest = min(instability.growth, growable)
    for share in (1.0, *SHARES) if instability.growth > growable else SHARES:
        trial_growth = share * farthest
        if trial_growth <= growth:
            break
        ends = (-trial_growth * ones, trial_growth * ones)
        trial = cover_box(broken.at, ends, LOOSEST, cells // 4, broken.family.allowance(remaining_points() // TRIALS))
        cell_count += trial.cells
        if trial.stable:
            growth = trial_growth
            break
    return GainBounds(covered._replace(cells=cell_count), growth)


def bounded_margins(gains: np.ndarray, sample_time: float) -> np.ndarray:
    """The :data:`MARGINS` that bounds of the gains guarantee, shape (margins,); NaN if a bound is not finite.

    A bound of S, of T and of (S - T)/2 each guarantees a range of gains and phases. The widest range counts.

    Args:
        gains: Bounds of |S|, |T|, |S - T|/2 and |T| theta, the order of :data:`GAINS`; theta is the angle per sample.
        sample_time: T_s [s].

    Reference:
        P. Seiler, A. Packard, P. Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020).
    """
    if not np.all(np.isfinite(gains)):
        return np.full(len(MARGINS), np.nan)
    s, t, half_difference, delay_gain = gains  # in the order of GAINS
    alpha = 1.0 / half_difference
    upper_by_disk = (2.0 + alpha) / (2.0 - alpha) if alpha < 2.0 else np.inf
    upper_by_s = s / (s - 1.0) if s > 1.0 else np.inf
    upper = max(1.0 + 1.0 / t, upper_by_disk, upper_by_s)
    lower = max(0.0, min((2.0 - alpha) / (2.0 + alpha), s / (s + 1.0), 1.0 - 1.0 / t))
    phase_by_disk = 2.0 * np.arctan(0.5 * alpha)
    phase = max(phase_by_disk, 2.0 * np.arcsin(min(1.0, 0.5 / s)), 2.0 * np.arcsin(min(1.0, 0.5 / t)))
    return np.array([upper, lower, phase, sample_time / delay_gain, alpha, s, t])
