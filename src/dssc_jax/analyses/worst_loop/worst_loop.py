"""Worst case of every loop of a study over the box of its laws: found perturbations beside bounds."""

import time
from collections.abc import Sequence
from functools import partial

import numpy as np

from dssc_jax.analyses.defaults import CELLS, DERIVATIVES, MOST_CELLS, MOST_LINEARISED, SIGMA
from dssc_jax.analyses.loop_margins.operating_points import equilibria
from dssc_jax.analyses.worst_loop.box import admissible_growths, box_of
from dssc_jax.analyses.worst_loop.dataset import LoopCase, multiloop_dataset, worst_dataset
from dssc_jax.analyses.worst_loop.family import BrokenFamily, LoopFamily, with_all_states
from dssc_jax.analyses.worst_loop.joint import multiloop_case, seen_joint_places
from dssc_jax.analyses.worst_loop.result import WorstLoop
from dssc_jax.analyses.worst_loop.search import start_points
from dssc_jax.analyses.worst_loop.single_loop import loop_case
from dssc_jax.closed_loop.break_points import BreakPoint, place_names
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.engine.linearisation.equilibria import RestingLoop
from dssc_jax.engine.linearisation.matrices import StateMatrices
from dssc_jax.engine.linearisation.smooth_parts import Finding, LoopPart, declared_places, substitute_notes
from dssc_jax.study import Study, takes_file


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
    value between the ends of its law, together with any values of the others. A search finds the worst values. The
    bounds cover all numbers of the box and all frequencies. They rest on deviations from a linear dependence that are
    measured at points and widened, so they are no proof. The robust stability factor is the growth of the box about
    its middle up to which the loop stays stable, 1/mu.

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
    _, states, break_points = operating.matrices.b.shape
    most_points = points or max(1, DERIVATIVES // (states + break_points))

    def advance(linearised_points: int) -> None:
        """Report the number of points linearised so far."""
        if progress:
            progress(min(linearised_points, most_points), most_points)

    family = LoopFamily(resting, box, settled_findings[0], advance)
    family.require_no_other_uncertainty()
    linearise_widely(study, family, max(1, most_points // 4))
    drawn = StateMatrices(*(part[operating.reached] for part in operating.matrices))
    broken_loops = loops_broken_at(study, names, family, drawn)
    has_multiloop = not broken_at and seen_joint_places(study, family, drawn) is not None
    cases = loop_cases(study, broken_loops, drawn, cells, most_points, other_loops=int(has_multiloop))
    multiloop = None
    if has_multiloop:
        multiloop = multiloop_case(study, family, drawn, cells, partial(family.remaining_points, most_points))
    return WorstLoop(
        study=study,
        dataset=worst_dataset(box, cases).merge(multiloop_dataset(box, multiloop)),
        sigma=sigma,
        taken=(*substitute_notes(places), *operating.taken),
        points=len(family.cache),
        most_points=most_points,
        seconds=time.perf_counter() - began,
    )


def linearise_widely(study: Study, family: LoopFamily, most_points: int) -> None:
    """Linearise the loop at points all over the box and its largest growth, to see which states have an effect.

    Args:
        study: The study.
        family: The whole loop over the box, whose cache takes the points.
        most_points: Largest number of points.
    """
    points = start_points(len(family.box.sides))
    largest_growth, *_ = admissible_growths(study, family.box)
    family.at(np.concatenate([points, largest_growth * points])[:most_points])


def loop_cases(
    study: Study,
    broken_loops: dict[str, BrokenFamily],
    drawn: StateMatrices,
    cells: int,
    most_points: int,
    other_loops: int,
) -> dict[str, LoopCase]:
    """Find the worst case of each broken loop, by the name of its break point.

    Each loop has an equal share of the points that are left when its turn comes.

    Args:
        study: The study.
        broken_loops: The loop over the box, broken at each break point, by name.
        drawn: The loops of the draws that have an operating point.
        cells: Largest number of cells for each loop.
        most_points: Largest number of points to linearise for all loops together.
        other_loops: Number of further searches that follow and need an equal share of the points.
    """
    remaining_loops = len(broken_loops) + other_loops
    cases = {}
    for name, broken in broken_loops.items():
        share = broken.family.remaining_points(most_points) // remaining_loops
        cases[name] = case_with_all_states(study, broken, drawn, cells, share, most_points)
        remaining_loops -= 1
    return cases


def case_with_all_states(
    study: Study, broken: BrokenFamily, drawn: StateMatrices, cells: int, share: int, most_points: int
) -> LoopCase:
    """Find the worst case of one broken loop, including every state that has an effect at a point that is searched.

    Args:
        study: The study.
        broken: The broken loop over the box, with the states that are known before the searches.
        drawn: The loops of the draws that have an operating point.
        cells: Largest number of cells.
        share: Largest number of points to linearise in one search.
        most_points: Largest number of points to linearise for all loops together.
    """
    family = broken.family
    (place,) = broken.places

    def known_states() -> np.ndarray:
        """Indices of the states that matter for this loop, in a draw or at any point linearised so far."""
        return family.states_at(drawn, place)

    def search(loop: BrokenFamily) -> LoopCase:
        """The worst case of the broken loop with the states that it has so far."""
        return loop_case(study, loop, drawn, cells, min(share, family.remaining_points(most_points)))

    return with_all_states(broken, known_states, search)


def require_sizes(cells: int, points: int | None) -> None:
    """Require admissible numbers of cells and of points.

    Raises:
        ConfigError: One of the two is too large or not positive.
    """
    if not 0 < cells <= MOST_CELLS:
        raise ConfigError("cells", f"must be within [1, {MOST_CELLS}], got {cells}")
    if points is not None and not 0 < points <= MOST_LINEARISED:
        raise ConfigError("points", f"must be within [1, {MOST_LINEARISED}], got {points}")


def selected_break_points(study: Study, broken_at: Sequence[str]) -> tuple[str, ...]:
    """Names of the break points to use: those stated, or by default the command of each channel.

    Raises:
        ConfigError: A stated name is not that of a break point.
    """
    known_names = place_names(study.loop.channels)
    for name in broken_at:
        if name not in known_names:
            hint = f"{nearest(name, known_names)}{signal_hint(study, name)}"
            raise ConfigError("broken_at", f"has no break point '{name}'; {hint}")
    commands = tuple(name for name in known_names if name.endswith(BreakPoint.INPUT))
    return tuple(broken_at) or commands


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
    first = differing_parts[0]
    place = places[first]
    boundary, _, _ = place.remaining.meaning.partition(";")  # its first clause
    count = int(np.count_nonzero(findings[:, first] != Finding.SMOOTH))
    raise ConfigError(
        study.source,
        f"{place.label} rests at or beyond {boundary} in {count} of {len(findings)} draws, so that no one linear loop "
        "covers all; give it room, or narrow the laws that bring it there",
    )


def loops_broken_at(
    study: Study, names: Sequence[str], family: LoopFamily, drawn: StateMatrices
) -> dict[str, BrokenFamily]:
    """The loop over the box, broken at each of some break points, by name.

    Break points without an effect are left out.

    Args:
        study: The study.
        names: Names of the break points.
        family: The whole loop over the box.
        drawn: The loops of the draws that have an operating point.

    Raises:
        ConfigError: No break point has an effect, or one of the loops does not depend on any uncertain number.
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
    """A hint for the error message if an unknown break point is the name of a measured signal; otherwise empty."""
    measured_names = [signal.name for signal in study.loop.measures]
    if name not in measured_names and not name.startswith("measured_"):
        return ""
    return (
        "; a measured signal is no break point: 'input' has the margins for one factor of all measured signals, "
        "since they act through one command; `margin` walks the gain of one signal, such as controller.signals.0"
    )
