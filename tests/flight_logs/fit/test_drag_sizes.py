"""Forces against the speed that a study lacks: the stated size holds the true one within its standard deviation."""

import re
from types import SimpleNamespace

import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.part_texts import acceleration_text
from tests.flight_logs.closed_loop import A_P, K_P, Axis, fly, study_of

FIXED = {"kind": "normal_form", "k_p": {"uniform": [0.5, 1.8]}, "a_p": A_P, "initial": [0.0, 0.0]}
SIZES = r"\(drag, (\S+) ± (\S+) m/s at 1 m/s, or (\S+) ± (\S+) m/s\^2 as an acceleration\)"


def sizes(axis, **changes):
    """The size in the unit of the command and as an acceleration, each with its standard deviation."""
    fitted = fit_log(study_of(**changes), fly(axis=axis))
    (doubt,) = [doubt for doubt in fitted.doubts if doubt.code == "missing-force"]
    return [float(part) for part in re.search(SIZES, doubt.text).groups()]


@pytest.mark.parametrize(
    ("drag", "noise", "changes"),
    [(0.05, 0.002, {}), (0.3, 0.01, {}), (0.3, 0.002, {"plant": FIXED})],
)
def test_drag_is_stated_as_command_and_as_acceleration(drag, noise, changes):
    size, deviation, acceleration, acceleration_deviation = sizes(Axis(drag=drag, noise=noise), **changes)
    assert abs(size - drag / K_P) < 3.0 * deviation
    assert abs(acceleration - drag) < 3.0 * acceleration_deviation + 0.002 * drag
    assert deviation < 0.05 * size


def test_a_plant_without_such_a_gain_has_no_acceleration():
    """Numbers of another plant may be named as its gain is."""
    study = SimpleNamespace(numbers={}, table={"plant": {"kind": "motor"}})
    problem = SimpleNamespace(study=study, named_values=lambda x: {"plant.k_p": 2.0})
    assert acceleration_text(problem, SimpleNamespace(x=None, size=1.0, deviation=0.1)) == ""
