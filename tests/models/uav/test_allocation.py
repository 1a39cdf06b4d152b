"""Allocation: inverse of the geometry, limits, rotors that lose yaw."""

import itertools

import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.uav.allocation import allocate, geometry, pseudo_inverse
from dssc_jax.models.uav.rotors import circle_wrench
from dssc_jax.models.uav.vehicle import GRAVITY, HEXACOPTER, QUADROTOR

ZERO = Vec3(0.0, 0.0, 0.0)
TILTED = QUADROTOR._replace(rotor_angles=(0.25 * np.pi, 0.75 * np.pi, 1.25 * np.pi, 1.75 * np.pi))
GEOMETRIES = pytest.mark.parametrize(
    "vehicle", [QUADROTOR, TILTED, HEXACOPTER], ids=["quadrotor", "quadrotor_x", "hexacopter"]
)


@GEOMETRIES
def test_allocation_inverts_the_geometry(vehicle):
    inverse, limit = pseudo_inverse(vehicle), 2.0 * vehicle.mass * GRAVITY / vehicle.rotors
    angles = np.array(vehicle.rotor_angles)
    plain = np.stack(
        [
            np.ones(vehicle.rotors),
            vehicle.arm * np.sin(angles),  # p x e3 = (y, -x, 0)
            -vehicle.arm * np.cos(angles),
            vehicle.torque_coefficient * np.array(vehicle.spins),
        ]
    )
    gap_g = np.abs(geometry(vehicle) - plain).max()
    gap_p = np.abs(np.array(inverse) - np.linalg.pinv(plain)).max()
    rng = np.random.default_rng(1)
    worst, largest_gap = 0.0, 0.0
    for _ in range(50):
        thrust = vehicle.mass * GRAVITY * rng.uniform(0.8, 1.2)
        demand = np.array([thrust, *rng.uniform(-2.0, 2.0, 3)])
        thrusts = allocate(inverse, demand[0], Vec3(*demand[1:]), limit)
        assert not bool(thrusts.limited)
        total, moment, _ = circle_wrench(vehicle, thrusts.commanded)
        worst = max(worst, float(np.abs(np.array([total, *moment]) - demand).max()) / thrust)
        largest_gap = max(
            largest_gap, float(np.abs(np.array(thrusts.commanded) - np.linalg.lstsq(plain, demand)[0]).max())
        )
    print(f"\ngeometry {gap_g:.1e}, pinv {gap_p:.1e}, net(allocate) {worst:.1e}, least norm {largest_gap:.1e}")
    assert gap_g == 0.0 or gap_g < 1e-15
    assert gap_p < 1e-14
    assert worst < 1e-14
    assert largest_gap < 1e-12


@GEOMETRIES
def test_limits_are_kept_and_flagged(vehicle):
    """Beyond what the rotors can do, below zero thrust, and exactly at the limit, which is none yet."""
    inverse, limit = pseudo_inverse(vehicle), 2.0 * vehicle.mass * GRAVITY / vehicle.rotors
    cases = [
        (1.01 * vehicle.rotors * limit, ZERO, True),
        (0.99 * vehicle.rotors * limit, ZERO, False),
        (0.5 * vehicle.rotors * limit, Vec3(500.0, 0.0, 0.0), True),
        (10.0, Vec3(0.0, 20.0, 0.0), True),
        (-1.0, ZERO, True),
    ]
    for thrust, moment, limited in cases:
        found = allocate(inverse, thrust, moment, limit)
        forces = np.array(found.commanded)
        assert bool(found.limited) is limited
        assert forces.min() >= 0.0
        assert forces.max() <= limit
        if limited:
            assert forces.min() == 0.0 or forces.max() == limit


@pytest.mark.parametrize(
    ("vehicle", "spins"),
    [
        (QUADROTOR, (1.0, 1.0, -1.0, -1.0)),
        (QUADROTOR, (1.0, -1.0, -1.0, 1.0)),
        (QUADROTOR, (1.0, 1.0, 1.0, 1.0)),
        (HEXACOPTER, (-1.0,) * 6),
    ],
)
def test_rotors_that_lose_yaw_are_refused(vehicle, spins):
    with pytest.raises(ConfigError, match="rank 3") as caught:
        pseudo_inverse(vehicle._replace(spins=spins))
    print(f"\n{caught.value}")
    assert "\n" not in str(caught.value)


def test_every_balanced_hexacopter_keeps_yaw():
    """Unlike four rotors, six with three of each spin have yaw in any order: rank 4, and the inverse is one."""
    orders = [s for s in itertools.product((1.0, -1.0), repeat=6) if sum(s) == 0.0]
    assert len(orders) == 20
    for spins in orders:
        vehicle = HEXACOPTER._replace(spins=spins)
        np.testing.assert_allclose(geometry(vehicle) @ np.array(pseudo_inverse(vehicle)), np.eye(4), atol=1e-13)
