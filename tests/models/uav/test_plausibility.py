"""Warnings of a vehicle's numbers: none for plausible ones, one for each slip, none for numbers of a base vehicle."""

import pytest

from dssc_jax.cli.main import guarded
from dssc_jax.cli.warnings import warn_of_vehicle
from dssc_jax.models.uav.battery import Battery
from dssc_jax.models.uav.plausibility import implausible, unusual_power, usual_ranges
from dssc_jax.models.uav.vehicle import HEXACOPTER, QUADROTOR
from dssc_jax.study import Study
from tests.mutations import document

RACER = QUADROTOR._replace(
    mass=1.2,
    body_inertia=(0.004, 0.004, 0.007),
    rotor_inertia_xy=1e-5,
    thrust_coefficient=1.5e-6,
    torque_coefficient=0.015,
    arm=0.13,
    max_thrust=12.0,
    motor_lag=0.03,
)
EVERY = set(QUADROTOR._fields)


def test_a_racer_is_plausible_and_the_article_s_torque_coefficient_is_not():
    assert implausible(RACER, EVERY) == []
    for vehicle in (QUADROTOR, HEXACOPTER):
        (text,) = implausible(vehicle, {"torque_coefficient"})
        assert text == "torque over thrust is 0.57 m, usual are 0.002 to 0.1; see plant.vehicle.torque_coefficient"
        assert implausible(vehicle, {"structure_drag"}) == []


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"max_thrust": 3.1}, "hover throttle is 0.949 of f_max"),
        ({"torque_coefficient": 15.0}, "torque over thrust is 15 m"),
        ({"motor_lag": 3.0}, "motor lag is 3 s"),
        ({"body_inertia": (4.0, 4.0, 7.0)}, "radius of gyration over arm is 14"),
        (
            {"mass": 45.0, "body_inertia": (0.15, 0.15, 0.26), "thrust_coefficient": 6e-5},
            "mass over square of arm is 2.66e+03",
        ),
        ({"thrust_coefficient": 1.5}, "hover speed of a rotor is 1.4 rad/s"),
    ],
)
def test_a_slip_is_named(changes, said):
    (text,) = implausible(RACER._replace(**changes), set(changes))
    assert text.startswith(said)


def test_a_battery_s_power_in_hover_is_compared_with_the_mass():
    """701 W for 2 kg, as 500 rad/s and 0.05 m give, where 250 to 300 W are usual."""
    battery = Battery(300.0, 0.02, 16.8, 13.2, efficiency=0.7)
    vehicle = RACER._replace(mass=2.0, torque_coefficient=0.05, thrust_coefficient=1.962e-5)
    (text,) = unusual_power(vehicle, battery)
    assert text.startswith("the battery's power in hover is 701 W, 350 W/kg, usual are 50 to 300 W/kg")
    assert unusual_power(vehicle, battery._replace(efficiency=None, hover_power=280.0)) == []


def test_ranges_are_ranges():
    for number in usual_ranges(RACER):
        assert number.low < number.value < number.high


def test_the_command_warns(tmp_path, monkeypatch, capsys):
    """Before anything is simulated: the draw does not exist."""
    monkeypatch.chdir(tmp_path)
    study = {
        "name": "slip",
        "loop": {"duration": 0.02, "sample_time": 0.02},
        "plant": {"kind": "uav", "vehicle": {"kind": "m600_quadrotor", "motor_lag": 20.0}},
        "controller": {"kind": "pid", "k_p": 1.0},
    }
    (tmp_path / "slip.toml").write_bytes(document(study))
    assert guarded(["simulate", "slip.toml", "--draw", "5"]) == 2
    assert "warning: motor lag is 20 s, usual are 0.01 to 0.15; see plant.vehicle.motor_lag" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changes", "warned"),
    [
        ({}, True),
        ({"plant.vehicle.propeller_drag": 1e-5}, False),
        ({"plant.vehicle.structure_drag": [0.0, {"uniform": [0.0, 0.1]}, 0.0]}, False),
        ({"wind": {"kind": "none"}}, False),
        ({"sweep": {"plant.vehicle.propeller_drag": [0.0, 1e-5]}}, False),
    ],
)
def test_a_wind_that_moves_nothing_is_warned_of(changes, warned, capsys):
    table = {
        "name": "vacuum",
        "loop": {"duration": 0.02, "sample_time": 0.02},
        "plant": {"kind": "uav", "vehicle": {"kind": "x500", "structure_drag": [0.0, 0.0, 0.0], "propeller_drag": 0.0}},
        "controller": {"kind": "pid", "k_p": 1.0},
        "wind": {"kind": "constant", "x": 5.0, "y": 0.0, "z": 0.0},
    }
    warn_of_vehicle(Study.from_table(table).override(changes))
    assert (
        "the wind has no effect, because the vehicle has no drag" in " ".join(capsys.readouterr().err.split())
    ) == warned
