"""A steady wind together with a lag: neither alone explains a refused flight, and both are named with their sizes."""

import re

import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import Unexplained
from tests.flight_logs.closed_loop import K_P, Axis, Pid, fly, study_of

SOFT = Pid(k_p=2.1, k_i=0.7, k_d=1.6, filter=0.06)
FOUND = r"A constant force \((\S+) m/s, as of a steady wind\) and, at the same time, .*? of (\S+) s"


def test_a_steady_wind_and_a_lag_are_named_together():
    with pytest.raises(Unexplained) as refusal:
        fit_log(study_of(SOFT), fly(axis=Axis(wind=-0.4, actuator=0.1), gains=SOFT))
    text = str(refusal.value)
    found = re.search(FOUND, text)
    assert found is not None, text
    force, lag = map(float, found.groups())
    assert force == pytest.approx(-0.4 / K_P, rel=0.02)
    assert lag == pytest.approx(0.1, rel=0.1)
    assert "remain with it" not in text
