"""The drift of DSSC's implicit form under measurement noise, and where it carries the loop.

In sliding the implicit form adds g(s_k) (s_k - s_(k-1)) + T_s phi_2(s_k) to u_av at each sample. Here s_k = sigma + n_k
is the measured sigma with the noise n_k, g = 1/(k_o tau_av) and phi_2 = g sigma/tau_m. If g depends on sigma, the mean
of the first term is not zero. The term then acts as an integral of the wrong sign, which grows with the sampling rate.
The loop rests where the two terms balance; see docs/model.md, Sampling.
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
"""Number of samples of noise in a mean; each sample also counts with the opposite sign."""
OFFSETS = np.geomspace(1e-4, 1e4, 161)
"""Values of sigma at which the balance is sought, in standard deviations of the noise of sigma."""


class Drift(NamedTuple):
    """The predicted effect of measurement noise on a channel.

    Args:
        noise: Standard deviation of the noise of the measured sigma [m/s; rad/s for an angle].
        rate: Largest mean rate at which noise drives the command away from sigma = 0 [m/s^2].
        error: The output error |e| at which the loop comes to rest [m; rad for an angle]; 0 if the loop returns to
            e = 0, infinite if the loop does not come to rest at any of the searched values.
    """

    noise: float
    rate: float
    error: float


def sigma_noise(
    sensor: Sensor, differentiator: Differentiator, params: tuple[Any, Any], l0: Scalar, dt: Scalar
) -> jax.Array:
    """Noise of the measured sigma = y' + l0 y at y = y' = 0, with its mean subtracted, shape (SAMPLES,).

    Args:
        sensor: Sensor of the channel.
        differentiator: Differentiator of the channel.
        params: Parameters of sensor and differentiator.
        l0: Error pole [1/s].
        dt: Sampling period [s].
    """
    leaves, tree = jax.tree.flatten(params)
    static_scalars = []  # static for jit, since some of them are counts of samples
    traced_arrays = []
    for leaf in leaves:
        is_array = np.ndim(leaf) > 0
        static_scalars.append(None if is_array else leaf)
        traced_arrays.append(leaf if is_array else None)
    return traced_noise((sensor, differentiator), tree, tuple(static_scalars), tuple(traced_arrays), l0, dt)


@partial(jax.jit, static_argnums=(0, 1, 2))
def traced_noise(
    models: tuple[Sensor, Differentiator],
    tree: Any,
    static_scalars: tuple,
    traced_arrays: tuple,
    l0: Scalar,
    dt: Scalar,
) -> jax.Array:
    """Compute :func:`sigma_noise` in compiled code, from static scalars and traced arrays among the parameters.

    Args:
        models: Sensor and differentiator.
        tree: Structure of their parameters.
        static_scalars: Scalar leaves of the parameters, with None in place of each array.
        traced_arrays: Array leaves of the parameters, with None in place of each scalar.
        l0: Error pole [1/s].
        dt: Sampling period [s].
    """
    sensor, differentiator = models
    leaves = [s if a is None else a for s, a in zip(static_scalars, traced_arrays, strict=True)]
    sensor_params, differentiator_params = tree.unflatten(leaves)
    at_rest = Measurement(0.0, 0.0)
    key = jax.random.key(stream("noise"))

    def sample(state: Any, k: Scalar) -> tuple[Any, Scalar]:
        """Next states of sensor and differentiator, and the measured sigma [m/s], at sample k."""
        sensor_state, differentiator_state = state
        noise_key = jax.random.fold_in(key, k)
        sensor_state, measurement = sensor.step(sensor_params, sensor_state, at_rest, noise_key, k * dt, dt)
        differentiator_state, measurement = differentiator.step(
            differentiator_params, differentiator_state, measurement, dt
        )
        return (sensor_state, differentiator_state), measurement.y_dot + l0 * measurement.y

    sensor_start = sensor.init(sensor_params, at_rest, key)
    start = sensor_start, differentiator.init(differentiator_params, at_rest)
    start = jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype=jnp.result_type(float)), start)
    _, sigma = jax.lax.scan(sample, start, jnp.arange(SAMPLES))
    return sigma - jnp.mean(sigma)


class MeanRates(NamedTuple):
    """Mean rates of the command u_av at several values of sigma.

    Args:
        by_noise: Mean rate that the noise causes, shape (m,) [m/s^2]; negative where the noise drives sigma outward.
        by_law: Mean rate that phi_2 causes, shape (m,) [m/s^2]; positive, since phi_2 drives sigma to 0.
    """

    by_noise: jax.Array
    by_law: jax.Array


@jax.jit
def mean_rates(functions: Any, l0: Scalar, noise: jax.Array, sigma: jax.Array, dt: Scalar) -> MeanRates:
    """Mean rates of the command u_av at several constant values of the true sigma, with e = sigma/l0.

    Args:
        functions: The state-dependent functions of DSSC.
        l0: Error pole [1/s].
        noise: Noise of sigma at successive samples [m/s], shape (n,).
        sigma: True values of sigma [m/s], shape (m,).
        dt: Sampling period [s].
    """

    def rates(sigma: Scalar, noise: Scalar, previous: Scalar) -> tuple[Scalar, Scalar]:
        """Two rates of u_av at one sample [m/s^2]: by the change of the noise, and by phi_2.

        Args:
            sigma: True value of sigma [m/s].
            noise: Noise of sigma at this sample [m/s].
            previous: Noise of sigma at the previous sample [m/s].
        """
        noisy_sigma = sigma + noise
        k_o, tau_av, tau_m = functions.at(noisy_sigma, sigma / l0, l0)
        gain = 1.0 / (k_o * tau_av)
        return gain * (noise - previous) / dt, gain * noisy_sigma / tau_m

    present = jnp.stack([noise[1:], -noise[1:]])  # both signs, since the noise is symmetric
    previous = jnp.stack([noise[:-1], -noise[:-1]])
    by_noise, by_law = jax.vmap(lambda value: rates(value, present, previous))(sigma)
    return MeanRates(by_noise=jnp.mean(by_noise, axis=(1, 2)), by_law=jnp.mean(by_law, axis=(1, 2)))


def noise_drift(study: Study) -> dict[str, Drift]:
    """Predict where measurement noise carries the implicit form of DSSC, channel by channel.

    The prediction neglects disturbances and unmodelled dynamics. It assumes an exact sign and a rho that keeps sliding.
    Uncertain numbers have their median values. A sweep is ignored.

    Args:
        study: The study.

    Returns:
        The drift of each channel with noise and the implicit form of DSSC, by the channel's name; the name is empty for
        a plant with one channel.
    """
    loop = study.loop
    template = jax.tree.map(lambda leaf: leaf if np.ndim(leaf) else nominal(leaf), study.template)  # records: arrays
    drifts = {}
    for i, name in enumerate(loop.channels):
        has_no_noise = not template.sensor[i] and not template.differentiator[i]  # parts without parameters
        if has_no_noise or loop.controller[i] != DSSC.members[Discretisation.IMPLICIT]:
            continue
        gains = template.controller[i]
        with jax.enable_x64(True):
            params = template.sensor[i], template.differentiator[i]
            noise = sigma_noise(loop.sensor[i], loop.differentiator[i], params, gains.l0, loop.sample_time)
            noise_std = float(jnp.std(noise))
            if noise_std > 0.0:
                sigma = noise_std * OFFSETS
                rates = mean_rates(gains.functions, gains.l0, noise, sigma, loop.sample_time)
                drifts[name] = balanced_drift(noise_std, sigma, rates, gains.l0)
    return drifts


def noise_warning(study: Study) -> str | None:
    """A warning in one sentence if :func:`noise_drift` predicts an error beyond the settling band of ``[metrics]``.

    The result is None if no channel has such an error.
    """
    band = study.config.metrics.window.band
    unit_of_channel = {name: units.output for name, units in zip(study.loop.channels, study.units, strict=True)}
    errors = []
    for name, drift in noise_drift(study).items():
        if drift.error > band:
            place = f" in {name}" if name else ""
            errors.append(f"{drift.error:.2g} {unit_of_channel[name]}{place}")
    if not errors:
        return None
    return (
        f"measurement noise is predicted to move DSSC's implicit form off its reference by {', '.join(errors)}; "
        "discretisation = 'conservative' in [controller] avoids this"
    )


def balanced_drift(noise_std: float, sigma: np.ndarray, rates: MeanRates, l0: float) -> Drift:
    """The drift that follows from mean rates over a grid of sigma.

    The loop rests at the largest sigma at which the two rates balance, interpolated between values of the grid.

    Args:
        noise_std: Standard deviation of the noise of sigma [m/s].
        sigma: Rising grid of sigma, shape (n,) [m/s].
        rates: Mean rates of the command at these values.
        l0: Error pole [1/s].
    """
    by_noise = np.asarray(rates.by_noise)
    total = by_noise + np.asarray(rates.by_law)
    outward = np.flatnonzero(total < 0.0)
    largest_outward_rate = -float(by_noise.min())
    if not outward.size:
        return Drift(noise_std, max(0.0, largest_outward_rate), error=0.0)
    i = int(outward[-1])
    if i + 1 == sigma.size:
        return Drift(noise_std, largest_outward_rate, error=np.inf)
    share = total[i] / (total[i] - total[i + 1])  # of the logarithmic step from sigma[i], up to the balance
    balanced_sigma = sigma[i] * (sigma[i + 1] / sigma[i]) ** share
    return Drift(noise_std, largest_outward_rate, error=float(balanced_sigma / l0))
