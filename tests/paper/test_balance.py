"""Why DSSC oscillates: the linear loop against its own equation, describing functions against closed forms."""

import numpy as np
import pytest

import dssc_jax as dj
from benchmarks.paper import balance, cycles
from benchmarks.paper.loops import RHO, comparison, sta

K_P, K_I, DT = 0.15, 0.3, 0.005
SSC = {
    "kind": "ssc",
    "l0": 0.2,
    "rho": 50.0,
    "functions": {"k_o": 1.0 / (K_P * 0.03), "tau_av": 0.03, "tau_m": K_P / K_I},
}


def test_eigenvalues_solve_the_closed_loop():
    poles = balance.eigenvalues(K_P, 0.3)
    assert len(poles) == 5
    for s in poles[np.abs(poles + balance.L0) > 1e-6]:  # the zero at -l0 cancels
        assert abs(1.0 + K_P * (1.0 + 1.0 / (0.3 * s)) * balance.plant(s)) < 1e-9


def test_stability_boundary_lies_where_the_loop_has_its_margin():
    """An imaginary pair of poles: 1 + K_P (1 + 1/(tau_m s)) P = 0 at some s = i w; less is unstable, more is stable."""
    least = balance.least_tau_m(K_P)
    pair = balance.eigenvalues(K_P, least)[0]
    assert abs(pair.real) < 1e-9
    assert abs(1.0 + K_P * (1.0 + 1.0 / (least * pair)) * balance.plant(pair)) < 1e-8
    assert balance.eigenvalues(K_P, 0.9 * least)[0].real > 0.0 > balance.eigenvalues(K_P, 1.1 * least)[0].real


@pytest.fixture(scope="module")
def study():
    return comparison()


def test_constant_functions_answer_as_a_sampled_pi_controller(study):
    """N = -(K_P + K_I T_s/(1 - exp(-i w T_s))), for any amplitude below the limit."""
    found = balance.element(study.override({"controller": SSC}))
    for amplitude, frequency in ((0.1, 1.0), (2.0, 6.0)):
        exact = -(K_P + K_I * DT / (1.0 - np.exp(-1j * frequency * DT)))
        assert found(amplitude, frequency, 0.0) == pytest.approx(exact, rel=1e-3)


def test_the_clipped_sta_answers_as_a_relay(study):
    found = balance.element(study.override({"controller": sta(clipped=True)}))
    exact = -4.0 * RHO["x"] / (np.pi * 0.02)
    assert found(0.02, 7.0, 0.0) == pytest.approx(exact, rel=0.01)


def test_relay_cycle_balances():
    cycle = balance.relay_cycle(0.375, 0.0)
    assert cycle.frequency == pytest.approx(np.sqrt(60.0), rel=0.04)  # where 60/(s^2 + 15 s + 60)/s has -180 degrees
    assert -cycle.u / cycle.sigma * balance.plant(1j * cycle.frequency) == pytest.approx(1.0, abs=1e-9)
    assert balance.relay_cycle(0.375, 0.0, motor_lag=0.05).sigma > cycle.sigma


def test_no_limit_cycle_is_an_error(study):
    found = balance.element(study.override({"controller": SSC}))
    with pytest.raises(RuntimeError, match="no limit cycle"):
        balance.limit_cycle(found, 0.0, balance.Cycle(1.0, 0.1, 0.1), DT)


def test_fundamental_of_a_known_signal():
    t = np.arange(0.0, 50.0, DT)
    frequency, amplitude = balance.fundamental(0.7 + 0.3 * np.cos(4.4 * t) + 0.05 * np.cos(13.2 * t), DT)
    assert frequency == pytest.approx(4.4, rel=1e-3)
    assert amplitude == pytest.approx(0.3, rel=1e-2)


def test_prediction_agrees_with_a_flight(study):
    """The saturated limit cycle at kappa_m = 0.06: frequency and amplitudes to 5 %."""
    study = study.override({**cycles.ON_REFERENCE, "controller.functions.kappa_m": 0.06025, "loop.duration": 60.0})
    guess = balance.Cycle(2.0, 0.2, 0.4)
    ahead = balance.limit_cycle(balance.element(study, "kappa_m"), 0.06025, guess, DT)
    assert balance.simulated(dj.simulate(study)) == pytest.approx(ahead, rel=0.05)
