"""Functions for models that have nothing to do where a contract requires a function.

Their arguments are those of the contract, and have no effect.
"""

import jax

from dssc_jax.core.signals import Params, PlantInput, Scalar, State


def unchanged_params(params: Params) -> Params:
    """Return the parameters unchanged."""
    return params


def no_constraint(params: Params, state: State) -> State:
    """Return the state unchanged: every state is admissible."""
    return state


def no_info(params: Params, state: State, drive: PlantInput) -> tuple[()]:
    """Return an empty info: the plant reports nothing."""
    return ()


def never_broken(params: Params, state: State) -> bool:
    """Return False: the model is valid in every state."""
    return False


def never_grounded(params: Params, state: State, drive: PlantInput, t: Scalar, dt: Scalar) -> bool:
    """Return False: the model has no ground."""
    return False


def stateless(params: Params, key: jax.Array) -> tuple[()]:
    """Return the state of a model that has none: an empty tuple."""
    return ()


def unchanged(params: Params, state: State, key: jax.Array, t: Scalar, dt: Scalar) -> State:
    """Return the state unchanged: nothing changes from sample to sample."""
    return state


def ignore_sample(params: Params, state: State, command: Scalar, key: jax.Array, dt: Scalar) -> State:
    """Return the state unchanged, as continuous dynamics do at a sample instant."""
    return state


def no_signals(gains: Params) -> int:
    """Return 0, the number of further measured signals of a controller that takes y and y' alone."""
    return 0


def always(params: Params) -> bool:
    """Return True for all parameters."""
    return True


def never(params: Params) -> bool:
    """Return False for all parameters."""
    return False


def unchanging(params: Params) -> float:
    """Return 0, the last change [s] of a signal that does the same at all times.

    Changes at the times that parameters declare by ``begins`` do not count; see
    :data:`~dssc_jax.core.signals.LastChange`.
    """
    return 0.0


def rise_end(params: Params) -> Scalar:
    """Return the last change [s] of an effect that begins at the time ``at`` and rises for the time ``rise``.

    The result is the end of the rise. It is 0 if ``rise`` is None: then the only change is the beginning, which the
    parameter ``at`` declares by ``begins``.
    """
    return 0.0 if params.rise is None else params.at + params.rise
