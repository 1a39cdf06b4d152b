"""Where the integrals of inner loops start: hover without a fall, closed forms of the equilibrium, and refusals."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.models.uav import UAV
from dssc_jax.models.uav.inner_loops.sampled import Readings
from dssc_jax.models.uav.vehicle import GRAVITY
from tests.models.uav.cascades_by_hand import Craft, Px4
from tests.models.uav.test_cascades import VEHICLE

HEAVY = 1.15  # mass over the believed one
STRONG = 1.1  # thrust coefficient over the believed one
MASS = float(Craft.mass)
FULL = 4.0 * float(Craft.limit)
LACKING = HEAVY / STRONG - 1.0  # thrust that the believed hover lacks, in its units
INTEGRALS = {
    "px4": GRAVITY * LACKING,
    "crazyflie": MASS * GRAVITY * LACKING / FULL / (15.0 * 1000.0 / 65535.0),
    "article": GRAVITY * LACKING / 0.3,
}
"""I_z of the equilibrium: of an acceleration; of a share of the full thrust times the integral gain; of an acceleration
over the gain."""
ZERO = [0.0, 0.0, 0.0]


def study_of(kind, **inner):
    sampled = {} if kind == "article" else {"frequency": 400.0}
    gains = {"kp_velocity": 0.3} if kind == "article" else {}
    table = {
        "name": "hover",
        "draws": 1,
        "loop": {"duration": 0.5, "sample_time": 0.01, "substeps": 8},
        "plant": {
            "kind": "uav",
            "vehicle": {**VEHICLE, "mass": HEAVY * MASS, "thrust_coefficient": STRONG * VEHICLE["thrust_coefficient"]},
            "believed": {"mass": MASS, "thrust_coefficient": VEHICLE["thrust_coefficient"]},
            "inner_loop": {"kind": kind, **sampled, **gains, **inner},
        },
        "reference": {"kind": "zero"},
        "controller": {"kind": "pid", "k_p": 1.0},
    }
    return dj.Study.from_table(table)


@pytest.mark.parametrize("kind", INTEGRALS)
def test_a_settled_start_is_the_equilibrium(kind):
    """A vehicle with another mass and thrust than believed stays where it is; its integral is the closed form."""
    study = study_of(kind, start="settled")
    params = study.template.plant
    loop = params.inner_loop
    assert float(params.carrying_thrust) == pytest.approx(MASS * GRAVITY * (1.0 + LACKING), rel=1e-12)
    integral = loop.first_velocity_integral(params.craft, params.carrying_thrust)
    np.testing.assert_allclose(np.array(integral, float), [0.0, 0.0, INTEGRALS[kind]], rtol=1e-12)
    assert float(params.first_thrust) == pytest.approx(MASS * GRAVITY * (1.0 + LACKING), rel=1e-12)
    assert np.abs(dj.simulate(study, 0)["z_y"].values).max() < 1e-12


@pytest.mark.parametrize("kind", INTEGRALS)
def test_numbers_give_the_same_start(kind):
    """The closed form as a number: the same integral and rotors at the same speeds; added to a settled start, twice."""
    given = study_of(kind, velocity_integral=[0.1, 0.0, INTEGRALS[kind]]).template.plant
    settled = study_of(kind, start="settled", velocity_integral=[0.1, 0.0, 0.0]).template.plant
    for at in (UAV.init(given), UAV.init(settled)):
        np.testing.assert_allclose(np.array(at.speeds), hover_speed(1.0 + LACKING), rtol=1e-12)
    np.testing.assert_allclose(np.array(UAV.init(study_of(kind).template.plant).speeds), hover_speed(1.0), rtol=1e-12)
    twice = study_of(kind, start="settled", velocity_integral=[0.0, 0.0, INTEGRALS[kind]]).template.plant
    assert float(twice.first_thrust) == pytest.approx(MASS * GRAVITY * (1.0 + 2.0 * LACKING), rel=1e-12)


def hover_speed(lift):
    """Commanded speed of each rotor at a multiple of the believed weight [rad/s]."""
    return np.sqrt(lift * MASS * GRAVITY / 4.0 / VEHICLE["thrust_coefficient"])


def test_the_ground_lifts_a_settled_vehicle():
    """Near the ground thrust is 1/(1 - (R/(4 h))^2) times that far from it, and the integral carries less."""
    table = study_of("px4", start="settled").table
    plant = {**table["plant"], "ground": {"rotor_radius": 0.2}, "position": [0.0, 0.0, 0.3]}
    wanted = dj.Study.from_table({**table, "plant": plant}).template.plant.carrying_thrust
    share = 1.0 - (0.2 / (4.0 * 0.3)) ** 2
    assert float(wanted) == pytest.approx(MASS * GRAVITY * (1.0 + LACKING) * share, rel=1e-6)


def test_first_integrals_of_rates_are_the_first_torque():
    """In level flight without errors the cascade's torque is the integral, in the units of its mixer."""
    params = study_of("px4", rate_integral=[0.1, -0.05, 0.02]).template.plant
    level = Readings(Vec3(*ZERO), Quaternion(1.0, 0.0, 0.0, 0.0), Vec3(*ZERO))
    state = params.inner_loop.init(params.craft, level, MASS * GRAVITY)
    _, wrench = params.inner_loop.tick(params.craft, state, level, 1.0 / 400.0)
    unit = Px4(Craft(), np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])).unit
    np.testing.assert_allclose(np.array(wrench.moment, float), np.array([0.1, -0.05, 0.02]) * unit, rtol=1e-9)


def test_first_integrals_take_laws():
    """As any number: a value in place of the law is where the integral starts."""
    study = study_of("px4", velocity_integral=[0.0, 0.0, {"uniform": [0.5, 1.5]}])
    params = study.params({"plant.inner_loop.velocity_integral.2": 1.25}).plant
    assert float(UAV.init(params).inner.software.velocity_integral.z) == 1.25


BATTERY = {"capacity": 1e4, "resistance": 0.01, "full_voltage": 16.8, "empty_voltage": 13.2, "efficiency": 0.8}
ROTORS = [
    {"position": [0.1, -0.1, 0.0], "direction": -1.0, "thrust_coefficient": {"uniform": [1e-6, 2e-6]}},
    {"position": [-0.1, 0.1, 0.0], "direction": -1.0},
    {"position": [0.1, 0.1, 0.0], "direction": 1.0},
    {"position": [-0.1, -0.1, 0.0], "direction": 1.0},
]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"inner_loop": {"kind": "article", "start": "settled"}}, "with kp_velocity = 0 .* has none: set 'zero'"),
        ({"inner_loop": {"kind": "px4", "velocity_integral": [0.0]}}, "velocity_integral: needs three values, got 1"),
        ({"inner_loop": {"kind": "px4", "rate_integral": [0.0]}}, "rate_integral: needs three values"),
        ({"inner_loop": {"kind": "px4", "start": "settled"}, "battery": BATTERY}, "start: .*depends on a battery"),
        (
            {"inner_loop": {"kind": "px4", "start": "settled"}, "vehicle": {**VEHICLE, "rotor": ROTORS}},
            "start: .*rotors that differ from what is believed add a moment",
        ),
    ],
)
def test_a_start_without_a_known_equilibrium_is_refused(changes, words):
    table = study_of("px4").table
    with pytest.raises(ConfigError, match=words):
        dj.Study.from_table({**table, "plant": {"kind": "uav", "vehicle": VEHICLE, **changes}})
