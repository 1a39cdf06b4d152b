"""Rigid body, rotors, aerodynamics and allocation: conservation, equilibrium, closed forms, symmetry."""

import itertools
import math
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dssc_jax.errors import ConfigError
from dssc_jax.integrators import rk4
from dssc_jax.types import PlantInput
from dssc_jax.uav.aerodynamics import drag
from dssc_jax.uav.allocation import allocate, geometry, net, pseudo_inverse
from dssc_jax.uav.inner_loop import Integrals
from dssc_jax.uav.plant import UAV, UavParams, UavState
from dssc_jax.uav.rigid_body import BodyState, body_derivative, gyroscopic_torque
from dssc_jax.uav.vehicle import GRAVITY, HEXACOPTER, QUADROTOR, Vehicle, alternating
from dssc_jax.vectors import Mat3, Quaternion, Vec3, quaternion_from_euler

ZERO = Vec3(0.0, 0.0, 0.0)
INERTIA = Vec3(0.44, 0.61, 0.74)
HUB = 0.02  # I_z [kg m^2]: large, so that the rotors' share of the angular momentum counts
STEP, DURATION = 1e-3, 60.0


def rest(t):
    return 0.0 * t


def unequal(t):
    """Sum of signed speeds of rotors at 212, -187, 220, -198 rad/s."""
    return 47.0 + 0.0 * t


def varying(t):
    """The same, modulated rotor by rotor: the sum varies by some 60 rad/s, as when the rotors' speeds are commanded."""
    return 47.0 + 40.0 * jnp.sin(0.9 * t) - 25.0 * jnp.sin(2.3 * t + 0.4)


@partial(jax.jit, static_argnums=(0, 1))
def tumbled(spin, sign):
    """R (J Omega + I_z sum thetadot e3), energy of the body and |q| before normalisation, at each step of 1 ms."""

    def derivative(state, half_steps, t):
        now = t + 0.5 * STEP * half_steps
        total, rate = jax.jvp(spin, (now,), (jnp.ones_like(now),))
        torque = gyroscopic_torque(state.rate, HUB, total, rate) * sign
        return body_derivative(state, 10.9, INERTIA, 0.0, ZERO, torque, state.attitude.matrix())

    def body(state, k):
        t = k * STEP
        after = rk4(partial(derivative, t=t), state, STEP, ())
        after = after._replace(attitude=after.attitude.normalised())
        momentum = after.rate.scale(INERTIA) + Vec3(0.0, 0.0, HUB * spin(t + STEP))
        energy = 0.5 * after.rate.dot(after.rate.scale(INERTIA))
        return after, (jnp.stack(after.attitude.matrix() @ momentum), energy)

    first = BodyState(ZERO, ZERO, quaternion_from_euler(0.3, -0.2, 0.9), Vec3(1.0, -1.4, 0.6))
    first = jax.tree.map(jnp.float64, first)
    momentum = first.rate.scale(INERTIA) + Vec3(0.0, 0.0, HUB * spin(jnp.zeros(())))
    start = jnp.stack(first.attitude.matrix() @ momentum), 0.5 * first.rate.dot(first.rate.scale(INERTIA))
    end, series = jax.lax.scan(body, first, jnp.arange(round(DURATION / STEP), dtype=float))
    return start, series, end


@pytest.mark.parametrize("spin", [rest, unequal, varying])
def test_torque_free_tumbling_conserves_angular_momentum(spin):
    """Over 60 s at a step of 1 ms, to 1e-8 of its length; and the body turns by many revolutions meanwhile."""
    (momentum, energy), (momenta, energies), _ = tumbled(spin, 1.0)
    gap = float(jnp.max(jnp.linalg.norm(momenta - momentum, axis=1)) / jnp.linalg.norm(momentum))
    change = float(jnp.max(jnp.abs(energies / energy - 1.0)))
    print(f"\n{spin.__name__}: momentum {gap:.1e}, energy of the body {change:.1e}")
    assert gap < 1e-8
    if spin is rest:
        assert change < 1e-8
    if spin is unequal:  # a constant h e3 does no work
        assert change < 1e-8
    if spin is varying:
        assert change > 1e-2


@pytest.mark.parametrize("spin", [unequal, varying])
def test_the_printed_sign_does_not_conserve_it(spin):
    """Erratum 16: with tau_dist as printed the total angular momentum is not even nearly constant."""
    (momentum, _), (momenta, _), _ = tumbled(spin, -1.0)
    gap = float(jnp.max(jnp.linalg.norm(momenta - momentum, axis=1)) / jnp.linalg.norm(momentum))
    print(f"\n{spin.__name__}, printed sign: momentum changes by {gap:.2f} of its length")
    assert gap > 0.1


