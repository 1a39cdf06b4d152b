"""Local margins: the value of a number at which small deviations from the origin begin to grow."""

import time
from collections.abc import Callable
from enum import StrEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.analyses.defaults import BISECTIONS, POINTS
from dssc_jax.analyses.margins import Margins, search_critical
from dssc_jax.analyses.margins.search import CriticalDraws
from dssc_jax.analyses.margins.simulated import admissible_walk, numbers_along, require_spread
from dssc_jax.analyses.theory.linearised import (
    RestLinearisation,
    at_rest,
    continuous_matrix,
    linearise_at_rest,
    opaque_parts,
    require_continuous,
    start_at_rest,
)
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import values_of_draws
from dssc_jax.engine.linearisation.part_slopes import examination
from dssc_jax.engine.linearisation.smooth_parts import (
    declared_places,
    require_smooth_at,
    substitute_notes,
    substituted,
    with_inner_sides,
)
from dssc_jax.engine.plain import plain_options
from dssc_jax.engine.sampling import Arrays
from dssc_jax.study import Study
from dssc_jax.study.laws import SPREAD

SECOND_SAMPLE = 1
"""Index of the sample that is linearised: a controller may treat its first sample, 0, unlike the others."""


class Time(StrEnum):
    """Kind of linearisation: the sampled loop as it is simulated, or the loop with the law (22) in continuous time."""

    SAMPLED = "sampled"
    CONTINUOUS = "continuous"


CRITERIA = {
    Time.SAMPLED: "every eigenvalue of the sampled loop, linearised at the origin, inside the unit circle",
    Time.CONTINUOUS: "every eigenvalue of the loop with (22), linearised at the origin, in the left half-plane",
}


def criteria(study: Study, kind: Time) -> tuple[str, ...]:
    """Describe for reports what a draw has to meet in a linearisation, and which parts of the loop are left out.

    Args:
        study: A study on a plant of one channel.
        kind: Sampled or continuous.
    """
    if kind == Time.SAMPLED:
        return (CRITERIA[kind],)
    left_out = " and ".join(f"the {section}" for section in opaque_parts(study))
    if not left_out:
        return (CRITERIA[kind],)
    return CRITERIA[kind], f"plant, unmodelled dynamics and controller alone: {left_out} left out"


def require_in_criterion(study: Study, over: str, kind: Time) -> None:
    """Refuse a number that has no effect because the linearisation leaves out the part of the loop it belongs to.

    Args:
        study: A study on a plant of one channel.
        over: Dotted name of the number, which begins with the name of its section.
        kind: Sampled or continuous.

    Raises:
        ConfigError: The linearisation leaves the part out.
    """
    section = over.partition(".")[0]
    if kind == Time.CONTINUOUS and section in opaque_parts(study):
        raise ConfigError(
            over, f"has no effect in continuous time, which leaves the {section} out; use the sampled loop"
        )


def require_effect_at_rest(study: Study, resting: Study, over: str) -> None:
    """Refuse a number of the study on which the loop at rest does not depend, such as one of its reference.

    Args:
        study: The study.
        resting: The same study at rest, see :func:`at_rest`.
        over: Dotted name of the number, or ``spread``.

    Raises:
        ConfigError: The number has no effect.
    """
    acts_at_rest = over in resting.quantities and bool(resting.followers(over))
    if over in study.quantities and not acts_at_rest:
        raise ConfigError(over, "has no effect near the origin, where reference and disturbance are neglected")


class Spectrum(NamedTuple):
    """A function that computes the eigenvalues of a linearised loop, and notes on parts replaced in this loop.

    Args:
        eigenvalues: (values of every law and every swept number by name, shape (n,) each) -> eigenvalues,
            shape (n, states), of the step from sample to sample [1], or in continuous time [1/s]. The call raises
            ConfigError if the loop does not start at rest, or has no derivative there.
        notes: Sentences on the substitutes of parts without a derivative. The list grows as ``eigenvalues`` meets parts
            at their corners.
    """

    eigenvalues: Callable[[Arrays], np.ndarray]
    notes: list[str]


