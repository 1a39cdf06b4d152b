"""The predicted drift of the implicit form against quadrature and simulation, and the warning."""

import jax
import numpy as np
import pytest
from scipy.special import roots_hermitenorm

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.design.noise import SAMPLES, mean_rates, noise_drift, noise_warning
from dssc_jax.models.controllers.gain_functions import SquareRoot

NOISY = {"kind": "noisy", "velocity_std": 0.06}
CASE_2 = dj.Study.load("studies/paper_case2.toml").override(
    {
        "controller.discretisation": "implicit",
        "controller.predictor_start": "matched",
        "disturbance": {"kind": "none"},
        "sensor": NOISY,
        "requirement": [],
    }
)


def test_rates_by_quadrature():
    """White noise: E[g(sigma + n) n]/T_s and E[g(sigma + n) (sigma + n)/tau_m], by Gauss and Hermite's rule."""
    row, size, dt = SquareRoot(110.0, 4.0, 1.0, 0.5, 0.03), 0.06, 0.004
    nodes, weights = roots_hermitenorm(201)
    weights = weights / weights.sum()
    sigma = np.array([0.1, 0.4, 2.0])
    read = sigma[:, None] + size * nodes
    r = np.sqrt(np.abs(read))
    gain = 1.0 / (110.0 * (r + 1.0) * 0.03)
    by_noise = (gain * size * nodes) @ weights / dt
    by_law = (gain * read / (4.0 * (r + 0.5))) @ weights
    noise = size * np.random.default_rng(0).standard_normal(40 * SAMPLES)
    with jax.enable_x64(True):
        found = mean_rates(row, 0.2, noise, sigma, dt)
    np.testing.assert_allclose(found[0], by_noise, rtol=0.05)
    np.testing.assert_allclose(found[1], by_law, rtol=0.002)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"loop.sample_time": 0.02},
        {"sensor.period_samples": 4.0},
        {"sensor": {"kind": "noisy", "position_std": 0.002}, "differentiator": {"kind": "lead_filter", "tau_f": 0.05}},
    ],
    ids=["5 ms", "20 ms", "held for four samples", "lead filter"],
)
def test_the_loop_rests_where_it_is_predicted_to(changes):
    study = CASE_2.override({"loop.duration": 160.0, "draws": 8, "metrics": {"after": 100.0, "names": ["error_rms"]}})
    study = study.override(changes)
    predicted = noise_drift(study)[""].error
    simulated = float(dj.run(study).dataset["error_rms"].median())
    print(f"\npredicted {predicted:.3f} m, simulated {simulated:.3f} m")
    assert predicted > 0.1
    assert predicted == pytest.approx(simulated, rel=0.15)


def test_where_nothing_drifts():
    assert noise_drift(CASE_2.override({"controller.discretisation": "conservative"})) == {}
    assert noise_drift(CASE_2.override({"sensor": {"kind": "ideal"}})) == {}
    constant = {"kind": "constant", "k_o": 100.0, "tau_m": 4.0, "tau_av": 0.03}
    drift = noise_drift(CASE_2.override({"controller.functions": constant}))[""]
    assert (drift.rate, drift.error) == (pytest.approx(0.0, abs=1e-12), 0.0)
    assert drift.noise == pytest.approx(0.06, rel=0.03)
    assert noise_warning(CASE_2.override({"sensor.velocity_std": 1e-4})) is None


def test_channels_are_named_with_their_units():
    study = dj.Study.load("studies/uav_robustness.toml").override({"controller.discretisation": "implicit"})
    text = noise_warning(study)
    assert text is not None
    assert "m in x, " in text
    assert "rad in psi; " in text


def test_a_command_warns(tmp_path, capsys):
    arguments = [
        "simulate",
        "paper_case2",
        "--json",
        "--set",
        "controller.discretisation=implicit",
        "--set",
        "sensor={ kind = 'noisy', velocity_std = 0.06 }",
    ]
    arguments += ["--set", "loop.duration=1.0", "--set", "requirement=[]", "--set", "disturbance={ kind = 'none' }"]
    assert guarded(arguments) == 0
    assert capsys.readouterr().err.startswith(
        "warning: measurement noise is predicted to move DSSC's implicit form off"
    )
    assert guarded([*arguments, "--set", "controller.discretisation=conservative"]) == 0
    assert capsys.readouterr().err == ""
