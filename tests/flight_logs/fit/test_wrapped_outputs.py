"""Outputs that are wrapped angles: the turns are found, and a refused fit tells them in place of other columns."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import Unexplained
from dssc_jax.flight_logs.fit.wrapped_outputs import turns_of
from tests.flight_logs.closed_loop import fly, study_of

TURN = 2.0 * np.pi


@pytest.mark.parametrize(("unit", "turn"), [("m", TURN), ("m", 360.0), ("rad", TURN)])
def test_turns_of_a_wrapped_angle(unit, turn):
    random = np.random.default_rng(0)
    angle = turn * (0.8 * np.sin(np.linspace(0.0, 9.0, 2000)) + 0.001 * random.normal(size=2000))
    wrapped = (angle + 0.5 * turn) % turn - 0.5 * turn
    wrapped[::7] = np.nan
    is_logged = np.isfinite(wrapped)
    np.testing.assert_allclose((wrapped - turns_of(wrapped, unit))[is_logged], angle[is_logged], atol=1e-9 * turn)


def test_other_jumps_are_no_turns():
    steps = np.repeat([0.0, 5.0, 1.0], 50)
    assert not turns_of(steps, "m").any()
    assert not turns_of(np.zeros(50), "m").any()
    assert not turns_of(np.full(50, np.nan), "rad").any()


def test_a_wrapped_output_is_refused_with_that_in_place_of_exchanged_columns():
    log = fly()
    y = log.columns["y"]
    shifted = (y.value + 0.4 > 0.9) & (y.time > 1.0)
    wrapped = log._replace(columns=log.columns | {"y": y._replace(value=y.value - TURN * shifted)})
    with pytest.raises(Unexplained, match="y jumps 5 times, each time by a full turn") as refusal:
        fit_log(study_of(), wrapped)
    assert "with that, the study describes the flight" in str(refusal.value)
    assert "exchanged" not in str(refusal.value)
