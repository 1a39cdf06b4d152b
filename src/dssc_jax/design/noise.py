"""The drift of DSSC's implicit form under measurement noise, and where it carries the loop.

In sliding the implicit form adds g(s_k) (s_k - s_(k-1)) + T_s phi_2(s_k) to u_av at each sample. s_k = sigma + n_k is
the measured sigma, g = 1/(k_o tau_av) and phi_2 = g sigma/tau_m. If g depends on sigma, the mean of the first term is
not zero: it is an integral action of the wrong sign, which grows with the sampling rate. The loop rests where it
balances the second term; see docs/model.md, Sampling.
"""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.contracts import Differentiator, Sensor
from dssc_jax.core.numerics import stream
from dssc_jax.core.quantities import nominal
from dssc_jax.core.registry import Discretisation
from dssc_jax.core.signals import Measurement, Scalar
from dssc_jax.models.controllers.dssc import DSSC
from dssc_jax.study import Study

SAMPLES = 10_000
"""Samples of noise in a mean; each also counts with the opposite sign."""
OFFSETS = np.geomspace(1e-4, 1e4, 161)
"""Values of sigma that are searched for the largest rest, in standard deviations of its noise."""


class Drift(NamedTuple):
    """The predicted effect of measurement noise on a channel.

    Args:
        noise: Standard deviation of the noise of the measured sigma [m/s; rad/s for an angle].
        rate: Largest mean rate at which noise drives the command away from zero sigma [m/s^2].
        error: The output error |e| at which the loop comes to rest; 0 where it returns to zero.
    """

    noise: float
    rate: float
    error: float


def sigma_noise(
    sensor: Sensor, differentiator: Differentiator, params: tuple[Any, Any], l0: Scalar, dt: Scalar
) -> jax.Array:
    """Noise of sigma = y' + l0 y behind sensor and differentiator at y = y' = 0, less its mean; shape (SAMPLES,)."""
    leaves, tree = jax.tree.flatten(params)
    # jit takes every scalar as static, since some are counts of samples; arrays are traced
    static_scalars = tuple(None if np.ndim(leaf) else leaf for leaf in leaves)
    traced_arrays = tuple(leaf if np.ndim(leaf) else None for leaf in leaves)
    return traced_noise((sensor, differentiator), tree, static_scalars, traced_arrays, l0, dt)


@partial(jax.jit, static_argnums=(0, 1, 2))
def traced_noise(
    models: tuple[Sensor, Differentiator],
    tree: Any,
    static_scalars: tuple,
    traced_arrays: tuple,
    l0: Scalar,
    dt: Scalar,
) -> jax.Array:
    """:func:`sigma_noise`, compiled, with the leaves of the parameters divided into static scalars and traced arrays.

    Args:
        models: Sensor and differentiator.
        tree: Structure of their parameters.
        static_scalars: The leaves that are scalars, None in place of the others.
        traced_arrays: The leaves that are arrays, None in place of the others.
        l0: Error pole [1/s].
        dt: Sampling period [s].
    """
    sensor, differentiator = models
    params = tree.unflatten(s if a is None else a for s, a in zip(static_scalars, traced_arrays, strict=True))
    at_rest = Measurement(0.0, 0.0)
    key = jax.random.key(stream("noise"))

    def sample(state: Any, k: Scalar) -> tuple[Any, Scalar]:
        sensor_state, measurement = sensor.step(params[0], state[0], at_rest, jax.random.fold_in(key, k), k * dt, dt)
        differentiator_state, measurement = differentiator.step(params[1], state[1], measurement, dt)
        return (sensor_state, differentiator_state), measurement.y_dot + l0 * measurement.y

    sensor_start = sensor.init(params[0], at_rest, key)
    start = sensor_start, differentiator.init(params[1], at_rest)
    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=jnp.result_type(float)), start)
    sigma = jax.lax.scan(sample, start, jnp.arange(SAMPLES))[1]
    return sigma - jnp.mean(sigma)


