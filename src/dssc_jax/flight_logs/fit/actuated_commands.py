"""Commands behind an actuator, by its model: what the plant gets on average over each sample."""

from collections.abc import Callable
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.contracts import Unmodelled
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.sampled_linear import Forcing, LinearSystem, hold, series
from dssc_jax.core.signals import Params, Scalar, State
from dssc_jax.engine.plain import plain_options

INTEGRATOR = LinearSystem(a=((0.0,),), b=(1.0,), c=(1.0,), d=0.0)


def actuated_commands(model: Unmodelled, params: Params, commands: np.ndarray, sample_time: float) -> np.ndarray:
    """The means over each sample of an actuator's output, which begins at rest, for commands that are held.

    Args:
        model: The actuator: without a state, linear, or with the moments of its output.
        params: Its parameters.
        commands: The commands, shape (n,).
        sample_time: Time between two samples [s].

    Returns:
        The means, shape (n,).
    """
    with arithmetic():
        return np.asarray(compiled_means()(model, params, jnp.asarray(commands, float), sample_time), float)


@cache
def compiled_means() -> Callable[..., jax.Array]:
    """:func:`means`, compiled once for each actuator and number of samples."""
    return jax.jit(means, static_argnums=0, compiler_options=plain_options())


def means(model: Unmodelled, params: Params, commands: jax.Array, sample_time: Scalar) -> jax.Array:
    """As :func:`actuated_commands`, in JAX."""
    advance = partial(linear_sample if model.linear else sample, model, params, sample_time)
    return jax.lax.scan(advance, as_arrays(model.init(params)), commands)[1]


def sample(
    model: Unmodelled, params: Params, sample_time: Scalar, state: State, command: Scalar
) -> tuple[State, jax.Array]:
    """The actuator's state after a sample, and the mean of its output over it."""
    if model.moments is None:  # an output that is constant within the sample
        mean = model.output(params, state, command)
    else:
        mean = model.moments(params, state, command, sample_time).mean
    return as_arrays(model.step(params, state, command, sample_time)), jnp.asarray(mean)


def linear_sample(
    model: Unmodelled, params: Params, sample_time: Scalar, state: State, command: Scalar
) -> tuple[State, jax.Array]:
    """As :func:`sample` of a linear actuator: the exact integral of its output over the sample tells the mean."""
    assert model.linear is not None
    system = series(model.linear(params), INTEGRATOR)
    leaves, structure = jax.tree.flatten(state)
    held = hold(system.a, (Forcing(system.b, terms=1),), sample_time)
    *next_leaves, integral = held.full.apply((*leaves, 0.0), ((command,),))
    return as_arrays(structure.unflatten(next_leaves)), jnp.asarray(integral / sample_time)
