"""A draw may not end as settled before a reference, a wind, a disturbance or an event has done all that it does."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.models.disturbances import DISTURBANCES
from dssc_jax.models.events import EVENTS
from dssc_jax.models.references import REFERENCES, TRAJECTORIES
from dssc_jax.models.wind import WINDS

SERVO = {
    "name": "servo",
    "draws": 8,
    "loop": {"duration": 10.0, "sample_time": 0.01, "settled": {"error": 0.02, "hold": 0.5, "after": 5.0}},
    "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "initial": [1.0, 0.0]},
    "controller": {"kind": "pid", "k_p": 6.0, "k_i": 2.0, "k_d": 3.0},
    "requirement": [{"metric": "error_max", "after": 5.0, "max": 0.1}],
}
HOVER = {
    "name": "hover",
    "loop": {"duration": 20.0, "sample_time": 0.01, "settled": {"error": 0.05, "hold": 0.5, "after": 8.0}},
    "plant": {"kind": "uav"},
    "reference": {"kind": "hover"},
    "controller": {"kind": "pi", "l0": 0.5, "k_p": 1.0, "k_i": 0.2},
}
STILL = {"x": [0.0, 0.0], "y": [0.0, 0.0], "z": [0.0, 0.0]}
SINE = {"kind": "sine", "amplitude": 1.0}
LATE = [
    (SERVO, {"disturbance": {"kind": "record", "time": [0.0, 7.9, 8.0], "value": [0.0, 0.0, 2.0]}}, "8"),
    (SERVO, {"disturbance": {"kind": "spline", "interval": 2.0, "knots": [0.0, 0.0, 5.0]}}, "8"),
    (SERVO, {"disturbance": {"kind": "sine", "amplitude": 2.0, "period": {"uniform": [6.0, 7.0]}}}, "7"),
    (
        SERVO,
        {"disturbance": [{"kind": "constant", "value": 0.1}, {"kind": "sine", "amplitude": 1.0, "period": 6.0}]},
        "6",
    ),
    (SERVO, {"reference": {"kind": "ramp", "slope": 1.0, "rise": 8.0}}, "8"),
    (SERVO, {"reference": {"kind": "record", "time": [0.0, 8.0, 8.1], "value": [0.0, 0.0, 1.0]}}, "8.1"),
    (HOVER, {"wind": {"kind": "piecewise", "times": [0.0, 15.0], **STILL, "x": [0.0, 12.0]}}, "15"),
    (HOVER, {"wind": {"kind": "record", "time": [0.0, 15.0], **STILL, "x": [0.0, 12.0]}}, "15"),
    (HOVER, {"wind": {"kind": "gust", "x": 9.0, "y": 0.0, "z": 0.0, "at": 7.0, "duration": 12.0}}, "19"),
    (HOVER, {"reference": {"kind": "hover", "x": {"kind": "ramp", "slope": 0.1, "at": 1.0, "rise": 9.0}}}, "10"),
    (HOVER, {"event": [{"kind": "voltage_sag", "at": 4.0, "voltage": 0.8, "rise": 6.0}]}, "10"),
    (HOVER, {"event": [{"kind": "sensor_outage", "at": 4.0, "duration": 6.0}]}, "10"),
]


@pytest.mark.parametrize(("table", "changes", "time"), LATE)
def test_what_comes_late_is_refused_with_its_time(table, changes, time):
    with pytest.raises(dj.ConfigError, match=rf"loop\.settled\.after: must be >= {time} s"):
        dj.Study.from_table({**table, **changes})
    settled = {**table["loop"]["settled"], "after": float(time)}
    dj.Study.from_table({**table, **changes, "loop": {**table["loop"], "settled": settled}})


def test_a_sweep_may_not_move_it_beyond():
    sine = {"kind": "sine", "amplitude": 2.0, "period": 4.0}
    dj.Study.from_table({**SERVO, "disturbance": sine})
    with pytest.raises(dj.ConfigError, match=r"must be >= 6 s"):
        dj.Study.from_table({**SERVO, "disturbance": sine, "sweep": {"disturbance.period": [4.0, 6.0]}})


@pytest.mark.parametrize(
    "reference",
    [
        {"kind": "pulses", "size": 1.0, "period": 8.5, "width": 0.5},
        {"kind": "chirp", "amplitude": 0.1, "start": 0.5, "end": 2.0, "duration": 1.0},
    ],
)
def test_what_changes_at_any_time_is_refused(reference):
    with pytest.raises(dj.ConfigError, match=r"loop\.settled: \[reference\] may do something new at any time"):
        dj.Study.from_table({**SERVO, "reference": reference})


LOCAL = DISTURBANCES["none"].default_member._replace(last_change=None)


def test_a_part_that_does_not_declare_it_is_refused():
    with pytest.raises(dj.ConfigError, match=r"\[disturbance\] does not declare its last_change"):
        dj.Study.from_table({**SERVO, "disturbance": {"kind": f"{__name__}:LOCAL"}})


def test_every_part_of_the_package_declares_it():
    for registry in (REFERENCES, TRAJECTORIES, DISTURBANCES, WINDS, EVENTS):
        for kind, entry in registry.items():
            assert all(model.last_change is not None for model in entry.members.values()), kind


def test_the_failures_that_were_hidden_are_seen():
    """With the disturbance within what a draw must see, all draws fail; the requirement has the same window."""
    late = {"kind": "record", "time": [0.0, 7.9, 8.0], "value": [0.0, 0.0, 2.0]}
    settled = {"error": 0.02, "hold": 0.5, "after": 8.0}
    loop = {**SERVO["loop"], "settled": settled}
    result = dj.run(dj.Study.from_table({**SERVO, "disturbance": late, "loop": loop}), check=False)
    assert np.all(result.failed)
