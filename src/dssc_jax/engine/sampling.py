"""Sampling: draw i as a point of the unit cube, and its mapping to values of the laws.

A random draw depends on the seed and on i, never on the number of draws, the block or the device. Its coordinate for an
uncertain number also depends on the name of that number, but on no other number. The points of the other designs are
distributed over R independent replicates: draw i belongs to replicate i mod R. A Sobol design can be extended by draws,
but a further law changes all of its points. A Latin hypercube cannot be extended.
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

OUTERMOST_LEVEL = 2.0**-53  # least distance of a level from 0 and 1, so that quantiles of unbounded laws are finite
Arrays = dict[Any, np.ndarray]
"""Arrays by name; derivatives by :class:`dssc_jax.engine.evaluation.Derivative`."""

SOBOL_BITS = 30  # of a coordinate; scipy's fast_forward knows words of 32 bits only


def draw_key(seed: jax.Array | int, index: jax.Array | int) -> jax.Array:
    """The random key of a draw, from which all in-loop noise of the draw follows.

    Args:
        seed: The study's seed.
        index: Index of the draw.
    """
    return jax.random.fold_in(jax.random.key(seed), index)


@lru_cache(maxsize=1)
def level_program() -> CompiledLanes:
    """Compile, once, the program that draws the level of an uncertain number.

    The program maps (seed, draw index, stream of the number) to a uniform random number in [0, 1).
    """

    def level(seed: jax.Array, index: jax.Array, stream: jax.Array) -> jax.Array:
        """The level of one number in one draw, uniform in [0, 1), float64.

        Args:
            seed: Seed of the study.
            index: Index of the draw.
            stream: The number's stream of random words.
        """
        return jax.random.uniform(jax.random.fold_in(draw_key(seed, index), stream), dtype=jnp.float64)

    word = jax.ShapeDtypeStruct((), np.uint32)
    with jax.enable_x64(True), jax.threefry_partitionable(True):
        return compiled_lanes(level, word, word, word)


def uniform(seed: int, streams: tuple[int, ...], indices: np.ndarray) -> np.ndarray:
    """Independent random points of the half-open unit cube, shape (n, streams).

    Args:
        seed: The study's seed.
        streams: Random stream of each uncertain number.
        indices: Draw indices, shape (n,).
    """
    draws, draw_streams = np.meshgrid(indices, np.array(streams, np.uint32), indexing="ij")
    columns = np.full(draws.size, seed), draws.ravel(), draw_streams.ravel()
    one_thread = 1  # all others may still simulate the previous block
    return level_program().start(columns, draws.size, one_thread)().reshape(draws.shape)


def random_points(study: Study, streams: tuple[int, ...], indices: np.ndarray) -> np.ndarray:
    """Points of the unit cube for the design ``random``: independent draws, shape (n, streams).

    Args:
        study: The study, for its seed.
        streams: The random stream of each uncertain number.
        indices: Draw indices, shape (n,).
    """
    return uniform(study.config.seed, streams, indices)


def generator(*words: int) -> np.random.Generator:
    """A random generator of NumPy that the words select; generators of different words are independent."""
    return np.random.default_rng(np.random.SeedSequence(words))


def sobol_points(dimension: int, start: int, end: int, words: Sequence[int]) -> np.ndarray:
    """Points of a scrambled Sobol sequence, moved to the centres of their cells.

    Args:
        dimension: Number of coordinates.
        start: Index of the first point.
        end: Index behind the last point.
        words: Words that select the random scrambling.

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
    """Points of the unit cube for the design ``sobol``, shape (n, streams).

    Each of R replicates has its own scrambled Sobol sequence; draw i belongs to replicate i mod R.

    Args:
        study: The study, for its seed and replicates.
        streams: The random stream of each uncertain number; only their count is used.
        indices: Draw indices, shape (n,).
    """
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
    """All points of a study's Latin hypercubes, shape (draws, streams).

    Each uncertain number has designs of one dimension from its own random stream, so that adding another number changes
    none of its values.

    Args:
        seed: Seed of the study.
        streams: The random stream of each uncertain number.
        replicates: Number of independent hypercubes.
        draws: Number of draws, a multiple of ``replicates``.
    """
    from scipy.stats import qmc

    design = np.empty((draws // replicates, replicates, len(streams)))
    for column, word in enumerate(streams):
        for replicate in range(replicates):
            sequence = qmc.LatinHypercube(1, rng=generator(seed, word, replicate))
            design[:, replicate, column] = sequence.random(draws // replicates)[:, 0]
    return design.reshape(-1, len(streams))


def replicated_latin(study: Study, streams: tuple[int, ...], indices: np.ndarray) -> np.ndarray:
    """Points of the unit cube for the design ``lhs``, shape (n, streams): one Latin hypercube for each replicate.

    The points of all draws change if the study's number of draws changes.

    Args:
        study: The study.
        streams: The random stream of each uncertain number.
        indices: Draw indices, shape (n,).
    """
    config = study.config
    return latin_design(config.seed, streams, config.replicates, config.draws)[indices]


SAMPLING_DESIGNS: dict[str, Callable[[Study, tuple[int, ...], np.ndarray], np.ndarray]] = {
    "random": random_points,
    "auto": random_points,  # of analyses; a run chooses first, see runs/design_choice.py
    "sobol": replicated_sobol,
    "lhs": replicated_latin,
}


def unit_points(study: Study, indices: np.ndarray) -> np.ndarray:
    """Points of the open unit cube by the study's design of draws.

    Args:
        study: The study.
        indices: Draw indices, shape (n,).

    Returns:
        One column per law, shape (n, laws); float64 for every precision of the study.
    """
    names = list(study.laws)
    if not names:
        return np.empty((len(indices), 0))
    streams = tuple(stream(name) for name in names)
    if len(set(streams)) != len(streams):
        raise ValueError(f"two factors share a random stream; rename one of {names}")
    return inside_cube(SAMPLING_DESIGNS[study.config.sampling](study, streams, np.asarray(indices)))


def inside_cube(points: np.ndarray) -> np.ndarray:
    """Points moved to the inside of the unit cube, because a law's quantile may be infinite on a face of the cube."""
    return np.clip(points, OUTERMOST_LEVEL, 1.0 - OUTERMOST_LEVEL)


def values_at(study: Study, points: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the uncertain numbers at points of the unit cube.

    A Gaussian copula correlates the coordinates: it mixes their scores, which are standard normal quantiles.

    Args:
        study: The study.
        points: Independent uniform coordinates, one column per law, shape (n, laws).

    Returns:
        For each uncertain number an array of shape (n,), float64.
    """
    names = list(study.laws)
    points = np.asarray(points).copy()
    coupled = [names.index(name) for name in study.correlated]
    if coupled:
        scores = scipy.special.ndtri(points[:, coupled]) @ np.linalg.cholesky(study.correlation).T
        points[:, coupled] = inside_cube(scipy.special.ndtr(scores))
    return values_at_levels(study, points)


def values_at_levels(study: Study, levels: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the uncertain numbers at levels of their laws, by name, shape (n,) each.

    Args:
        study: The study.
        levels: Level of each number in its law, in (0, 1), shape (n, laws); correlations are contained already.
    """
    values = {}
    for column, (name, law) in enumerate(study.laws.items()):
        values[name] = law.quantile(levels[:, column])
    return values


def score_mixing_matrix(study: Study) -> np.ndarray:
    """The matrix M that correlates the laws' scores, shape (laws, laws).

    M is the Cholesky factor of the copula's correlation matrix. If z are independent standard normal scores, M z are
    scores of the Gaussian copula.
    """
    names = list(study.laws)
    matrix = np.eye(len(names))
    coupled = [names.index(name) for name in study.correlated]
    if coupled:
        matrix[np.ix_(coupled, coupled)] = np.linalg.cholesky(study.correlation)
    return matrix


def draw(study: Study, indices: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the uncertain numbers in n draws.

    Args:
        study: The study.
        indices: Draw indices, shape (n,).

    Returns:
        For each uncertain number an array of shape (n,), float64.
    """
    return values_at(study, unit_points(study, indices))
