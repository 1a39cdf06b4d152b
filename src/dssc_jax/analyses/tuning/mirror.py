"""Map tuned numbers, positive and inside their intervals, to coordinates without bounds."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.special import expit, logit

Numbers = dict[str, Any]


def as_they_are(tuned: Mapping[str, Any]) -> Numbers:
    """Use the tuned numbers themselves as the loop's numbers."""
    return dict(tuned)


@dataclass(frozen=True, eq=False)
class Mirror:
    """The map value = low (high/low)^s(z) with s(z) = 1/(1 + e^-z), for each tuned number.

    Args:
        extents: Lowest and highest value of each, 0 < low < high.
        start: The start of the search, inside the intervals.
        expand: Computes the loop's numbers, by dotted name, from the tuned ones.
    """

    extents: dict[str, tuple[float, float]]
    start: dict[str, float]
    expand: Callable[[Mapping[str, Any]], Numbers] = as_they_are

    @property
    def names(self) -> list[str]:
        """The tuned numbers, in the order of the coordinates."""
        return list(self.extents)

    @property
    def ends(self) -> tuple[np.ndarray, np.ndarray]:
        """Logarithms of the intervals' ends."""
        low, high = np.log(np.array(list(self.extents.values()))).T
        return low, high

    @property
    def origin(self) -> np.ndarray:
        """Coordinates of the start, shape (n,)."""
        low, high = self.ends
        return logit((np.log([self.start[name] for name in self.names]) - low) / (high - low))

    def tuned(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """The tuned numbers at coordinates of shape (..., n), each of shape (...)."""
        low, high = self.ends
        values = np.exp(low + (high - low) * expit(z))
        return {name: values[..., i] for i, name in enumerate(self.names)}

    def numbers(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """The loop's numbers at points of shape (m, n), each of shape (m,)."""
        with jax.enable_x64(True):
            return {name: np.asarray(value) for name, value in _numbers(self.traced, jnp.asarray(z)).items()}

    def slopes(self, z: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of the loop's numbers with respect to the coordinates at points (m, n), each (m, n)."""
        with jax.enable_x64(True):
            return {name: np.asarray(value) for name, value in _slopes(self.traced, jnp.asarray(z)).items()}

    def traced(self, z: jax.Array) -> Numbers:
        """The loop's numbers at one traced point of shape (n,)."""
        low, high = self.ends
        values = jnp.exp(low + (high - low) * jax.nn.sigmoid(z))
        numbers = self.expand({name: values[i] for i, name in enumerate(self.names)})
        return {name: jnp.asarray(value) for name, value in numbers.items()}


@partial(jax.jit, static_argnums=0)
def _numbers(of: Callable[[jax.Array], Numbers], z: jax.Array) -> Numbers:
    return jax.vmap(of)(z)


@partial(jax.jit, static_argnums=0)
def _slopes(of: Callable[[jax.Array], Numbers], z: jax.Array) -> Numbers:
    return jax.vmap(jax.jacfwd(of))(z)