@jax.jit
def mean_rates(functions: Any, l0: Scalar, noise: jax.Array, sigma: jax.Array, dt: Scalar) -> tuple[Scalar, Scalar]:
    """Mean rates of u_av [m/s^2] at a constant true sigma and e = sigma/l0: by the noise, and by phi_2.

    Args:
        functions: The state-dependent functions.
        l0: Error pole [1/s].
        noise: Successive noise of sigma [m/s], shape (n,).
        sigma: True values of sigma [m/s], shape (m,).
        dt: Sampling period [s].

    Returns:
        Two arrays of shape (m,).
    """

    def rates(sigma: Scalar, noise: Scalar, previous: Scalar) -> tuple[Scalar, Scalar]:
        noisy_sigma = sigma + noise
        k_o, tau_av, tau_m = functions.at(noisy_sigma, sigma / l0, l0)
        gain = 1.0 / (k_o * tau_av)
        return gain * (noise - previous) / dt, gain * noisy_sigma / tau_m

    present = jnp.stack([noise[1:], -noise[1:]])
    previous = jnp.stack([noise[:-1], -noise[:-1]])
    by_noise, by_law = jax.vmap(lambda value: rates(value, present, previous))(sigma)
    return jnp.mean(by_noise, axis=(1, 2)), jnp.mean(by_law, axis=(1, 2))


def noise_drift(study: Study) -> dict[str, Drift]:
    """Predict where measurement noise carries the implicit form of DSSC, channel by channel.

    Disturbances and unmodelled dynamics are neglected, the sign is not smoothed, and rho is large enough for sliding.
    Uncertain numbers have their median values. A sweep is ignored.

    Args:
        study: The study.

    Returns:
        Each noisy channel in the implicit form of DSSC, by name; the single channel of a SISO plant is ``""``.
    """
    loop = study.loop
    template = jax.tree.map(lambda leaf: leaf if np.ndim(leaf) else nominal(leaf), study.template)  # records: arrays
    drifts = {}
    for i, name in enumerate(loop.channels):
        is_exact = not template.sensor[i] and not template.differentiator[i]
        if is_exact or loop.controller[i] != DSSC.members[Discretisation.IMPLICIT]:
            continue
        gains = template.controller[i]
        with jax.enable_x64(True):
            params = template.sensor[i], template.differentiator[i]
            noise = sigma_noise(loop.sensor[i], loop.differentiator[i], params, gains.l0, loop.sample_time)
            noise_std = float(jnp.std(noise))
            if noise_std > 0.0:
                sigma = noise_std * OFFSETS
                by_noise, by_law = mean_rates(gains.functions, gains.l0, noise, sigma, loop.sample_time)
                drifts[name] = rest_drift(noise_std, sigma, np.asarray(by_noise), np.asarray(by_law), gains.l0)
    return drifts


def noise_warning(study: Study) -> str | None:
    """A sentence if :func:`noise_drift` predicts an error beyond the study's settling band in a channel; else None."""
    band = study.config.metrics.window.band
    large_drifts = {name: drift for name, drift in noise_drift(study).items() if drift.error > band}
    if not large_drifts:
        return None
    unit = {name: units.output for name, units in zip(study.loop.channels, study.units, strict=True)}
    errors = [f"{drift.error:.2g} {unit[name]}{f' in {name}' if name else ''}" for name, drift in large_drifts.items()]
    return (
        f"measurement noise is predicted to move DSSC's implicit form off its reference by {', '.join(errors)}; "
        "discretisation = 'conservative' in [controller] avoids this"
    )


def rest_drift(noise_std: float, sigma: np.ndarray, by_noise: np.ndarray, by_law: np.ndarray, l0: float) -> Drift:
    """The drift from rates over a grid of sigma: the loop rests at the largest sigma at which they balance.

    Args:
        noise_std: Standard deviation of the noise of sigma [m/s].
        sigma: Grid of sigma, shape (n,) [m/s].
        by_noise: Mean rate of the command by the noise, shape (n,) [m/s^2].
        by_law: Mean rate of the command by phi_2, shape (n,) [m/s^2].
        l0: Error pole [1/s].
    """
    total = by_noise + by_law
    outward = np.flatnonzero(total < 0.0)
    if not outward.size:
        return Drift(noise_std, max(0.0, -float(by_noise.min())), 0.0)
    i = int(outward[-1])
    if i + 1 == sigma.size:
        return Drift(noise_std, -float(by_noise.min()), np.inf)
    share = total[i] / (total[i] - total[i + 1])
    rest_sigma = sigma[i] * (sigma[i + 1] / sigma[i]) ** share
    return Drift(noise_std, -float(by_noise.min()), float(rest_sigma / l0))
