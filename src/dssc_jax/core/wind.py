"""The contract that models of wind implement."""

from collections.abc import Callable
from typing import NamedTuple

import jax

from dssc_jax.core.default_functions import unchanged_params
from dssc_jax.core.signals import LastChange, Params, Scalar, State
from dssc_jax.core.vectors import Vec3


class WindBounds(NamedTuple):
    """Bounds that a wind keeps at all times, for all random numbers.

    Args:
        speed: Bound of the horizontal wind speed [m/s].
        vertical: Bound of the vertical wind |w_z| [m/s].
        rate: Bound of the rate of change [m/s^2], which holds for the horizontal vector and for the vertical component
            separately; None: the wind may jump.
    """

    speed: Scalar
    vertical: Scalar
    rate: Scalar | None


class Wind(NamedTuple):
    """Wind velocity in the inertial frame, z up [m/s].

    Args:
        params: NamedTuple type of the parameters.
        init: ``(params, key) -> state``.
        step: ``(params, state, key, t, dt) -> state`` at each sample: what is held over [t, t + dt).
        value: ``(params, state, t) -> Vec3``, evaluated in every stage of the integrator.
        prepare: ``(params) -> params`` before tracing: checks that span several fields; raises ConfigError.
        bounds: ``(params) -> WindBounds`` of prepared parameters without laws; None: no bound is known.
        mean: ``(params, dt) -> Vec3``: the expected wind over the first sample, of length dt; None: the wind has no
            random numbers, so its value is its mean.
        last_change: Time from which the wind does nothing new; None: ``[loop.settled]`` refuses the wind.
    """

    params: type
    init: Callable[[Params, jax.Array], State]
    step: Callable[[Params, State, jax.Array, Scalar, Scalar], State]
    value: Callable[[Params, State, Scalar], Vec3]
    prepare: Callable[[Params], Params] = unchanged_params
    bounds: Callable[[Params], WindBounds] | None = None
    mean: Callable[[Params, Scalar], Vec3] | None = None
    last_change: LastChange | None = None

    def at_start(self, params: Params, dt: Scalar) -> Vec3:
        """Return the expected wind [m/s] over the first sample, of length dt [s].

        A wind without ``mean`` has no random numbers, so any key gives its value.
        """
        if self.mean is not None:
            return self.mean(params, dt)
        key = jax.random.key(0)
        return self.value(params, self.step(params, self.init(params, key), key, 0.0, dt), 0.0)