def spectrum(study: Study, kind: Time) -> Spectrum:
    """Compile the computation of the linearised loop's eigenvalues for many draws.

    Parts without a derivative are replaced by smooth substitutes.

    Args:
        study: A study at rest, see :func:`at_rest`.
        kind: Sampled or continuous.

    Raises:
        ConfigError: A part does not declare where it is smooth, or is smooth nowhere and has no substitute; or the loop
            has no form in continuous time, where that is asked for.
    """
    parts = declared_places(study, moving=False)
    is_continuous = kind == Time.CONTINUOUS
    if is_continuous:
        require_continuous(study)

    def smooth_loop(values: dict[str, jax.Array]) -> tuple[Loop, LoopParams]:
        """The loop with smooth substitutes, and its parameters, for the values of one draw; traced."""
        return substituted(study.loop, study.params(values), parts)

    def keyed_loop(values: dict[str, jax.Array], index: jax.Array) -> tuple[Loop, LoopParams, jax.Array]:
        """The smooth loop of a draw, its parameters, and the random key that :func:`start_at_rest` uses.

        ``index`` is not used: a loop at rest has no noise, so all draws share the key.
        """
        return *smooth_loop(values), jax.random.key(0)

    def start(values: dict[str, jax.Array]) -> jax.Array:
        """The state of a draw at which its loop is linearised, shape (states,)."""
        return start_at_rest(*smooth_loop(values))

    def linearise(values: dict[str, jax.Array], findings: jax.Array) -> RestLinearisation:
        """Linearise the loop of a draw; a part that ``findings`` place at a corner of its map has a substitute."""
        loop, params = smooth_loop(values)
        if is_continuous:
            return RestLinearisation(continuous_matrix(loop, params), jnp.zeros(()))  # no sample, so nothing moves
        return linearise_at_rest(*with_inner_sides(loop, params, parts, findings))

    notes = substitute_notes(parts)
    examine = examination(keyed_loop, parts)
    options = plain_options()
    starts = jax.jit(jax.vmap(start), compiler_options=options)
    linearisations = jax.jit(jax.vmap(linearise), compiler_options=options)

    def eigenvalues(values: Arrays) -> np.ndarray:
        """The eigenvalues of n draws, shape (n, states): the function that :class:`Spectrum` describes."""
        with jax.enable_x64(True):
            rest_states = np.asarray(starts(values))
            findings = examine(values, np.arange(len(rest_states)), rest_states, SECOND_SAMPLE)
            linear = jax.tree.map(np.asarray, linearisations(values, findings))
        if np.any(linear.displacement > 0.0):
            raise ConfigError(
                study.source, f"is not at rest at the origin: one sample moves it by {linear.displacement.max():.3g}"
            )
        for note in require_smooth_at(study, parts, findings):
            if note not in notes:
                notes.append(note)
        return np.linalg.eigvals(linear.matrix)

    return Spectrum(eigenvalues, notes)


def local_margin(
    study: Study,
    *,
    over: str,
    bounds: tuple[float, float],
    log: bool = False,
    points: int = POINTS,
    bisections: int = BISECTIONS,
    kind: Time = Time.SAMPLED,
) -> Margins:
    """Find the value of a number at which small deviations from the origin begin to grow, for every draw of a study.

    Reference, disturbance, initial state and requirements are ignored. Only stability counts, and only near the origin,
    where state-dependent functions have their values at sigma = e = 0.

    Args:
        study: A study on a plant of one channel, whose parts declare where they are smooth.
        over: Dotted name of the number.
        bounds: The safe end, then the other end.
        log: Space the values evenly in the logarithm.
        points: Number of values in the bracketing grid.
        bisections: Number of bisections of the grid cell.
        kind: Sampled or continuous.

    Returns:
        Margins whose slack is the rate [1/s] at which the slowest deviation decays.

    Raises:
        ConfigError: The loop has no linearisation, or the number or a bound is not admissible.
    """
    kind = Time(kind)
    resting = at_rest(study)
    began = time.perf_counter()
    walk = admissible_walk(over, bounds, log, points, bisections)
    require_effect_at_rest(study, resting, over)
    if over == SPREAD:
        require_spread(study, bounds)
    sweep = {} if over == SPREAD else {over: sorted(bounds)}  # makes the number an input of the program
    swept = resting.override({"sweep": sweep})
    draws = study.config.draws
    numbers_of = numbers_along(resting, over)
    require_in_criterion(resting, over, kind)
    laws = values_of_draws(swept, slice(0, draws))
    eigenvalues_of, notes = spectrum(swept, kind)

    def decay_rates(lanes: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Rate [1/s] at which the slowest deviation of each of some draws decays, each at its value of the number.

        A negative rate means that the deviation grows.
        """
        batch = np.resize(lanes, draws)  # repeated up to all draws: another size would be compiled again
        laws_of_batch = {name: column[batch] for name, column in laws.items()}
        numbers = numbers_of(laws_of_batch, np.resize(values, draws))
        eigenvalues = eigenvalues_of(numbers)[: len(lanes)]
        if kind == Time.CONTINUOUS:
            return -np.max(np.real(eigenvalues), axis=-1)
        return -np.log(np.max(np.abs(eigenvalues), axis=-1)) / swept.loop.sample_time

    critical = search_critical(decay_rates, draws, walk, bisections)
    return Margins.of(
        study,
        over,
        walk,
        CriticalDraws(critical, laws),
        criterion=(*criteria(resting, kind), *notes),
        seconds=time.perf_counter() - began,
        unit="1/s",
    )
