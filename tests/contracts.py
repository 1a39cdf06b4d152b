"""What every sampled part of a loop must keep, whichever registry it stands in."""

import jax
import jax.numpy as jnp
import numpy as np

from tests.tolerances import ROUNDING


def assert_contract(two_steps, first):
    """Scalars, one structure of the state, ``vmap`` equal to a loop, and a trace without values that keeps float32.

    Args:
        two_steps: ``(y, y_dot) -> (state, outputs...)`` after two samples.
        first: A state before the first sample.

    Returns:
        What ``two_steps(1.0, -0.5)`` gives.
    """
    found = two_steps(jnp.asarray(1.0), jnp.asarray(-0.5))
    assert jax.tree.structure(first) == jax.tree.structure(found[0])
    for leaf in jax.tree.leaves(found):
        assert jnp.shape(leaf) == ()
        assert jnp.isfinite(leaf)

    ys, y_dot = jnp.array([-2.0, -0.4, 0.0, 1.1]), jnp.asarray(0.3)
    batched = jax.vmap(two_steps, in_axes=(0, None))(ys, y_dot)
    for i, y in enumerate(ys):
        for b, o in zip(jax.tree.leaves(batched), jax.tree.leaves(two_steps(y, y_dot)), strict=True):
            np.testing.assert_allclose(b[i] if jnp.ndim(b) else b, o, rtol=ROUNDING, atol=1e-13)

    with jax.enable_x64(False):
        for leaf in jax.tree.leaves(jax.eval_shape(two_steps, jnp.float32(1.0), jnp.float32(0.5))):
            assert leaf.dtype == jnp.float32
    return found
