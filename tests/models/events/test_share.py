"""The share of an event in float32 and float64: exact outside of its samples, with derivatives by its times within."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.events import share_of
from dssc_jax.core.numerics import arithmetic
from dssc_jax.models.events.rotor import RotorParams
from dssc_jax.models.events.voltage_sag import SagParams

DT = 0.005
EVENTS = {
    "step": lambda at, rise, until: RotorParams(at, 1.0, 0.0),
    "ended step": lambda at, rise, until: RotorParams(at, 1.0, 0.0, until),
    "ramp": lambda at, rise, until: SagParams(at, 0.8, rise),
    "ended ramp": lambda at, rise, until: SagParams(at, 0.8, rise, until),
}


@pytest.mark.parametrize("precision", [32, 64])
@pytest.mark.parametrize("name", EVENTS)
def test_the_share_is_exact_before_and_after_an_event(name, precision):
    """Samples up to t = 100 s, which binary fractions of 5 ms do not meet."""
    with arithmetic(precision):
        t = jnp.arange(20_000) * DT
        at, rise, until = 1.0012, 0.3007, 90.0021
        share = np.asarray(jax.vmap(lambda time: share_of(EVENTS[name](at, rise, until), time, DT))(t))
    times = np.arange(20_000) * DT
    complete = at + (rise if "ramp" in name else 0.0)
    end = until if "ended" in name else np.inf
    assert np.all(share[times + DT < at] == 0.0)
    assert np.all(share[(times > complete) & (times + DT < end)] == 1.0)
    assert np.all(share[times > end] == 0.0)
    assert np.all((share >= 0.0) & (share <= 1.0))
    mean = end - at - 0.5 * (complete - at) if "ended" in name else 100.0 - at - 0.5 * (complete - at)
    assert DT * share.sum(dtype=np.float64) == pytest.approx(mean, rel=1e-6)


@pytest.mark.parametrize("name", EVENTS)
def test_derivatives_by_the_times_are_those_of_differences(name):
    """At samples in which the event begins, rises, is complete, and ends."""

    def share(times, t):
        return share_of(EVENTS[name](*times), t, DT)

    times = jnp.array([1.0012, 0.0203, 1.0521])
    for t in (0.5, 1.0, 1.005, 1.02, 1.03, 1.05, 1.06):
        found = np.asarray(jax.grad(share)(times, t))
        steps = 1e-7 * np.eye(3)
        expected = [float(share(times + step, t) - share(times - step, t)) / 2e-7 for step in steps]
        np.testing.assert_allclose(found, expected, atol=1e-4)

    def total(at):
        return DT * jnp.sum(jax.vmap(lambda t: share(times.at[0].set(at), t))(jnp.arange(300) * DT))

    moved = jax.grad(total)(1.0012)
    assert float(moved) == pytest.approx(-1.0)


def test_an_early_event_adds_no_noise_to_a_long_flight_in_float32():
    """The rounding of the time moved thrust from sample to sample, and the command by 1e-3 of its variation."""
    table = {
        "name": "late",
        "draws": 1,
        "plant": {"kind": "uav", "vehicle": "m600_hexacopter"},
        "controller": {"kind": "pid", "k_p": 1.0, "k_d": 1.0, "k_i": 0.1},
        "reference": {"kind": "hover"},
        "event": [{"kind": "rotor", "at": 1.0, "rotor": 1, "effectiveness": 0.7}],
        "metrics": {"names": ["command_tv"], "after": 20.0},
        "requirement": [],
    }
    found = {}
    for precision in (64, 32):
        loop = {"duration": 30.0, "sample_time": 0.005, "precision": precision}
        found[precision] = dj.simulate(dj.Study.from_table(table | {"loop": loop})).attrs["command_tv_y"]
    assert found[32] == pytest.approx(found[64], rel=2e-4)