def test_tumbling_converges_at_order_four():
    """The conservation is the method's, not a coincidence: at 16 ms the defect is much larger than at 1 ms."""

    def defect(step):
        @jax.jit
        def end():
            def body(state, _):
                after = rk4(
                    lambda s, _: body_derivative(s, 10.9, INERTIA, 0.0, ZERO, ZERO, s.attitude.matrix()),
                    state,
                    step,
                    (),
                )
                return after._replace(attitude=after.attitude.normalised()), None

            first = BodyState(ZERO, ZERO, quaternion_from_euler(0.3, -0.2, 0.9), Vec3(1.0, -1.4, 0.6))
            first = jax.tree.map(jnp.float64, first)
            last, _ = jax.lax.scan(body, first, length=round(4.0 / step))
            return jnp.stack(last.attitude.matrix() @ last.rate.scale(INERTIA)), first

        found, first = end()
        return float(np.linalg.norm(found - np.array(first.attitude.matrix() @ first.rate.scale(INERTIA))))

    errors = [defect(step) for step in (0.08, 0.04, 0.02)]
    orders = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    print(f"\ndefects {errors}, orders {orders}")
    assert np.all(orders > 3.7)


def prepared(vehicle, **changes):
    return UAV.prepare(UavParams(vehicle, **changes))


@pytest.mark.parametrize("vehicle", [QUADROTOR, HEXACOPTER], ids=["quadrotor", "hexacopter"])
@pytest.mark.parametrize("lag", [None, 0.05], ids=["no_lag", "motor_lag"])
@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.9])
def test_hover_is_an_equilibrium(vehicle, lag, yaw):
    """Every derivative vanishes to 1e-12 in still air without commands: position, velocity, attitude, rotors."""
    params = prepared(vehicle._replace(motor_lag=lag), position=(3.0, -2.0, 5.0), yaw=yaw)
    drive = PlantInput((0.0,) * 4, (0.0,) * 4, ZERO)
    slope = UAV.derivative(params, UAV.init(params), drive, 0.0)
    worst = max(float(abs(leaf)) for leaf in jax.tree.leaves(slope))
    print(f"\nhover: largest derivative {worst:.1e}")
    assert worst < 1e-12
    moved = UAV.derivative(params, UAV.init(params), drive._replace(wind=Vec3(1.0, 0.0, 0.0)), 0.0)
    assert max(float(abs(leaf)) for leaf in jax.tree.leaves(moved)) > 1e-4


def fall(vehicle, speeds, duration, step, velocity=ZERO, turned=(0.0, 0.0, 0.0)):
    """Height lost and velocity after a fall without thrust: aerodynamics and rigid body, attitude held by no torque."""

    def derivative(state, _):
        rotation = state.attitude.matrix()
        air = drag(vehicle, rotation, state.rate, state.velocity, speeds)
        return body_derivative(state, vehicle.mass, vehicle.inertia, 0.0, air.force, ZERO, rotation)

    @jax.jit
    def run():
        first = BodyState(ZERO, velocity, quaternion_from_euler(*turned), ZERO)
        first = jax.tree.map(jnp.float64, first)
        end, _ = jax.lax.scan(lambda s, _: (rk4(derivative, s, step, ()), None), first, length=round(duration / step))
        return end

    return run()


def test_free_fall_is_a_parabola():
    vehicle = QUADROTOR._replace(structure_drag=(0.0, 0.0, 0.0))
    end = fall(vehicle, (0.0,) * 4, 3.0, 0.01, Vec3(2.0, -1.0, 4.0))
    wanted = [6.0, -3.0, 12.0 - 0.5 * GRAVITY * 9.0, 2.0, -1.0, 4.0 - GRAVITY * 3.0]
    found = np.array([*end.position, *end.velocity])
    print(f"\nfree fall: {np.abs(found - wanted).max():.1e}")
    np.testing.assert_allclose(found, wanted, rtol=1e-13, atol=1e-12)


@pytest.mark.parametrize(("turned", "axis"), [((0.0, 0.0, 0.0), 2), ((0.5 * np.pi, 0.0, 0.0), 1)], ids=["flat", "side"])
def test_fall_against_structure_drag(turned, axis):
    """v = -v_t tanh(g t/v_t) and z = -(v_t^2/g) ln cosh(g t/v_t), v_t = (M g/K)^(1/2) of the falling axis."""
    vehicle = QUADROTOR._replace(structure_drag=(0.5, 0.4, 0.3))
    terminal = math.sqrt(vehicle.mass * GRAVITY / vehicle.structure_drag[axis])
    gaps = []
    for duration in (1.5, 40.0):
        end = fall(vehicle, (0.0,) * 4, duration, 0.01, turned=turned)
        v = -terminal * math.tanh(GRAVITY * duration / terminal)
        z = -(terminal**2) / GRAVITY * math.log(math.cosh(GRAVITY * duration / terminal))
        gaps += [abs(float(end.velocity.z) / v - 1.0), abs(float(end.position.z) / z - 1.0)]
    print(
        f"\nfall with drag: relative {max(gaps):.1e}; terminal speed {terminal:.3f} m/s, reached {end.velocity.z:.9f}"
    )
    assert max(gaps) < 1e-9
    assert float(end.velocity.z) == pytest.approx(-terminal, rel=1e-9)


