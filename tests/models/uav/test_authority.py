"""What the rotors of a vehicle can command, against the null space and hover thrusts that NumPy gives."""

import math

import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.models.uav.airframe import read_airframe
from dssc_jax.models.uav.allocation import flying_allocation, pseudo_inverse
from dssc_jax.models.uav.authority import dependent_axes, largest_accelerations
from dssc_jax.models.uav.parameters import UavParams, prepare
from dssc_jax.models.uav.vehicle import HEXACOPTER, QUADROTOR, Rotor
from tests.models.uav.test_airframe import HEX_PLACES, rotor_lines

TILT = 0.3  # rad


def tilted_alike(tilt):
    """Four rotors that all turn the same way, each tilted across its arm."""
    rotors = []
    for angle in (0.25 * math.pi, 0.75 * math.pi, 1.25 * math.pi, 1.75 * math.pi):
        sign = 1.0 if math.cos(angle) * math.sin(angle) > 0.0 else -1.0
        axis = (-sign * math.sin(angle) * math.sin(tilt), sign * math.cos(angle) * math.sin(tilt), math.cos(tilt))
        rotors.append(Rotor((0.3 * math.cos(angle), 0.3 * math.sin(angle), 0.0), axis, 1.0, None, 0.02))
    return QUADROTOR._replace(rotor=tuple(rotors))


@pytest.mark.parametrize(
    ("matrix", "dependent"),
    [
        ([[1, 1, 1, 1], [1, 1, -1, -1], [1, -1, 1, -1], [1, -1, -1, 1]], []),
        ([[1, 1, 1, 1], [1, 1, -1, -1], [1, -1, 1, -1], [2, 2, 2, 2]], ["thrust", "yaw"]),
        ([[1, 1, 1, 1], [1, 1, -1, -1], [1, -1, 1, -1], [0, 0, 0, 0]], ["yaw"]),
        ([[1, 1, 1, 1], [1, 1, -1, -1], [0, 0, 0, 0], [1, -1, -1, 1]], ["pitch"]),
        ([[1, 1, 1, 1], [1, 1, -1, -1], [1, -1, 1, -1], [1, 0, 0, -1]], ["roll", "pitch", "yaw"]),
        ([[1, 1, 1, 1], [1, 1, -1, -1], [-2, -2, 2, 2], [1, 1, -1, -1]], ["roll", "pitch", "yaw"]),
    ],
)
def test_dependent_axes_take_part_in_the_left_null_space(matrix, dependent):
    assert dependent_axes(np.array(matrix, float)) == dependent


def quad_script(axes=(-1, -1, -1, -1), moments=(0.05, 0.05, -0.05, -0.05)):
    """A quadrotor of PX4 whose axes and spins are chosen."""
    text = rotor_lines([(0.17, 0.17), (-0.17, -0.17), (0.17, -0.17), (-0.17, 0.17)], moments)
    return text + "".join(f"\nparam set CA_ROTOR{i}_AZ {az}" for i, az in enumerate(axes))


@pytest.mark.parametrize(
    ("script", "place", "rule"),
    [
        (quad_script((-1, -1, 1, -1)), "CA_ROTORi_PX, _PY, _PZ, _AX", "hover needs -4.9 N of CA_ROTOR2, and a rotor"),
        (quad_script((-1, -1, 1, -1)), "CA_ROTORi_PX", "its axis points down; that of a rotor that lifts points up"),
        (quad_script((1, 1, 1, 1)), "CA_ROTORi_PX", "all axes point down"),
        (quad_script(moments=(0.05, 0.05, 0.04, 0.05)), "CA_ROTORi", "hover needs -"),
        (quad_script(moments=(0.05, 0.05, -0.05, 0.05)), "CA_ROTORi", "hover needs 0 N of CA_ROTOR0, 0 N of CA_ROTOR1"),
        (quad_script(moments=(0.05, -0.05, 0.05, -0.05)), "CA_ROTORi_KM", "neighbours turn opposite ways"),
        (quad_script(moments=(0, 0, 0, 0)), "CA_ROTORi_KM", "cannot command yaw (rank 3 of 4)"),
        (rotor_lines([(0.2, y) for y in (-0.3, -0.1, 0.1, 0.3)], (0.05, -0.05, -0.05, 0.05)), "CA_ROTORi_PX", "pitch"),
    ],
)
def test_airframes_that_cannot_fly_are_refused_in_px4s_names(script, place, rule):
    with pytest.raises(ConfigError) as refusal:
        read_airframe(script, mass=2.0)
    assert place in refusal.value.where
    assert rule in refusal.value.rule


