"""Phases of many loops are unwrapped together: against what poles, integrators and delays turn through."""

import numpy as np
import pytest

from dssc_jax.analyses.loop_margins.fans import fan_quantiles, joint_phase, pole_phase

ANGLES = np.geomspace(1e-3, np.pi * (1.0 - 1e-9), 240)
Z = np.exp(1j * ANGLES)
HALF_TURN = 180.0


def band_of(loops, poles):
    """The widest band of 90 % of the draws, and the median at the last angle [deg]."""
    fan = fan_quantiles(-loops / (1.0 + loops), poles, ANGLES)["loop_phase"]
    low, middle, high = np.degrees(fan)
    return np.max(high - low), middle[-1]


def test_a_little_lead_and_a_little_lag_at_the_crossover_are_close():
    """L = k/(1 - p/z) (1 + c z): the phase where |L| = 1 is within some degrees of 0, to both sides."""
    turns = np.linspace(-0.3, 0.3, 21)
    loops = np.stack([2.0 * (1.0 - 0.5) / (1.0 - 0.5 / Z) * np.exp(1j * turn) for turn in turns])
    widest, _ = band_of(loops, np.full((len(loops), 1), 0.5 + 0j))
    assert widest == pytest.approx(np.degrees(0.54), abs=0.1)  # between the quantiles 5 % and 95 % of the turns


def test_light_resonances_behind_a_delay_turn_every_loop_the_same_way():
    """An integrator, a resonance of little damping and six samples of delay: -90 - 180 degrees, and the delay."""
    rng, loops, poles = np.random.default_rng(0), [], []
    for _ in range(40):
        rate, damping = rng.uniform(0.25, 0.4), 10.0 ** rng.uniform(-5.0, -3.0)
        pole = np.exp(rate * (-damping + 1j * np.sqrt(1.0 - damping**2)))
        loops.append(0.02 * np.abs(1.0 - pole) ** 2 / ((Z - 1.0) * (Z - pole) * (Z - pole.conj()) * Z**6))
        poles.append([1.0, pole, pole.conj()] + [0.0] * 6)
    widest, last = band_of(np.array(loops), np.array(poles))
    assert widest <= HALF_TURN + 0.1  # a loop before its resonance, and one behind it
    assert last == pytest.approx(-HALF_TURN * (1 + 2 + 6), abs=0.1)


def test_a_resonance_that_is_unstable_in_some_draws_turns_the_other_way_to_the_same_direction():
    damping = np.concatenate([np.full(30, 1e-2), np.full(10, -1e-2)])
    pole = np.exp(0.3 * (-damping + 1j * np.sqrt(1.0 - damping**2)))[:, None]
    loops = 0.02 * np.abs(1.0 - pole) ** 2 / ((Z - 1.0) * (Z - pole) * (Z - pole.conj()))
    poles = np.concatenate([np.ones((40, 1)), pole, pole.conj()], axis=1)
    phase = np.degrees(joint_phase(loops, poles, ANGLES))
    assert np.ptp(phase[:, -1]) < 1.0
    assert np.ptp(phase[:, 0]) < 1.0


@pytest.mark.parametrize("share", [0.2, 0.7])
def test_loops_of_the_other_sign_keep_to_one_side(share):
    """L = k/(z - 1)/(1 - p/z), whose sign and pole differ: half a turn apart, more or less, at every frequency."""
    rng = np.random.default_rng(1)
    poles = rng.uniform(0.6, 0.9, 200)
    signs = np.where(rng.uniform(size=200) < share, -1.0, 1.0)
    loops = np.stack([sign * 0.05 / (Z - 1.0) / (1.0 - pole / Z) for sign, pole in zip(signs, poles, strict=True)])
    phase = np.degrees(joint_phase(loops, np.stack([np.ones(200), poles], axis=1), ANGLES))
    assert np.abs(np.diff(phase, axis=1)).max() < 90.0
    positive, negative = (np.median(phase[signs == sign], axis=0) for sign in (1.0, -1.0))
    np.testing.assert_allclose(np.abs(positive - negative), HALF_TURN, atol=10.0)
    for sign in (1.0, -1.0):
        assert np.ptp(phase[signs == sign], axis=0).max() < 60.0


def test_pole_phases_are_those_of_a_dense_grid():
    rng = np.random.default_rng(3)
    poles = rng.uniform(0.0, 1.3, (5, 4)) * np.exp(1j * rng.uniform(-np.pi, np.pi, (5, 4)))
    dense = np.linspace(1e-3, np.pi, 20001)
    factors = np.prod(np.exp(1j * dense)[None, :, None] - poles[:, None, :], axis=2)
    turned = np.unwrap(np.angle(factors), axis=1)
    found = pole_phase(poles, dense)
    np.testing.assert_allclose(found - found[:, :1], turned - turned[:, :1], atol=1e-9)
