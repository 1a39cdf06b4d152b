"""Draw i of a study: it depends on (seed, i) only, never on the number of draws, the chunk or the device."""

from collections.abc import Mapping, Sequence
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.numerics import stream
from dssc_jax.study.laws import Law

EDGE = 2.0**-53  # keeps quantiles of unbounded laws finite


def draw_key(seed: int, index: jax.Array | int) -> jax.Array:
    """The random key of draw ``index``."""
    return jax.random.fold_in(jax.random.key(seed), index)


@partial(jax.jit, static_argnums=(0, 1))
def _uniform(seed: int, streams: tuple[int, ...], indices: jax.Array) -> jax.Array:
    def point(index: jax.Array) -> jax.Array:
        key = draw_key(seed, index)
        return jnp.stack([jax.random.uniform(jax.random.fold_in(key, s), dtype=jnp.float64) for s in streams])

    return jax.vmap(point)(indices)


def unit_points(seed: int, names: Sequence[str], indices: np.ndarray) -> np.ndarray:
    """Independent points of the open unit cube.

    Args:
        seed: The study's seed.
        names: Names of the factors.
        indices: Draw indices, shape (n,).

    Returns:
        Shape (n, len(names)), float64 whatever the study's precision.
    """
    if not names:
        return np.empty((len(indices), 0))
    streams = tuple(stream(name) for name in names)
    if len(set(streams)) != len(streams):
        raise ValueError(f"two factors share a random stream; rename one of {list(names)}")
    with jax.enable_x64(True):
        points = np.asarray(_uniform(seed, streams, jnp.asarray(indices, dtype=jnp.uint32)))
    return np.clip(points, EDGE, 1.0 - EDGE)


def draw(seed: int, laws: Mapping[str, Law], indices: np.ndarray) -> dict[str, np.ndarray]:
    """Values of the uncertain numbers for the given draws.

    Args:
        seed: The study's seed.
        laws: Law of each factor.
        indices: Draw indices, shape (n,).

    Returns:
        For each factor an array of shape (n,), float64.
    """
    points = unit_points(seed, list(laws), indices)
    return {name: law.quantile(points[:, column]) for column, (name, law) in enumerate(laws.items())}
