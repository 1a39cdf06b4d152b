"""Gains and limits of a PX4 file for its cascade: those that cannot be are refused, and slips of units are told."""

import math

import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.models.uav.airframe import read_airframe
from dssc_jax.models.uav.inner_loops.px4 import Px4Gains
from dssc_jax.models.uav.inner_loops.px4_parameters import (
    DEGREES,
    FACTORS,
    PARAMETERS,
    RANGES,
    TILT,
    TRIPLES,
    require_admissible,
    unusual_gains,
)
from tests.models.uav.test_airframe import QUAD


def read_with(*settings, cascade=True):
    """The airframe of a quadrotor of 2 kg with some parameters."""
    text = QUAD + "".join(f"\nparam set {setting}" for setting in settings)
    return read_airframe(text, mass=2.0, use_px4_cascade=cascade)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("MPC_TILTMAX_AIR 0.6", "MPC_TILTMAX_AIR is 0.6 degrees; PX4's range is 20 to 89: check the units"),
        ("MC_ROLLRATE_P 15", "MC_ROLLRATE_P is 15; PX4's range is 0.01 to 0.5: check the units"),
        ("MC_ROLLRATE_MAX 3.5", "MC_ROLLRATE_MAX is 3.5 degrees/s; usual is 10 to 1800: check the units"),
        ("MC_PR_INT_LIM 30", "MC_PR_INT_LIM is 30; usual is 0 to 1: check the units"),
    ],
)
def test_a_gain_outside_of_px4s_range_is_told(setting, words):
    assert words in read_with(setting).warnings
    assert words not in read_with(setting, cascade=False).warnings


def test_px4s_defaults_are_within_its_ranges():
    defaults = Px4Gains()
    values = {name: getattr(defaults, field) for field, name in PARAMETERS.items()}
    for field, names in TRIPLES.items():
        values |= dict(zip(names, getattr(defaults, field), strict=True))
    for field, names in DEGREES.items():
        values |= dict(zip(names, map(math.degrees, getattr(defaults, field)), strict=True))
    values[TILT] = math.degrees(defaults.tilt_max)
    values = {name: value for name, value in values.items() if value is not None}
    assert set(RANGES) - set(values) == {*FACTORS, "MPC_XY_P", "MPC_Z_P", "IMU_GYRO_RATEMAX", "MPC_THR_HOVER"}
    assert unusual_gains(values) == []
    require_admissible(values)


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("MPC_TILTMAX_AIR 95", "MPC_TILTMAX_AIR: must be < 88.8085 degrees, got 95"),
        ("MC_ROLLRATE_MAX 0", "MC_ROLLRATE_MAX: must be > 0 degrees/s, got 0"),
        ("MC_ROLLRATE_K -1", "MC_ROLLRATE_K: must be >= 0, got -1"),
        ("IMU_GYRO_CUTOFF 300", "IMU_GYRO_CUTOFF: must be below half the rate of the loops, 200 Hz, got 300"),
        ("MPC_THR_MAX 0.1", "MPC_THR_MIN: must be < MPC_THR_MAX = 0.1, got 0.12"),
        ("MPC_THR_MIN 12", "MPC_THR_MIN: must be < 1, got 12"),
        ("MC_ROLLRATE_P -0.1", "MC_ROLLRATE_P: must be >= 0, got -0.1"),
    ],
)
def test_a_gain_that_the_cascade_does_not_admit_is_refused_in_px4s_name(setting, words):
    with pytest.raises(ConfigError) as refusal:
        read_with(setting)
    assert str(refusal.value) == words
    read_with(setting, cascade=False)


def test_a_cutoff_of_0_is_no_filter():
    """A filter of the rates that ends just below half of their frequency hardly moves a flight."""
    found = read_with("IMU_GYRO_CUTOFF 0", "IMU_DGYRO_CUTOFF 0")
    plant = {"kind": "uav", **found.plant, "vehicle": found.vehicle, "position": [0.0, 1.0, 0.0]}
    table = {"name": "unfiltered", "loop": {"duration": 0.5, "sample_time": 0.01, "substeps": 8}}
    study = dj.Study.from_table(table | {"plant": plant, "controller": {"kind": "pid", "k_p": 1.0}})
    gains = study.template.plant.inner_loop
    assert gains.gyro_cutoff is None
    assert gains.derivative_cutoff is None
    slopes_filtered = study.override({"plant.inner_loop.derivative_cutoff": 30.0})
    unfiltered = dj.simulate(slopes_filtered)["y_y"].values
    filtered = dj.simulate(slopes_filtered.override({"plant.inner_loop.gyro_cutoff": 199.0}))["y_y"].values
    assert unfiltered == pytest.approx(filtered, abs=1e-5)
    assert abs(unfiltered[-1] - 1.0) > 0.02


def test_a_hover_command_against_mass_and_thrust_is_told():
    contradicted = read_with("SIH_T_MAX 5", "MPC_THR_HOVER 0.3").warnings
    assert any(
        "MPC_THR_HOVER is 0.3, and hover takes 0.981 of SIH_T_MAX = 5 N with 2 kg" in text for text in contradicted
    )
    assert not read_with("SIH_T_MAX 10", "MPC_THR_HOVER 0.5").warnings


@pytest.mark.parametrize("setting", ["SIH_T_MAX 0", "SIH_IXX 0", "SIH_IZZ -0.01"])
def test_a_thrust_or_an_inertia_that_is_not_positive_is_refused_by_its_name(setting):
    with pytest.raises(ConfigError, match=f"{setting.split()[0]}: must be > 0, got"):
        read_with(setting, "SIH_Q_MAX 0.1")


@pytest.mark.parametrize("kind", [1, 2, 3])
def test_a_simulated_plane_is_refused(kind):
    with pytest.raises(ConfigError, match=r"SIH_VEHICLE_TYPE: must be that of a multirotor, 0 \(quadrotor\)"):
        read_with(f"SIH_VEHICLE_TYPE {kind}")
