"""Equilibria beside limits: a state behind a limit must rest, too, and an open loop has no margin."""

from typing import Annotated, NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.signals import Measurement
from dssc_jax.types import SMOOTH, Plant, Quantity

COMMAND_LIMITS = {"low": 0.0, "high": 0.8}


class Converter(NamedTuple):
    """An averaged boost converter: L i' = V - r i - (1 - d) v, C v' = (1 - d) i - v/R."""

    load: Annotated[float, Quantity("Ohm", "R")] = 12.0
    source: Annotated[float, Quantity("V", "V")] = 12.0
    resistance: Annotated[float, Quantity("Ohm", "r")] = 0.055


class Stored(NamedTuple):
    """Current and voltage."""

    i: float
    v: float


def derivative(p, state, drive, t):
    on = 1.0 - drive.command - drive.disturbance
    slope = p.source - p.resistance * state.i - on * state.v
    return Stored(slope / 47e-6, (on * state.i - state.v / p.load) / 220e-6)


def first(p):
    root = jnp.sqrt(p.source**2 - 4.0 * p.resistance * 24.0**2 / p.load)
    return Stored(2.0 * 24.0**2 / (p.load * (p.source + root)), 24.0)


def measure(p, state, drive):
    on = 1.0 - drive.command - drive.disturbance
    return Measurement(state.v, (on * state.i - state.v / p.load) / 220e-6)


CONVERTER = Plant(Converter, first, derivative, measure, lambda p: 1.0, smooth=SMOOTH)


def converter_study(limits, draws=48):
    """The converter at 24 V behind a delay; a second equilibrium has a duty cycle of 0.98."""
    saturation = [{"kind": "saturation", "low": 0.0, "limit": 0.8}] if limits else []
    return dj.Study.from_table(
        {
            "name": "converter",
            "draws": draws,
            "loop": {"duration": 0.01, "sample_time": 1e-5},
            "plant": {
                "kind": "tests.engine.linearisation.test_limits:CONVERTER",
                "load": {"loguniform": [6.0, 24.0]},
                "source": {"uniform": [10.8, 13.2]},
                "resistance": {"uniform": [0.03, 0.08]},
            },
            "reference": {"kind": "step", "offset": 24.0, "size": 1.0, "at": 0.005},
            "actuator": [{"kind": "delay", "samples": 1.0}, *saturation],
            "controller": {"kind": "pid", "k_p": 0.0166, "k_i": 34.89, "k_d": 5.197e-6, "filter": 3.2e-5} | limits,
            "requirement": [{"margin": "phase", "min": 0.7}],
        }
    )


def test_limits_that_do_not_act_do_not_change_margins():
    """Beyond a limit, an integrator that still moves is seen by no signal; its loop was taken as open and at rest."""
    limited = dj.run(converter_study(COMMAND_LIMITS), check=False).dataset["phase_margin"].values
    free = dj.run(converter_study({}), check=False).dataset["phase_margin"].values
    assert np.isfinite(limited).all()
    np.testing.assert_allclose(limited, free, rtol=1e-6)


SAME_LIMITS = {"kind": "saturation", "low": 0.0, "limit": 0.8}


@pytest.mark.parametrize("actuators", [[], [SAME_LIMITS]], ids=["free", "limited"])
def test_an_open_loop_has_no_margin(actuators):
    """Some draws need a command beyond its limit: at rest their loop is open, and violates a required margin.

    An actuator with the controller's limits then rests on its boundary, where it has no derivative and needs none.
    """
    study = dj.Study.from_table(
        {
            "name": "short",
            "draws": 16,
            "loop": {"duration": 10.0, "sample_time": 0.01},
            "plant": {"kind": "state_space", "a": [[-1.0]], "b": ["=gain"], "c": [1.0]},
            "parameters": {"gain": {"uniform": [0.8, 2.0]}},
            "reference": {"kind": "step", "offset": 1.0, "size": 0.0, "at": 1.0},
            "controller": {"kind": "pid", "k_p": 1.0, "k_i": 1.0, "k_d": 0.0} | COMMAND_LIMITS,
            "actuator": actuators,
            "requirement": [{"margin": "phase", "min": 0.5}],
        }
    )
    result = dj.run(study, check=False)
    margins = result.dataset["phase_margin"].values
    gains = result.dataset["parameters.gain"].values
    short = gains < 1.0 / COMMAND_LIMITS["high"]
    assert 0 < short.sum() < 16
    np.testing.assert_array_equal(np.isnan(margins), short)
    assert result.failed.values[short].all()
    assert np.all(margins[~short] > 0.5)
    linearised = dj.loop_margins(study)
    np.testing.assert_array_equal(np.isnan(linearised.dataset["phase"].values[0, 0]), short)
    for statistics in linearised.answer.loops.values():
        assert (statistics.stable, statistics.no_operating_point) == (16 - short.sum(), short.sum())
    rule = rf"controller 'pid' rests at or beyond the limits low and high .* in {short.sum()} of 16 draws"
    with pytest.raises(dj.ConfigError, match=rule):
        dj.worst_loop(study)


class Pendulum(NamedTuple):
    """q'' = (u - b q' - m sin q) / J."""

    m: Annotated[float, Quantity("N m", "torque of gravity", at_least=0.0)] = 0.3
    b: Annotated[float, Quantity("N m s", "friction", at_least=0.0)] = 0.01
    inertia: Annotated[float, Quantity("kg m^2", "J", above=0.0)] = 0.02


class Swing(NamedTuple):
    """Angle and its rate."""

    q: float
    w: float


def swing(p, state, drive, t):
    torque = drive.command + drive.disturbance - p.b * state.w - p.m * jnp.sin(state.q)
    return Swing(state.w, torque / p.inertia)


PENDULUM = Plant(
    Pendulum,
    lambda p: Swing(0.4, 0.0),
    swing,
    lambda p, state, drive: Measurement(state.q, state.w),
    lambda p: 1.0 / p.inertia,
    smooth=SMOOTH,
    angles=("",),
)


def test_an_equilibrium_within_the_limits_is_preferred_to_one_beyond():
    """At its lower limit the command holds the pendulum elsewhere, too, hanging or upside down: an open loop.

    Newton's method came to such an equilibrium in some draws, and the loop counted as unstable. Whether the command
    that the reference needs, m sin 0.9, lies within the limits decides.
    """
    study = dj.Study.from_table(
        {
            "name": "pendulum",
            "draws": 64,
            "loop": {"duration": 4.0, "sample_time": 0.01},
            "plant": {
                "kind": "tests.engine.linearisation.test_limits:PENDULUM",
                "m": {"uniform": [0.25, 0.6]},
                "inertia": {"uniform": [0.01, 0.03]},
            },
            "reference": {"kind": "step", "size": 0.9, "at": 0.0},
            "controller": {
                "kind": "pid",
                "k_p": 1.2,
                "k_i": 1.0,
                "k_d": 0.12,
                "filter": 0.01,
                "low": -0.2,
                "high": 0.42,
            },
            "requirement": [{"margin": "phase", "min": 0.3}],
        }
    )
    result = dj.run(study, check=False)
    margins = result.dataset["phase_margin"].values
    needed = result.dataset["plant.m"].values * np.sin(0.9)
    np.testing.assert_array_equal(np.isnan(margins), needed > 0.42)
    assert np.all(margins[needed < 0.42] > 0.3)
