"""Chattering under a lag of order 2, by describing function and by simulation."""

from dataclasses import replace

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.theory.assessment import time_constants
from dssc_jax.analyses.theory.chattering import time_constant_of

MU = np.geomspace(0.004, 0.02, 5)
CONTROLLERS = {
    "sta": {"kind": "sta", "l0": 1.0, "kappa1": 1.5, "kappa2": 2.2},
    "smc": {"kind": "smc", "l0": 1.0, "gain": 1.0},
}


def chattering(kind, **more):
    """mu max(a_p, l_0) <= 0.02 and T_s <= mu/20."""
    return dj.Study.from_table(
        {
            "name": "chattering",
            "loop": {"duration": 6.0, "sample_time": 2e-4},
            "plant": {"kind": "normal_form", "initial": [1e-3, 0.0]},
            "controller": CONTROLLERS[kind],
            "unmodelled": {"kind": "lag", "order": 2, "mu": 0.01},
            "metrics": {"after": 5.0, "names": ["sigma_max"]},
            **more,
        }
    )


@pytest.mark.parametrize(("kind", "slope", "within"), [("sta", 2.0, 0.03), ("smc", 1.0, 0.1)])
def test_amplitude_over_mu(kind, slope, within):
    """Slopes 2 +- 0.05 under the STA and 1 +- 0.05 under the relay, simulated and by harmonic balance."""
    study = chattering(kind, sweep={"unmodelled.mu": MU.tolist()})
    simulated = dj.run(study).dataset["sigma_max"].values[:, 0]
    predicted = [dj.theory.limit_cycle(study, {"unmodelled.mu": mu}) for mu in MU]
    amplitude = np.array([cycle.amplitude for cycle in predicted])
    assert np.polyfit(np.log(MU), np.log(simulated), 1)[0] == pytest.approx(slope, abs=0.05)
    assert np.polyfit(np.log(MU), np.log(amplitude), 1)[0] == pytest.approx(slope, abs=0.01)
    assert simulated == pytest.approx(amplitude, rel=within)


@pytest.mark.parametrize(("kind", "within"), [("sta", 0.02), ("smc", 0.05)])
def test_frequency(kind, within):
    study = chattering(kind)
    run = dj.simulate(study)
    late = run["t"].values > 4.0
    t, sigma = run["t"].values[late], run["sigma"].values[late]
    rising = t[:-1][(sigma[:-1] < 0.0) & (sigma[1:] >= 0.0)]
    frequency = 2.0 * np.pi * (len(rising) - 1) / (rising[-1] - rising[0])
    assert frequency == pytest.approx(dj.theory.limit_cycle(study).frequency, rel=within)


def test_relay_in_closed_form():
    """l_0 = a_p cancels: W = k_p/(s (mu s + 1)^2), so w = 1/mu and A = 2 K k_p mu/pi."""
    study = chattering("smc").override({"plant.k_p": 1.7, "controller.gain": 0.6, "unmodelled.mu": 0.03})
    cycle = dj.theory.limit_cycle(study)
    assert cycle.frequency == pytest.approx(1.0 / 0.03, rel=1e-9)
    assert cycle.amplitude == pytest.approx(2.0 * 0.6 * 1.7 * 0.03 / np.pi, rel=1e-9)


def test_no_phase_lag_no_chattering():
    for lag in ({"kind": "none"}, {"kind": "lag", "order": 1, "mu": 0.01}):
        assert dj.theory.limit_cycle(chattering("smc").override({"unmodelled": lag})) is None


def test_a_chain_of_two_lags_chatters_as_a_lag_of_order_two():
    table = {name: value for name, value in chattering("smc").table.items() if name != "unmodelled"}
    lag = {"kind": "lag", "mu": 0.03}
    double = dj.theory.limit_cycle(chattering("smc").override({"unmodelled": lag | {"order": 2}}))
    chain = dj.theory.limit_cycle(dj.Study.from_table(table | {"actuator": [lag, lag]}))
    assert chain == pytest.approx(double, rel=1e-9)


def test_unknown_law():
    pi = {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 1.0}
    with pytest.raises(dj.ConfigError, match="the describing function of 'pi' is not known"):
        dj.theory.limit_cycle(chattering("smc").override({"controller": pi}))


def test_dynamics_that_declare_no_time_constant_are_refused():
    rate_limited = chattering("smc").override({"unmodelled": {"kind": "rate_limit", "rate": 5.0}})
    with pytest.raises(dj.ConfigError, match=r"unmodelled.kind: chattering needs dynamics with a time constant"):
        dj.theory.chattering(rate_limited, [0.1], push=0.1, after=1.0)


def test_the_declared_time_constant_is_the_one_that_is_swept():
    """A part that declares another name than mu is walked over that name, and over no other."""
    lagging = chattering("smc").override({"unmodelled": {"kind": "lag", "order": 2, "mu": 0.05}})
    delayed = chattering("smc").override({"unmodelled": {"kind": "delay", "samples": 2.0}})
    declaring = delayed.loop.unmodelled[0]._replace(time_constant="samples")
    renamed = replace(delayed, loop=replace(delayed.loop, unmodelled=(declaring,)))
    assert time_constant_of(lagging) == "unmodelled.mu"
    assert time_constant_of(renamed) == "unmodelled.samples"
    with pytest.raises(dj.ConfigError, match="over the time constant of the unmodelled dynamics"):
        time_constants(renamed, "unmodelled.memory", (0.01, 0.1))
