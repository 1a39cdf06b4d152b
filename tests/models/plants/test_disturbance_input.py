"""A disturbance with an input column of its own: a load current in the derivative of a converter's voltage."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.design import exact_rates, rate_warning
from tests.exponentials import exponential

L, C, R = 10e-6, 100e-6, 5.0
T_S = 1e-5
A = [[-1.0 / (R * C), 1.0 / C], [-1.0 / L, 0.0]]
B, E, OUTPUT = [0.0, 1.0 / L], [-1.0 / C, 0.0], [1.0, 0.0]
LOAD = 0.4
CONVERTER = {
    "name": "converter",
    "loop": {"duration": 100 * T_S, "sample_time": T_S},
    "plant": {"kind": "state_space", "a": A, "b": B, "c": OUTPUT, "disturbance": E},
    "controller": {"kind": "pi", "l0": 1e4, "k_p": 2e-6, "k_i": 0.01},
    "disturbance": {"kind": "constant", "value": LOAD},
}


def simulated(steps):
    """y and y' at the samples, by one matrix exponential a sample, with the control law in NumPy."""
    held = np.zeros((4, 4))
    held[:2, :2], held[:2, 2], held[:2, 3] = A, B, E
    transition = exponential(held * T_S)
    x, integral, rows = np.zeros(2), 0.0, []
    for _ in range(steps):
        y = x[0]
        slope = (np.array(A) @ x)[0] + E[0] * LOAD
        rows.append((y, slope))
        sigma = slope + 1e4 * y
        integral += T_S * sigma
        u = -2e-6 * sigma - 0.01 * integral
        x = (transition @ np.array([*x, u, LOAD]))[:2]
    return np.array(rows)


def test_the_measured_derivative_contains_the_load():
    """It is the derivative of y, not a number that no sensor could show."""
    run = dj.simulate(dj.Study.from_table(CONVERTER))
    expected = simulated(100)
    np.testing.assert_allclose(run["y"].values, expected[:, 0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(run["y_dot"].values, expected[:, 1], rtol=1e-9, atol=1e-6)
    assert expected[0, 1] == -LOAD / C


def test_without_its_column_the_disturbance_acts_as_the_command():
    plant = {name: value for name, value in CONVERTER["plant"].items() if name != "disturbance"}
    matched = dj.Study.from_table(CONVERTER | {"plant": plant})
    named = dj.Study.from_table(CONVERTER | {"plant": plant | {"disturbance": B}})
    for signal in ("y", "y_dot"):
        np.testing.assert_array_equal(dj.simulate(matched)[signal].values, dj.simulate(named)[signal].values)


def test_an_exact_derivative_that_shows_the_disturbance_is_told():
    study = dj.Study.from_table(CONVERTER)
    assert exact_rates(study) == ("",)
    assert "[differentiator]" in rate_warning(study)
    silent = [
        {"disturbance": {"kind": "none"}},
        {"differentiator": {"kind": "lead_filter", "tau_f": 1e-4}},
        {"sensor": {"kind": "noisy", "velocity_std": 1.0}},
        {"sensor": {"kind": "noisy", "velocity_resolution": 0.3}},
        {"sensor": {"kind": "noisy", "delay_samples": 1.0}},
        {"sensor": {"kind": "lag", "mu": 1e-4}},
        {"plant": CONVERTER["plant"] | {"disturbance": B}},
        {"controller": {"kind": "pid", "k_p": 1e-3, "k_i": 1.0, "k_d": 1e-7}},  # it takes y alone
        {"controller": {"kind": "state_feedback", "k_1": 1e-3, "k_2": 0.0}},
        {"controller": {"kind": "lqg", "command_weight": 1.0, "output_weight": 1.0, "signal_std": [0.1]}},
    ]
    for change in silent:
        assert rate_warning(dj.Study.from_table(CONVERTER | change)) is None
    switching = {"kind": "smc", "l0": 1e4, "gain": 0.1}
    assert rate_warning(dj.Study.from_table(CONVERTER | {"controller": switching})) is not None


def test_a_named_input_and_noise_on_y_alone_are_told_too():
    """The load acts at an input of its own, and the sensor leaves y' as it is."""
    matched = {name: value for name, value in CONVERTER["plant"].items() if name != "disturbance"}
    named = matched | {"inputs": {"load": {"column": E, "unit": "A"}}}
    load = [{"kind": "constant", "value": LOAD, "input": "load"}]
    assert exact_rates(dj.Study.from_table(CONVERTER | {"plant": named, "disturbance": load})) == ("",)
    assert exact_rates(dj.Study.from_table(CONVERTER | {"plant": named, "disturbance": {"kind": "none"}})) == ()
    noisy = {"sensor": {"kind": "noisy", "position_std": 0.1, "position_resolution": 0.01}}
    assert exact_rates(dj.Study.from_table(CONVERTER | noisy)) == ("",)


def test_the_column_has_a_number_for_each_state():
    with pytest.raises(ConfigError, match=r"plant.disturbance: must have 2 numbers, one for each state, got 1"):
        dj.Study.from_table(CONVERTER | {"plant": CONVERTER["plant"] | {"disturbance": [1.0]}})


def test_theorem_1_is_silent_on_a_disturbance_that_is_not_matched():
    functions = {"kind": "approx_sta_2", "kappa1": 1.0, "kappa2": 1.0, "delta": 0.5, "tau_av": 1e-4}
    dssc = {"kind": "dssc", "l0": 1e3, "rho": 10.0, "functions": functions}
    vgsta = dict.fromkeys(["phi_a", "phi_b", "kappa_a", "kappa_b", "kappa_c", "kappa_d"], 0.5)
    table = {"kind": "vgsta", **vgsta, "epsilon": 0.5, "gamma": 1.0, "delta": 0.1, "tau_av": 1e-4}
    study = dj.Study.from_table(CONVERTER | {"controller": dssc | {"functions": table}})
    assert "input column" in dj.run(study, check=False).theorem
