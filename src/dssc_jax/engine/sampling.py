"""Sampling: draw i as a point of the unit cube, and its mapping to values of the laws.

Random draws depend on (seed, i) only, never on the number of draws, the chunk or the device; a factor's draws also
depend on its name, but not on other factors. The points of the other designs are distributed over independent
replicates: draw i belongs to replicate i mod R. Sobol points can be extended (but an additional law changes all of
them); those of a Latin hypercube cannot.
"""

import warnings
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import scipy

from dssc_jax.core.numerics import stream
from dssc_jax.engine.compiled_lanes import compiled_lanes
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.study import Study

OUTERMOST_LEVEL = 2.0**-53  # keeps quantiles of unbounded laws finite
Arrays = dict[Any, np.ndarray]
"""Arrays by name; derivatives by :class:`dssc_jax.engine.evaluation.Derivative`."""

SOBOL_BITS = 30  # of a coordinate; scipy's fast_forward knows words of 32 bits only


def draw_key(seed: jax.Array | int, index: jax.Array | int) -> jax.Array:
    """The random key of draw ``index``."""
    return jax.random.fold_in(jax.random.key(seed), index)


@lru_cache(maxsize=1)
def level_program() -> CompiledLanes:
    """Machine code for (seed, draw index, stream of a factor) -> a number of the half-open unit interval."""

    def level(seed: jax.Array, index: jax.Array, factor: jax.Array) -> jax.Array:
        return jax.random.uniform(jax.random.fold_in(draw_key(seed, index), factor), dtype=jnp.float64)

    word = jax.ShapeDtypeStruct((), np.uint32)
    with jax.enable_x64(True), jax.threefry_partitionable(True):
        return compiled_lanes(level, word, word, word)


def uniform(seed: int, streams: tuple[int, ...], indices: np.ndarray) -> np.ndarray:
    """Independent points of the half-open unit cube, shape (n, streams)."""
    draws, factors = np.meshgrid(indices, np.array(streams, np.uint32), indexing="ij")
    columns = np.full(draws.size, seed), draws.ravel(), factors.ravel()
    one_thread = 1  # while all of them may simulate the block before
    return level_program().start(columns, draws.size, one_thread)().reshape(draws.shape)


def random_points(study: Study, streams: tuple[int, ...], indices: np.ndarray) -> np.ndarray:
    """Independent points."""
    return uniform(study.config.seed, streams, indices)


def generator(*words: int) -> np.random.Generator:
    """A separate host generator for each tuple of numbers."""
    return np.random.default_rng(np.random.SeedSequence(words))


def sobol_points(dimension: int, start: int, end: int, words: Sequence[int]) -> np.ndarray:
    """Points start .. end - 1, at cell centres, of a Sobol sequence whose scrambling is drawn from ``words``.

    Returns:
        Shape (end - start, dimension).
    """
    from scipy.stats import qmc

    sequence = qmc.Sobol(dimension, scramble=True, bits=SOBOL_BITS, rng=generator(*words))
    if start:
        sequence.fast_forward(start)
    with warnings.catch_warnings():  # a block need not be a power of two; the study's whole design is
        warnings.filterwarnings("ignore", "The balance properties of Sobol' points require n to be a power of 2")
        return sequence.random(end - start) + 0.5**SOBOL_BITS / 2.0


def replicated_sobol(study: Study, streams: tuple[int, ...], indices: np.ndarray) -> np.ndarray:
    """Scrambled Sobol points, including the first; every replicate has its own scrambling."""
    points = np.empty((len(indices), len(streams)))
    position, replicate = np.divmod(indices, study.config.replicates)
    for r in np.unique(replicate):
        members = replicate == r
        start = int(position[members].min())
        end = int(position[members].max()) + 1
        words = (study.config.seed, stream("sobol"), int(r))
        points[members] = sobol_points(len(streams), start, end, words)[position[members] - start]
    return points


@lru_cache(maxsize=1)
def latin_design(seed: int, streams: tuple[int, ...], replicates: int, draws: int) -> np.ndarray:
    """All points of independent Latin hypercubes, shape (draws, factors): a design of one dimension for each factor."""
    from scipy.stats import qmc

    design = np.empty((draws // replicates, replicates, len(streams)))
    for column, factor in enumerate(streams):
        for replicate in range(replicates):
            sequence = qmc.LatinHypercube(1, rng=generator(seed, factor, replicate))
            design[:, replicate, column] = sequence.random(draws // replicates)[:, 0]
    return design.reshape(-1, len(streams))


def replicated_latin(study: Study, streams: tuple[int, ...], indices: np.ndarray) -> np.ndarray:
    """Points of Latin hypercubes, one per replicate. They depend on the number of draws."""
    config = study.config
    return latin_design(config.seed, streams, config.replicates, config.draws)[indices]


SAMPLING_DESIGNS: dict[str, Callable[[Study, tuple[int, ...], np.ndarray], np.ndarray]] = {
    "random": random_points,
    "auto": random_points,  # of analyses; a run chooses first, see runs/design_choice.py
    "sobol": replicated_sobol,
    "lhs": replicated_latin,
}


def unit_points(study: Study, indices: np.ndarray) -> np.ndarray:
    """Points of the open unit cube by the study's design, with one column per factor.

    Returns:
        Shape (n, number of laws), float64 for every precision of the study.
    """
    names = list(study.laws)
    if not names:
        return np.empty((len(indices), 0))
    streams = tuple(stream(name) for name in names)
    if len(set(streams)) != len(streams):
        raise ValueError(f"two factors share a random stream; rename one of {names}")
    return inside_cube(SAMPLING_DESIGNS[study.config.sampling](study, streams, np.asarray(indices)))


def inside_cube(points: np.ndarray) -> np.ndarray:
    """Points moved away from the faces of the unit cube, where quantiles may be infinite."""
    return np.clip(points, OUTERMOST_LEVEL, 1.0 - OUTERMOST_LEVEL)


def values_at(study: Study, points: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the uncertain numbers at points of the unit cube; correlated numbers through a Gaussian copula.

    Args:
        study: The study.
        points: Independent uniform coordinates, one column per law, shape (n, laws).

    Returns:
        For each factor an array of shape (n,), float64.
    """
    names = list(study.laws)
    points = np.asarray(points).copy()
    coupled = [names.index(name) for name in study.correlated]
    if coupled:
        normal = scipy.special.ndtri(points[:, coupled]) @ np.linalg.cholesky(study.correlation).T
        points[:, coupled] = inside_cube(scipy.special.ndtr(normal))
    return values_at_levels(study, points)


def values_at_levels(study: Study, levels: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the uncertain numbers at levels of their laws, one column per law; correlations are in the levels."""
    values = {}
    for column, (name, law) in enumerate(study.laws.items()):
        values[name] = law.quantile(levels[:, column])
    return values


def mixing(study: Study) -> np.ndarray:
    """The matrix M, shape (laws, laws), that makes correlated scores M z of independent ones z: the copula's factor."""
    names = list(study.laws)
    matrix = np.eye(len(names))
    coupled = [names.index(name) for name in study.correlated]
    if coupled:
        matrix[np.ix_(coupled, coupled)] = np.linalg.cholesky(study.correlation)
    return matrix


def draw(study: Study, indices: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the uncertain numbers for the given draws.

    Returns:
        For each factor an array of shape (n,), float64.
    """
    return values_at(study, unit_points(study, indices))
