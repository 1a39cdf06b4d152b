"""A plant that changes with time has no equilibrium; its margins were those of the first sample, without a word."""

from typing import NamedTuple

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.types import SMOOTH, Measurement, Plant


class Empty(NamedTuple):
    """No parameters."""


class Speed(NamedTuple):
    """Of a body with unit damping."""

    v: float


def draining(p, state, drive, t):
    """m v' = u + w - m v, whose mass is 2 - t/4."""
    return Speed((drive.command + drive.disturbance) / (2.0 - 0.25 * t) - state.v)


def constant(p, state, drive, t):
    """The same with its mass at t = 4 s."""
    return draining(p, state, drive, 4.0)


def body(slopes):
    return Plant(
        Empty, lambda p: Speed(0.0), slopes, lambda p, x, u: Measurement(x.v, 0.0), lambda p: 1.0, smooth=SMOOTH
    )


DRAINING = body(draining)
CONSTANT = body(constant)


def study(name, **fields):
    return dj.Study.from_table(
        {
            "name": "mass",
            "draws": 2,
            "loop": {"duration": 6.0, "sample_time": 0.1, "substeps": 8},
            "plant": {"kind": f"tests.engine.linearisation.test_time_dependence:{name}"},
            "controller": {"kind": "pid", "k_p": 3.0, "k_i": 5.0},
        }
        | fields
    )


def test_margins_at_rest_are_refused():
    changing = "changes with the time t, so that the loop has no equilibrium; linearise along the flight"
    with pytest.raises(dj.ConfigError, match=changing):
        dj.loop_margins(study("DRAINING"))
    with pytest.raises(dj.ConfigError, match=changing):
        dj.run(study("DRAINING", requirement=[{"margin": "phase", "min": "30 deg"}]), check=False)
    with pytest.raises(dj.ConfigError, match=changing):
        dj.worst_loop(study("DRAINING", controller={"kind": "pid", "k_p": {"uniform": [2.0, 3.0]}, "k_i": 5.0}))


def test_margins_along_the_flight_are_those_of_the_mass_there():
    """The mass at 4 s makes them, but for its change within a sample."""
    flying = dj.loop_margins(study("DRAINING"), times=(4.0,)).dataset["phase"].values
    resting = dj.loop_margins(study("CONSTANT")).dataset["phase"].values
    np.testing.assert_allclose(flying, resting, rtol=0.02)