def test_fall_against_propeller_drag():
    """Linear in v: v = -v_t (1 - exp(-t/tau)), tau = M/(K_Fdi sum |thetadot_i|), v_t = g tau."""
    vehicle = QUADROTOR._replace(structure_drag=(0.0, 0.0, 0.0), propeller_drag=0.02)
    speeds = (200.0, 150.0, 180.0, 230.0)
    tau = vehicle.mass / (vehicle.propeller_drag * sum(speeds))
    end = fall(vehicle, speeds, 2.0, 0.005)
    wanted = -GRAVITY * tau * (1.0 - math.exp(-2.0 / tau))
    print(f"\npropeller drag: relative {abs(float(end.velocity.z) / wanted - 1.0):.1e}")
    assert float(end.velocity.z) == pytest.approx(wanted, rel=1e-9)


def test_drag_equals_the_sums_of_appendix_a():
    """Rotor by rotor in plain NumPy, for irregular rotor positions, speeds and attitudes."""
    rng = np.random.default_rng(4)
    worst = 0.0
    for trial in range(12):
        rotors = 4 + trial % 4
        vehicle = QUADROTOR._replace(
            rotor_angles=tuple(rng.uniform(-np.pi, np.pi, rotors)),
            spins=alternating(rotors),
            structure_drag=tuple(rng.uniform(0.01, 0.5, 3)),
            propeller_drag=rng.uniform(1e-6, 1e-2),
            arm=rng.uniform(0.2, 1.0),
        )
        at = Rotation.random(random_state=rng).as_matrix()
        omega, v_r, speeds = rng.normal(size=3), 10.0 * rng.normal(size=3), rng.uniform(50.0, 300.0, rotors)
        force = -at @ np.diag(vehicle.structure_drag) @ at.T @ v_r * np.linalg.norm(v_r)
        torque = np.zeros(3)
        for angle, speed in zip(vehicle.rotor_angles, speeds, strict=True):
            p = vehicle.arm * np.array([np.cos(angle), np.sin(angle), 0.0])
            f_i = -vehicle.propeller_drag * speed * (v_r + at @ np.cross(omega, p))
            force = force + f_i
            torque = torque + np.cross(p, at.T @ f_i)
        found = drag(vehicle, Mat3(*(Vec3(*row) for row in at)), Vec3(*omega), Vec3(*v_r), tuple(speeds))
        for got, wanted in ((found.force, force), (found.torque, torque)):
            worst = max(worst, float(np.abs(np.array(got) - wanted).max() / np.linalg.norm(wanted)))
    print(f"\ndrag against Appendix A: {worst:.1e}")
    assert worst < 1e-13


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
    worst, least = 0.0, 0.0
    for _ in range(50):
        thrust = vehicle.mass * GRAVITY * rng.uniform(0.8, 1.2)
        wanted = np.array([thrust, *rng.uniform(-2.0, 2.0, 3)])
        thrusts = allocate(inverse, wanted[0], Vec3(*wanted[1:]), limit)
        assert not bool(thrusts.limited)
        total, moment = net(vehicle, thrusts.each)
        worst = max(worst, float(np.abs(np.array([total, *moment]) - wanted).max()) / thrust)
        least = max(least, float(np.abs(np.array(thrusts.each) - np.linalg.lstsq(plain, wanted)[0]).max()))
    print(f"\ngeometry {gap_g:.1e}, pinv {gap_p:.1e}, net(allocate) {worst:.1e}, least norm {least:.1e}")
    assert gap_g == 0.0 or gap_g < 1e-15
    assert gap_p < 1e-14
    assert worst < 1e-14
    assert least < 1e-12


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
        each = np.array(found.each)
        assert bool(found.limited) is limited
        assert each.min() >= 0.0
        assert each.max() <= limit
        if limited:
            assert each.min() == 0.0 or each.max() == limit


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


def some_state(rng, speeds):
    rotation = Rotation.from_euler("ZYX", rng.uniform(-1.0, 1.0, 3) * [3.0, 0.6, 0.6]).as_quat()
    draws = [Vec3(*(scale * rng.normal(size=3))) for scale in (20.0, 5.0, 1.0, 0.3)]
    attitude = Quaternion(rotation[3], *rotation[:3])
    yaw_integral = rng.normal()
    return UavState(draws[0], draws[1], attitude, draws[2], Integrals(draws[3], yaw_integral), speeds)


