"""A start in the air in wind: the equilibrium beside SciPy's root of the balances, drift, and given attitudes."""

import numpy as np
import pytest
from scipy import optimize
from scipy.spatial.transform import Rotation

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError

WIND = np.array([-3.0, 6.0, -0.5])
YAW = 0.3
MASS, BELIEVED, GRAVITY = 2.3, 2.0, 9.81
STRUCTURE = np.array([0.05, 0.03, 0.02])
PROPELLER = 8.06428e-5
THRUST, TORQUE = 8.54858e-6, 0.016
RAISED = 0.058131
PLACES = np.array([[0.174, -0.174, RAISED], [-0.174, 0.174, RAISED], [0.174, 0.174, RAISED], [-0.174, -0.174, RAISED]])
SENSES = np.array([-1.0, -1.0, 1.0, 1.0])
LOOPS = {
    "px4": {"frequency": 400.0},
    "crazyflie": {"frequency": 500.0},
    "article": {"kp_velocity": 0.4},
    "article by norm": {"kp_velocity": 0.4, "thrust": "norm", "attitude": "rate_feed_forward"},
}


def study_of(loop, wind=WIND, start="settled", **plant):
    """An X500 with structure drag that hovers, heavier than believed."""
    constant = {"kind": "constant", "x": float(wind[0]), "y": float(wind[1]), "z": float(wind[2])}
    return dj.Study.from_table(
        {
            "name": "trim",
            "draws": 1,
            "loop": {"duration": 2.0, "sample_time": 0.01, "substeps": 20},
            "controller": {"kind": "pid", "k_p": 1.0},
            "reference": {"kind": "hover", "position": [0.0, 0.0, 0.0], "yaw": YAW},
            "wind": constant,
            "plant": {
                "kind": "uav",
                "yaw": YAW,
                "vehicle": {"kind": "x500", "mass": MASS, "structure_drag": STRUCTURE.tolist()},
                "believed": {"mass": BELIEVED},
                "inner_loop": {"kind": loop.split()[0], "start": start, **LOOPS[loop]},
                **plant,
            },
        }
    )


def lacking(unknowns, wind):
    """Sums of forces [N], inertial, and of moments [N m], body axes, for roll, pitch and speeds/1000 of four rotors."""
    attitude = Rotation.from_euler("ZYX", [YAW, unknowns[1], unknowns[0]]).as_matrix()
    speeds = 1000.0 * unknowns[2:]
    air = attitude.T @ -wind  # velocity relative to the air, body axes
    lift = THRUST * speeds**2
    force = np.array([0.0, 0.0, lift.sum()]) - STRUCTURE * np.linalg.norm(air) * air
    moment = np.array([0.0, 0.0, SENSES @ lift * TORQUE])
    for place, speed, f in zip(PLACES, speeds, lift, strict=True):
        part = -PROPELLER * speed * air
        force = force + part
        moment = moment + np.cross(place, part + np.array([0.0, 0.0, f]))
    return np.concatenate([attitude @ force - [0.0, 0.0, MASS * GRAVITY], 100.0 * moment])


def balance(wind):
    """Roll, pitch, and speeds of the rotors [rad/s] in the equilibrium."""
    found = optimize.root(lacking, [0.0, 0.0, 0.8, 0.8, 0.8, 0.8], args=(wind,), tol=1e-13)
    return found.x[0], found.x[1], 1000.0 * found.x[2:]


@pytest.mark.parametrize("loop", LOOPS)
def test_a_settled_start_is_the_equilibrium_in_the_wind(loop):
    """Tilt and rotors are the root of the balances; the vehicle stays, and so do its attitude and its rotors."""
    run = dj.simulate(study_of(loop), 0)
    roll, pitch, speeds = balance(WIND)
    assert abs(roll) > 0.03
    np.testing.assert_allclose([run["phi"].values[0], run["theta"].values[0]], [roll, pitch], atol=1e-11)
    np.testing.assert_allclose([run[f"rotor_speed_{i}"].values[0] for i in (1, 2, 3, 4)], speeds, rtol=1e-11)
    for axis in "xyz":
        assert np.abs(run[f"{axis}_y"].values).max() < 1e-11
    assert np.ptp(run["phi"].values) < 1e-11
    assert np.ptp(run["rotor_1"].values) < 1e-10


def test_no_wind_at_first_is_hover():
    """A wind that begins later leaves the vehicle level, and the equilibrium is that of still air."""
    table = study_of("px4").table
    late = dj.Study.from_table({**table, "wind": {**table["wind"], "at": 1.0}})
    still = dj.Study.from_table({name: value for name, value in table.items() if name != "wind"})
    early = slice(0, 100)
    for name in ("phi", "theta", "z_y", "rotor_1", "rotor_4"):
        one, other = (dj.simulate(study, 0)[name].values[early] for study in (late, still))
        np.testing.assert_allclose(one, other, atol=1e-11)


def test_turbulence_leaves_the_mean_wind():
    """Every draw of a turbulent wind starts in the equilibrium of its mean at the height."""
    altitude, speed, direction = 10.0, 6.0, 0.5
    mean = speed * np.log(altitude / (0.15 * 0.3048)) / np.log(20.0 / 0.15)
    table = study_of("px4").table
    dryden = {"kind": "dryden", "speed": speed, "altitude": altitude, "airspeed": 5.0, "direction": direction}
    study = dj.Study.from_table(
        {**table, "draws": 2, "wind": [dryden, {"kind": "constant", "x": 1.0, "y": 0.0, "z": 0.0}]}
    )
    wind = np.array([mean * np.cos(direction) + 1.0, mean * np.sin(direction), 0.0])
    roll, pitch, _ = balance(wind)
    for index in range(2):
        run = dj.simulate(study, index)
        np.testing.assert_allclose([run["phi"].values[0], run["theta"].values[0]], [roll, pitch], atol=1e-9)


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("start", ["zero", "settled"])
def test_a_given_attitude_and_body_rate_count(loop, start):
    """The first sample has them; numbers with laws, too."""
    law = {"uniform": [0.1, 0.2]}
    study = study_of(loop, start=start, roll=law, pitch=-0.1, body_rate=[0.3, {"normal": [0.0, 0.1]}, -0.2])
    run = dj.simulate(study, 0)
    expected = Rotation.from_euler("ZYX", [YAW, -0.1, run.attrs["plant.roll"]]).as_quat(scalar_first=True)
    found = [run[f"attitude_{part}"].values[0] for part in "wxyz"]
    np.testing.assert_allclose(found, expected, atol=1e-15)
    rates = [run[f"rate_{axis}"].values[0] for axis in "xyz"]
    np.testing.assert_allclose(rates, [0.3, run.attrs["plant.body_rate.1"], -0.2], atol=1e-15)


def test_a_level_start_is_the_default():
    """Zeros that are written out give the same bits as the default."""
    given = dj.simulate(study_of("px4", start="zero", roll=0.0, pitch=0.0, body_rate=[0.0, 0.0, 0.0]), 0)
    default = dj.simulate(study_of("px4", start="zero"), 0)
    for name in default.data_vars:
        np.testing.assert_array_equal(given[name].values, default[name].values)


def test_a_body_rate_of_two_values_is_refused():
    with pytest.raises(ConfigError, match="body_rate: needs three values, got 2"):
        study_of("px4", body_rate=[0.0, 0.1])
