"""The gain from measurement noise to the command over frequency, from a trajectory."""

import numpy as np
import xarray as xr
from scipy import signal

from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.quantities import unit_and_meaning
from dssc_jax.core.units import ChannelUnits

SEGMENT = 1024
"""Samples of a segment of Welch's method."""
FEWEST_SEGMENTS = 4


def noise_spectrum(run: xr.Dataset, channel: str = "", after: float = 0.0) -> xr.Dataset:
    """Estimate the gain from the error n of the measured sigma to the robust command u over frequency.

    The gain is |S_nu|/S_nn, from the cross spectrum S_nu and the noise's spectrum S_nn by Welch's method (Hann window,
    half overlap, mean removed). Motion that is uncorrelated with the noise, such as the answer to a disturbance,
    averages out. In a linear loop the gain is the magnitude of the transfer function. Where the coherence is far below
    1, u depends on the noise nonlinearly, or mostly on other signals.

    Args:
        run: A trajectory with every sample, from :func:`dssc_jax.simulate` or :func:`dssc_jax.replay`.
        channel: The channel of a vehicle; empty for a plant with one channel.
        after: Samples before this time [s] are left out.

    Returns:
        Along ``frequency`` [Hz]: ``noise`` and ``command``, power spectral densities in the squares of the units of
        sigma and u per Hz; ``gain``, in the unit of u over that of sigma; ``coherence`` [1]. The attribute
        ``amplification`` is the rms of the part of u that the noise explains over the rms of the noise, in the unit
        of the gain.

    Raises:
        ConfigError: There is no such channel, the measurement is exact, or fewer than 4,096 samples remain.
    """
    noise, command = noise_and_command(run, channel, after)
    units = ChannelUnits(output=noise.attrs["units"], command=command.attrs["units"])
    rate = 1.0 / float(run["t"][1] - run["t"][0])
    frequency, noise_density = signal.welch(noise, rate, nperseg=SEGMENT)
    _, command_density = signal.welch(command, rate, nperseg=SEGMENT)
    _, cross_density = signal.csd(noise, command, rate, nperseg=SEGMENT)
    frequency = frequency[1:]  # without the mean, at the frequency 0
    noise_density = noise_density[1:]
    command_density = command_density[1:]
    cross = np.abs(cross_density[1:])
    gain = cross / noise_density
    amplification = np.sqrt(np.sum(gain**2 * noise_density) / np.sum(noise_density))
    columns = {
        "noise": (noise_density, units.of("y^2/Hz"), "spectral density of the error of the measured sigma"),
        "command": (command_density, units.of("u^2/Hz"), "spectral density of the robust command u"),
        "gain": (gain, units.of("u/y"), "gain from the error of the measured sigma to u"),
        "coherence": (cross**2 / (noise_density * command_density), "1", "share of u that the noise explains"),
    }
    variables = {}
    for name, (values, unit, meaning) in columns.items():
        variables[name] = (("frequency",), values, unit_and_meaning(unit, meaning))
    return xr.Dataset(
        variables,
        coords={"frequency": (("frequency",), frequency, unit_and_meaning("Hz", "frequency"))},
        attrs={"amplification": float(amplification)},
    )


def noise_and_command(run: xr.Dataset, channel: str, after: float) -> tuple[xr.DataArray, xr.DataArray]:
    """Read two signals from a trajectory: the error of the measured sigma, and the robust command.

    Both have the shape (samples,), and their units as attributes.

    Args:
        run: A trajectory with every sample.
        channel: The channel of a vehicle; empty for a plant with one channel.
        after: Samples before this time [s] are left out.

    Raises:
        ConfigError: There is no such channel, the measurement is exact, or there are too few finite samples.
    """
    prefix = f"{channel}_" if channel else ""
    if f"{prefix}sigma_measured" not in run:
        channel_names = [str(name).removesuffix("_sigma") for name in run.data_vars if str(name).endswith("_sigma")]
        raise ConfigError("channel", f"'{channel}' is no channel of this trajectory; {nearest(channel, channel_names)}")
    late_samples = run.where(run["t"] >= after, drop=True)
    measured = late_samples[f"{prefix}sigma_measured"]
    noise = measured.copy(data=measured - late_samples[f"{prefix}sigma"])
    command = late_samples[f"{prefix}u"]
    if noise.size < FEWEST_SEGMENTS * SEGMENT or not np.all(np.isfinite(command)):
        rule = f"needs {FEWEST_SEGMENTS * SEGMENT:,} finite samples after {after:g} s"
        raise ConfigError("run", f"{rule}, got {np.count_nonzero(np.isfinite(command)):,}")
    if not np.any(noise):
        raise ConfigError("run", "the measurement is exact; give the study a noisy sensor")
    return noise, command
