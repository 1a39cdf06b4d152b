"""A check whether a user-defined plant changes with time, so that it has no equilibrium."""

import jax
from jax.interpreters.partial_eval import dce_jaxpr

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import Scalar, State
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in
from dssc_jax.study.laws import nominal_params


def require_timeless(study: Study) -> None:
    """Require that the derivatives of a user-defined plant do not depend on the time, by its traced program.

    The derivatives of this package's plants never depend on the time. A plant with a state outside of JAX, or in a
    wind, is not examined.

    Raises:
        ConfigError: A derivative depends on the time.
    """
    kind = str(study.config.plant.get("kind", ""))
    plant = study.loop.mimo_plant
    is_user_defined = ":" in kind  # module:object
    has_wind = kind_in(study.config, "wind") != "none"
    if not is_user_defined or plant.begin is not None or has_wind:
        return
    params = nominal_params(study.template).plant
    drive = study.loop.zero_input(params)

    def slopes(t: Scalar) -> list[State]:
        """The derivatives of the plant's initial state at a time [s]."""
        state = plant.init(params)
        derivatives = [plant.derivative(params, state, drive, t)]
        if plant.remainder is not None:
            derivatives.append(plant.remainder(params, state, drive, t))
        return derivatives

    with arithmetic():
        program = jax.make_jaxpr(slopes)(0.0).jaxpr
    _, (depends_on_time,) = dce_jaxpr(program, [True] * len(program.outvars))
    if depends_on_time:
        raise ConfigError(
            f"{study.source}: plant.kind",
            f"'{kind}' changes with the time t, so that the loop has no equilibrium; linearise along the flight, "
            "whose margins hold at the times that are stated",
        )
