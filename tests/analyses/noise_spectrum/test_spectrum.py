"""The gain from noise to command against a linear loop's transfer function, and the metrics of noise."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError

DT, L0, K_P, GAIN, TAU_M = 0.01, 0.5, 1.2, 0.8, 2.0
LINEAR = {
    "name": "linear",
    "loop": {"duration": 400.0, "sample_time": DT},
    "plant": {"kind": "normal_form", "k_p": K_P, "a_p": 0.0, "initial": [0.0, 0.0]},
    "controller": {
        "kind": "dssc",
        "l0": L0,
        "rho": 1e6,
        "functions": {"kind": "constant", "k_o": 1.0 / (0.05 * GAIN), "tau_av": 0.05, "tau_m": TAU_M},
    },
    "sensor": {"kind": "noisy", "velocity_std": 0.1},
    "metrics": {"after": 20.0, "names": ["noise_amplification", "noise_drift"]},
}


def transfer_function(frequency):
    """|u/n| of the double integrator under u_k = u_(k-1) - GAIN ((1 + T/tau_m) s_k - s_(k-1)), s = x2 + l0 x1 + n."""
    z = np.exp(2j * np.pi * frequency * DT)
    controller = -GAIN * ((1.0 + DT / TAU_M) - 1.0 / z) / (1.0 - 1.0 / z)
    velocity = K_P * DT / (z - 1.0)
    position = K_P * DT**2 * (z + 1.0) / (2.0 * (z - 1.0) ** 2)
    return np.abs(controller / (1.0 - controller * (velocity + L0 * position)))


@pytest.fixture(scope="module")
def run():
    return dj.simulate(dj.Study.from_table(LINEAR))


def test_gain_of_a_linear_loop(run):
    spectrum = dj.noise_spectrum(run, after=20.0)
    frequency = spectrum["frequency"].values
    seen = (frequency > 0.5) & (frequency < 45.0)
    np.testing.assert_allclose(spectrum["gain"][seen], transfer_function(frequency[seen]), rtol=0.05)
    assert np.all(spectrum["coherence"][seen] > 0.99)
    white = np.sqrt(np.mean(transfer_function(np.arange(1, 50_000) / 1000.0) ** 2))
    assert spectrum.attrs["amplification"] == pytest.approx(white, rel=0.05)


def test_units_are_those_of_the_channel():
    """A speed of a motor in rad/s, driven by a voltage: sigma is in rad/s^2."""
    units = {"output": "rad/s", "command": "V"}
    short = {**LINEAR, "loop": {"duration": 60.0, "sample_time": DT}, "units": units}
    spectrum = dj.noise_spectrum(dj.simulate(dj.Study.from_table(short)))
    noise_units = {name: spectrum[name].attrs["units"] for name in ("noise", "command", "gain", "coherence")}
    assert noise_units == {"noise": "rad^2/(s^4 Hz)", "command": "V^2/Hz", "gain": "V s^2/rad", "coherence": "1"}


def test_an_exact_measurement_amplifies_nothing():
    exact = dj.simulate(dj.Study.from_table({**LINEAR, "sensor": {"kind": "ideal"}}))
    assert (exact.attrs["noise_amplification"], exact.attrs["noise_drift"]) == (0.0, 0.0)
    with pytest.raises(ConfigError, match="the measurement is exact"):
        dj.noise_spectrum(exact)


def test_what_a_spectrum_needs(run):
    with pytest.raises(ConfigError, match="'w' is no channel"):
        dj.noise_spectrum(run, "w")
    with pytest.raises(ConfigError, match="needs 4,096 finite samples after 395 s, got 500"):
        dj.noise_spectrum(run, after=395.0)
