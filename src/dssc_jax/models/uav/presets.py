"""Vehicles that people fly, each number with its source; a number without a source is marked as estimated.

References:
    [1] E. V. L. Nunes et al., the article's Section V-B (the package's ``m600_quadrotor``).
    [2] DJI, Matrice 600 Pro, specifications: diagonal wheelbase 1133 mm, propellers 2170R (21 inch), weight with six
        TB48S batteries 10 kg, largest take-off weight 15.5 kg.
    [3] Bitcraze, Crazyflie 2.1, datasheet: take-off weight 27 g, 92 mm from motor to motor.
    [4] J. Foerster, System Identification of the Crazyflie 2.0 Nano Quadrocopter, ETH Zurich, 2015: inertia, thrust and
        torque of its rotors, drag proportional to speed and rotor speeds; as in Bitcraze's firmware
        (``physicalConstants``) and in gym-pybullet-drones (3.16e-10 N/rpm^2).
    [5] PX4's Gazebo models ``x500_base`` and ``x500``: masses, inertia, places, motorConstant, momentConstant,
        rotorDragCoefficient, maxRotVelocity and time constants.
    [6] L. Bauersfeld et al., NeuroBEM, Robotics: Science and Systems, 2021: 752 g, static thrust of about 33 N, motors
        of 33 ms, inertia in its data set; a frame of 250 mm.
    [7] The parameters of the same vehicle in Flightmare (``quadrotor_dynamics``) and Agilicious: places of the motors,
        thrust map, kappa, motor inertia.
"""

import math

from dssc_jax.core.contracts import Preset
from dssc_jax.core.registry import Registry, single
from dssc_jax.models.uav.vehicle import HEXACOPTER, QUADROTOR, Rotor, Vehicle, alternating, ring

M600 = Vehicle(
    mass=10.0,  # [2]
    body_inertia=(0.4, 0.4, 0.74),  # [1], of a body of 10.9 kg
    rotor_inertia_xy=0.01,  # [1]
    rotor_inertia_z=7e-4,  # estimated: two blades of 20 g, 27 cm long
    thrust_coefficient=2.8e-4,  # estimated: C_T = 0.112 of a propeller of 21 inch
    torque_coefficient=0.02,  # estimated: 4 % of the propeller's diameter
    arm=0.5665,  # [2]
    structure_drag=(0.03, 0.03, 0.015),  # [1]
    propeller_drag=8e-6,  # [1]
    rotor_angles=ring(6),
    spins=alternating(6),
    max_thrust=50.0,  # estimated: twice the largest take-off weight [2]
    motor_lag=0.05,  # estimated
)
"""DJI's Matrice 600 Pro, the hexacopter of the article's field test, with a front arm along body x (estimated)."""

CRAZYFLIE21 = Vehicle(
    mass=0.027,  # [3]
    body_inertia=(1.6571710e-5, 1.6655602e-5, 2.9261652e-5),  # [4]
    rotor_inertia_xy=0.0,  # part of [4]'s inertia
    rotor_inertia_z=0.0,  # no source; left out
    thrust_coefficient=2.8815e-8,  # [4]: 3.16e-10 N/rpm^2
    torque_coefficient=0.005964552,  # [4]
    arm=0.046,  # [3]
    structure_drag=(0.0, 0.0, 0.0),  # [4] has none
    propeller_drag=9.1785e-7,  # [4] along x and y; 1.0311e-6 along z
    rotor_angles=tuple(math.radians(angle) for angle in (-45.0, -135.0, 135.0, 45.0)),
    spins=(-1.0, 1.0, -1.0, 1.0),  # PX4's airframe 4901
    max_thrust=0.159166331,  # [4]: a + b of the thrust at full PWM
    motor_lag=0.03,  # estimated
)
"""Bitcraze's Crazyflie 2.1."""

RAISED = 0.058131
"""Height of the x500's rotors over its centre of mass [m]: 0.06 m over the body's [5], less 4 m_rotor/M of it."""

X500 = Vehicle(
    mass=2.0643077,  # [5]: the body and four rotors
    body_inertia=(0.0238379, 0.0238379, 0.0438940),  # [5]: the body, and the rotors' masses at their places
    rotor_inertia_xy=1.325e-5,  # [5]: mean of the two transverse ones
    rotor_inertia_z=2.649858e-5,  # [5]
    thrust_coefficient=8.54858e-6,  # [5]
    torque_coefficient=0.016,  # [5]
    arm=0.2460732,  # of the places below; without effect beside them
    structure_drag=(0.0, 0.0, 0.0),  # [5] has none
    propeller_drag=8.06428e-5,  # [5]; there it acts across the axis only
    rotor_angles=(),
    spins=(),
    max_thrust=8.54858,  # [5]: at 1000 rad/s
    motor_lag=0.01875,  # [5]: 0.0125 s up, 0.025 s down
    rotor=(
        Rotor((0.174, -0.174, RAISED), direction=-1.0),
        Rotor((-0.174, 0.174, RAISED), direction=-1.0),
        Rotor((0.174, 0.174, RAISED), direction=1.0),
        Rotor((-0.174, -0.174, RAISED), direction=1.0),
    ),
)
"""Holybro's X500 as PX4 simulates it in Gazebo."""

RACER250 = Vehicle(
    mass=0.752,  # [6]
    body_inertia=(0.0025, 0.0021, 0.0043),  # [6]
    rotor_inertia_xy=0.0,  # part of [6]'s inertia
    rotor_inertia_z=5.64e-6,  # [7]
    thrust_coefficient=1.562522e-6,  # [7]
    torque_coefficient=0.022,  # [7]
    arm=0.125,  # of the places below; without effect beside them
    structure_drag=(0.01, 0.01, 0.02),  # estimated: 160 cm^2 from the front, twice that from above
    propeller_drag=5e-5,  # estimated: 0.2 N s/m at hover
    rotor_angles=(),
    spins=(),
    max_thrust=8.5,  # [7]; [6] has 33 N in all
    motor_lag=0.033,  # [6]
    rotor=(
        Rotor((0.075, -0.10, 0.0), direction=-1.0),
        Rotor((-0.075, 0.10, 0.0), direction=-1.0),
        Rotor((0.075, 0.10, 0.0), direction=1.0),
        Rotor((-0.075, -0.10, 0.0), direction=1.0),
    ),
)
"""A racer of 250 mm, that of NeuroBEM and Agilicious."""

VEHICLES: Registry = {
    "m600_quadrotor": single(Preset(Vehicle, QUADROTOR), "the article's simulated quadrotor"),
    "m600_hexacopter": single(Preset(Vehicle, HEXACOPTER), "the same with six rotors"),
    "m600": single(Preset(Vehicle, M600), "DJI Matrice 600 Pro, 10 kg, six rotors"),
    "crazyflie21": single(Preset(Vehicle, CRAZYFLIE21), "Bitcraze Crazyflie 2.1, 27 g"),
    "x500": single(Preset(Vehicle, X500), "Holybro X500 as in PX4's Gazebo, 2.06 kg"),
    "racer250": single(Preset(Vehicle, RACER250), "racer of 250 mm, 0.75 kg (NeuroBEM, Agilicious)"),
}
"""The vehicles that a study names."""
