"""Functions that models use where a contract needs one and they have nothing to do."""

import jax

from dssc_jax.core.signals import Params, PlantInput, Scalar, State


def unchanged_params(params: Params) -> Params:
    """Return the parameters unchanged."""
    return params


def no_constraint(params: Params, state: State) -> State:
    """Return the state unchanged: every state is admissible."""
    return state


def no_info(params: Params, state: State, drive: PlantInput) -> tuple[()]:
    """Report nothing."""
    return ()


def never_broken(params: Params, state: State) -> bool:
    """Report that the model is valid in every state."""
    return False


def never_grounded(params: Params, state: State, drive: PlantInput, t: Scalar, dt: Scalar) -> bool:
    """Report that there is no ground."""
    return False


def stateless(params: Params, key: jax.Array) -> tuple[()]:
    """Initialise a model without a state."""
    return ()


def unchanged(params: Params, state: State, key: jax.Array, t: Scalar, dt: Scalar) -> State:
    """Return the state unchanged."""
    return state


def ignore_sample(params: Params, state: State, command: Scalar, key: jax.Array, dt: Scalar) -> State:
    """Return the state unchanged, as continuous dynamics do at a sample instant."""
    return state


def no_signals(gains: Params) -> int:
    """The number of measured signals of a controller that takes y and y' alone: 0."""
    return 0


def always(params: Params) -> bool:
    """True for all parameters."""
    return True


def never(params: Params) -> bool:
    """False for all parameters."""
    return False


def unchanging(params: Params) -> float:
    """The last change of a signal that does the same at all times, but for the times declared as ``begins`` [s]."""
    return 0.0


def rise_end(params: Params) -> Scalar:
    """The last change of what begins at the time ``at`` and rises for ``rise`` [s]; 0 if it has no end of a rise."""
    return 0.0 if params.rise is None else params.at + params.rise