def some_vehicle(rng, rotors, lag):
    base: Vehicle = QUADROTOR if rotors == 4 else HEXACOPTER
    return base._replace(
        body_inertia=(0.4, 0.55, 0.74),
        rotor_inertia_z=0.003,
        structure_drag=(0.03, 0.07, 0.015),
        propeller_drag=1e-3,
        motor_lag=lag,
        rotor_angles=tuple(np.array(base.rotor_angles) + 0.2 * rng.uniform(-1.0, 1.0, rotors)),
    )


def flat(state):
    return np.array([float(leaf) for leaf in jax.tree.leaves(state)])


def relative(found, wanted):
    return float(np.max(np.abs(found - wanted) / np.maximum(np.abs(wanted), 1.0)))


CASES = pytest.mark.parametrize(("rotors", "lag"), [(4, None), (4, 0.05), (6, None), (6, 0.05)])


@CASES
def test_yaw_rotation_of_the_plant_rotates_its_derivative(rotors, lag):
    """Turned position, velocity, heading, integrals, commands and wind about z: every derivative turns with them."""
    rng = np.random.default_rng(rotors)
    worst = 0.0
    for angle in (0.4, 2.0, -3.0):
        params = prepared(some_vehicle(rng, rotors, lag))
        c, s = math.cos(angle), math.sin(angle)

        def turn(v, c=c, s=s):
            return Vec3(c * v.x - s * v.y, s * v.x + c * v.y, v.z)

        def turn_q(q, angle=angle):
            a, b = math.cos(0.5 * angle), math.sin(0.5 * angle)
            return Quaternion(a * q.w - b * q.z, a * q.x - b * q.y, a * q.y + b * q.x, a * q.z + b * q.w)

        def turn_state(x, turn=turn, turn_q=turn_q):
            integrals = Integrals(turn(x.integrals.velocity), x.integrals.yaw)
            return x._replace(
                position=turn(x.position), velocity=turn(x.velocity), attitude=turn_q(x.attitude), integrals=integrals
            )

        state = some_state(rng, tuple(rng.uniform(80.0, 130.0, rotors)) if lag else ())
        command, disturbance, wind = (Vec3(*rng.normal(size=3)) for _ in range(3))
        plain = PlantInput((*command, 0.3), (*disturbance, -0.1), wind * 5.0)
        turned = PlantInput((*turn(command), 0.3), (*turn(disturbance), -0.1), turn(wind * 5.0))
        wanted = turn_state(UAV.derivative(params, state, plain, 0.0))
        found = UAV.derivative(params, turn_state(state), turned, 0.0)
        worst = max(worst, relative(flat(found), flat(wanted)))
    print(f"\nyaw equivariance, {rotors} rotors, lag {lag}: {worst:.1e}")
    assert worst < 1e-11


@CASES
def test_mirrored_plant_has_the_mirrored_derivative(rotors, lag):
    """y -> -y, psi -> -psi, rotor angles and spins -> their negatives: axial vectors with the other sign."""
    rng = np.random.default_rng(10 + rotors)
    worst = 0.0

    def polar(v):
        return Vec3(v.x, -v.y, v.z)

    def axial(v):
        return Vec3(-v.x, v.y, -v.z)

    def mirrored(x):
        return UavState(
            polar(x.position),
            polar(x.velocity),
            Quaternion(x.attitude.w, -x.attitude.x, x.attitude.y, -x.attitude.z),
            axial(x.rate),
            Integrals(polar(x.integrals.velocity), -x.integrals.yaw),
            x.speeds,
        )

    for _ in range(4):
        vehicle = some_vehicle(rng, rotors, lag)
        other = vehicle._replace(
            rotor_angles=tuple(-a for a in vehicle.rotor_angles), spins=tuple(-s for s in vehicle.spins)
        )
        state = some_state(rng, tuple(rng.uniform(80.0, 130.0, rotors)) if lag else ())
        command, wind = Vec3(*rng.normal(size=3)), Vec3(*(5.0 * rng.normal(size=3)))
        zero = (0.0,) * 4
        plain = UAV.derivative(prepared(vehicle), state, PlantInput((*command, 0.3), zero, wind), 0.0)
        drive = PlantInput((*polar(command), -0.3), zero, polar(wind))
        found = UAV.derivative(prepared(other), mirrored(state), drive, 0.0)
        worst = max(worst, relative(flat(found), flat(mirrored(plain))))
        same_spins = prepared(other._replace(spins=vehicle.spins))
        assert relative(flat(UAV.derivative(same_spins, mirrored(state), drive, 0.0)), flat(mirrored(plain))) > 1e-6
    print(f"\nmirror, {rotors} rotors, lag {lag}: {worst:.1e}")
    assert worst < 1e-12
