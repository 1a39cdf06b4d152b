"""The mean of an actuator's output over each sample, computed with the actuator's model."""

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

# In series behind an actuator, its state is the integral of the actuator's output.
INTEGRATOR = LinearSystem(a=((0.0,),), b=(1.0,), c=(1.0,), d=0.0)


def actuated_commands(model: Unmodelled, params: Params, commands: np.ndarray, sample_time: float) -> np.ndarray:
    """Compute the mean of an actuator's output over each sample. It begins at rest, and each command is held.

    Args:
        model: The actuator: it has no state, is linear, or declares the moments of its output.
        params: Parameters of the actuator.
        commands: The commands, each held over one sample [u], shape (n,).
        sample_time: Time between two samples [s].

    Returns:
        The means [u], shape (n,).
    """
    with arithmetic():
        return np.asarray(compiled_means()(model, params, jnp.asarray(commands, float), sample_time), float)


@cache
def compiled_means() -> Callable[..., jax.Array]:
    """:func:`means`, compiled once for each actuator and number of samples."""
    return jax.jit(means, static_argnums=0, compiler_options=plain_options())


def means(model: Unmodelled, params: Params, commands: jax.Array, sample_time: Scalar) -> jax.Array:
    """Compute what :func:`actuated_commands` returns, from the same arguments, in JAX."""
    advance = partial(linear_sample if model.linear else sample, model, params, sample_time)
    return jax.lax.scan(advance, as_arrays(model.init(params)), commands)[1]


def sample(
    model: Unmodelled, params: Params, sample_time: Scalar, state: State, command: Scalar
) -> tuple[State, jax.Array]:
    """Advance an actuator by one sample; return its next state, and the mean of its output over the sample.

    Args:
        model: The actuator.
        params: Parameters of the actuator.
        sample_time: Time between two samples [s].
        state: State of the actuator at the beginning of the sample.
        command: The command, held over the sample [u].
    """
    if model.moments is None:  # an output that is constant within the sample
        mean = model.output(params, state, command)
    else:
        mean = model.moments(params, state, command, sample_time).mean
    return as_arrays(model.step(params, state, command, sample_time)), jnp.asarray(mean)


def linear_sample(
    model: Unmodelled, params: Params, sample_time: Scalar, state: State, command: Scalar
) -> tuple[State, jax.Array]:
    """Do the same as :func:`sample` for a linear actuator.

    The mean is the exact integral of the output over the sample, divided by the sample time.
    """
    assert model.linear is not None
    system = series(model.linear(params), INTEGRATOR)
    leaves, structure = jax.tree.flatten(state)
    held = hold(system.a, (Forcing(system.b, terms=1),), sample_time)
    *next_leaves, integral = held.full.apply((*leaves, 0.0), ((command,),))
    return as_arrays(structure.unflatten(next_leaves)), jnp.asarray(integral / sample_time)