def test_a_flipped_rotor_of_six_is_found():
    """Six rotors keep rank 4 when one is flipped; the pseudo-inverse then pulls with it."""
    places = [(0.3 * x, 0.3 * y) for x, y in HEX_PLACES]
    script = rotor_lines(places, [0.05, -0.05, 0.05, -0.05, 0.05, -0.05]) + "\nparam set CA_ROTOR4_AZ 1"
    with pytest.raises(ConfigError, match=r"-3\.27 N of CA_ROTOR4"):  # of 2 kg: -2 * 9.81 / 6
        read_airframe(script, mass=2.0)


def test_rotors_that_turn_alike_fly_when_they_are_tilted():
    """Tilted across their arms in turn, rotors of one spin hold the yaw with what their axes give."""
    vehicle = tilted_alike(TILT)
    inverse = np.array(flying_allocation(vehicle))
    columns = []
    for rotor in vehicle.rotor:
        axis = np.array(rotor.axis)
        columns.append([axis[2], *(np.cross(rotor.position, axis) + 0.02 * axis)])
    assert np.allclose(np.array(columns).T @ inverse, np.eye(4), atol=1e-12)
    assert np.all(inverse[:, 0] > 0.0)
    with pytest.raises(ConfigError, match="thrust and yaw independently"):
        pseudo_inverse(tilted_alike(0.0))


def test_a_study_refuses_what_cannot_hover():
    flipped = [
        rotor._replace(axis=(0.0, 0.0, -1.0)) if i == 1 else rotor for i, rotor in enumerate(tilted_alike(TILT).rotor)
    ]
    with pytest.raises(ConfigError, match=r"vehicle.rotor: hover needs -\S+ N of rotor.1.*points down"):
        prepare(UavParams(QUADROTOR._replace(rotor=tuple(flipped))))
    moved = [
        rotor._replace(position=(0.1 + rotor.position[0], *rotor.position[1:])) for rotor in tilted_alike(TILT).rotor
    ]
    params = UavParams(QUADROTOR._replace(rotor=tuple(moved), max_thrust=30.0))
    with pytest.raises(ConfigError, match=r"vehicle\.max_thrust: hover needs"):
        prepare(params)


def test_uneven_circles_start_in_hover():
    """Rotors on a circle, but not evenly spaced: the thrusts at the start carry the weight without a moment."""
    vehicle = HEXACOPTER._replace(rotor_angles=(0.1, 1.2, 2.0, 3.1, 4.1, 5.2))
    thrusts = np.array(prepare(UavParams(vehicle)).hover_thrusts)
    angles = np.array(vehicle.rotor_angles)
    sums = [np.sum(row * thrusts) for row in (np.ones(6), np.cos(angles), np.sin(angles), np.array(vehicle.spins))]
    assert np.allclose(sums, [vehicle.mass * 9.81, 0.0, 0.0, 0.0], atol=1e-9)
    assert np.ptp(thrusts) > 1.0


def test_largest_accelerations_of_a_cross_by_hand():
    """Four rotors with hover at half of the largest thrust: pitch by two rotors, yaw by all four."""
    vehicle = QUADROTOR._replace(rotor_inertia_xy=0.0, rotor_inertia_z=0.0)
    share = 10.9 * 9.81 / 4.0
    found = largest_accelerations(vehicle, np.array(pseudo_inverse(vehicle)))
    assert found["pitch"] == pytest.approx(2.0 * share * 0.57 / 0.4)
    assert found["yaw"] == pytest.approx(4.0 * share * 0.57 / 0.74)
