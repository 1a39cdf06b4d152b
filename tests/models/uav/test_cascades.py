"""Sampled inner loops: step responses against the autopilots' cascades in plain NumPy."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.smoothness import declared_smoothness
from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.design.certification import NotCovered
from dssc_jax.design.ends import Ends
from dssc_jax.models.uav import UAV
from dssc_jax.models.uav.inner_loops.px4 import Px4Gains
from dssc_jax.models.uav.inner_loops.px4_parameters import gains_from
from dssc_jax.models.uav.inner_loops.sampled import Readings
from dssc_jax.proofs.vehicle_coverage import require_inner_loop
from tests.models.uav.cascades_by_hand import Craft, Crazyflie, Px4, flight

VEHICLE = {
    "mass": Craft.mass,
    "body_inertia": Craft.inertia.tolist(),
    "rotor_inertia_xy": 0.0,
    "rotor_inertia_z": 0.0,
    "thrust_coefficient": Craft.k_t,
    "torque_coefficient": Craft.torque,
    "arm": Craft.arm,
    "motor_lag": Craft.lag,
    "max_thrust": Craft.limit,
    "structure_drag": [0.0, 0.0, 0.0],
    "propeller_drag": 0.0,
}
SOFTWARE = {"px4": Px4, "crazyflie": Crazyflie}


def study_of(kind, target, frequency=400.0, substeps=8, **more):
    inner_loop = {"kind": kind} | ({} if kind == "article" else {"frequency": frequency})
    table = {
        "name": "step",
        "draws": 1,
        "loop": {"duration": 2.0, "sample_time": 0.01, "substeps": substeps},
        "plant": {"kind": "uav", "vehicle": VEHICLE, "inner_loop": inner_loop},
        "reference": {"kind": "hover", "position": list(target[:3]), "yaw": target[3]},
        "controller": {"kind": "pid", "k_p": 0.95, "psi": {"k_p": 2.8}},
    }
    return dj.Study.from_table(table | more)


STEPS = {
    "small": (0.5, -0.3, 0.4, 0.5),
    "tilt_limit": (12.0, -8.0, 1.0, -2.0),  # the tilt, the rates and the rotors reach their limits
    "descent": (1.0, 1.0, -15.0, -0.4),  # the thrust does
}


@pytest.mark.parametrize("kind", SOFTWARE)
@pytest.mark.parametrize("step", STEPS)
def test_step_responses_are_those_of_the_cascade_by_hand(kind, step):
    """Position and yaw of 2 s to 1e-9, ticks of 400 Hz within samples of 100 Hz, two substeps a tick."""
    target = np.array(STEPS[step])
    found = dj.simulate(study_of(kind, STEPS[step]), draw=0)

    def commands(position, psi):
        return 0.95 * (target[:3] - position), 2.8 * np.angle(np.exp(1j * (target[3] - psi)))

    expected = flight(SOFTWARE[kind], Craft(), commands, 0.01, 4, 8, 200)
    flown = np.stack([np.asarray(found[f"{name}_y"]) for name in ("x", "y", "z", "psi")], axis=1)
    difference = flown - expected
    difference[:, 3] = np.angle(np.exp(1j * difference[:, 3]))
    tilt, limited = float(found["tilt"].max()), float(found["rotor_limited"].max())
    print(f"\n{kind}, {step}: {np.abs(difference).max():.1e}; tilt {tilt:.2f} rad, rotors limited {limited:g}")
    assert np.abs(difference).max() < 1e-9
    assert np.abs(expected[-1, :3]).max() > 0.1


def test_frequency_must_divide_the_sample_and_the_substeps():
    """A clear refusal with the remedy, for a rate that does not divide T_s, and for ticks that split a substep."""
    with pytest.raises(ConfigError, match=r"plant\.inner_loop\.frequency: must be a whole multiple .* 100 Hz"):
        study_of("px4", STEPS["small"], frequency=250.0)
    with pytest.raises(ConfigError, match=r"plant\.inner_loop\.frequency: .* set loop\.substeps = 5"):
        study_of("crazyflie", STEPS["small"], frequency=500.0, substeps=4)
    with pytest.raises(ConfigError, match=r"gyro_cutoff: must be below frequency/2 = 25 Hz"):
        Px4Gains(frequency=50.0).prepare()


def test_px4_thrusts_must_be_in_order():
    """The least thrust above the largest one flew, and every draw failed."""
    study = study_of("px4", STEPS["small"])
    with pytest.raises(ConfigError, match=r"thrust_min: must be below thrust_max = 0.8, got up to 0.9"):
        study.override({"plant.inner_loop.thrust_min": 0.9, "plant.inner_loop.thrust_max": 0.8})
    with pytest.raises(ConfigError, match=r"inner_loop\.thrust_min: must be below thrust_max = 0.1, got up to 0.12"):
        study.override({"plant.inner_loop.thrust_max": {"uniform": [0.1, 0.5]}})
    with pytest.raises(ConfigError, match=r"sweep: plant\.inner_loop\.thrust_min: must be below thrust_max = 0.4"):
        study.override({"sweep.plant.inner_loop.thrust_min": [0.1, 0.5], "plant.inner_loop.thrust_max": 0.4})


def test_px4_parameters_become_the_table():
    """Factors multiply gains, degrees become radians, and what the file does not set keeps its default."""
    table = gains_from({"MC_ROLLRATE_P": 0.1, "MC_ROLLRATE_K": 2.0, "MC_YAWRATE_MAX": 90.0, "MPC_TILTMAX_AIR": 30.0})
    assert table["rate_p"] == [0.2, 0.15, 0.2]
    assert table["rate_i"] == [0.4, 0.2, 0.1]
    np.testing.assert_allclose(table["rate_max"], np.radians([220.0, 220.0, 90.0]), rtol=1e-15)
    np.testing.assert_allclose(table["tilt_max"], np.pi / 6.0, rtol=1e-15)
    assert set(table) == {"kind", "rate_p", "rate_i", "rate_d", "rate_max", "tilt_max"}


def test_what_assumes_the_article_s_inner_loop_refuses():
    """Linearisation and the proof of the vehicle name the inner loop, and what to choose instead."""
    study = study_of("px4", STEPS["small"])
    with pytest.raises(NotCovered, match=r"plant\.inner_loop is sampled"):
        require_inner_loop(Ends(study.template.plant, study.template.plant))
    meaning = declared_smoothness(UAV, study.template.plant).meaning
    assert "sampled inner loop" in meaning


def test_an_inverted_vehicle_is_turned_back():
    """Body z opposite to the desired one: all of the error is one half turn, here about roll."""
    study = study_of("px4", STEPS["small"])
    params = study.template.plant
    loop = params.inner_loop
    level = Readings(Vec3(0.0, 0.0, 0.0), Quaternion(1.0, 0.0, 0.0, 0.0), Vec3(0.0, 0.0, 0.0))
    state = loop.init(params.craft, level, params.first_carrying)
    for tilt in (0.0, 1e-3, -1e-3):
        rates = loop.rate_for(state, Quaternion(np.sin(tilt), np.cos(tilt), 0.0, 0.0))
        assert abs(float(rates.x)) == pytest.approx(2.0 * loop.attitude_p[0], rel=1e-5)
        np.testing.assert_allclose([float(rates.y), float(rates.z)], 0.0, atol=1e-3)
