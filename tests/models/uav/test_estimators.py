"""Estimators: against a dense filter in NumPy, without noise against the loop without one, and consistent."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

import dssc_jax as dj
from dssc_jax.core.smoothness import declared_smoothness
from dssc_jax.core.vectors import Quaternion, Vec3
from dssc_jax.engine.batching import Engine, evaluate
from dssc_jax.models.uav import UAV
from dssc_jax.models.uav.estimators.complementary import ComplementaryFilter
from dssc_jax.models.uav.estimators.kalman import KalmanFilter, KalmanMemory, normalised_square
from dssc_jax.models.uav.estimators.sensors import (
    Aids,
    Increments,
    Motion,
    Random,
    Sensors,
    rotation_of,
    rotation_vector,
)
from dssc_jax.models.uav.inner_loops.sampled import product
from dssc_jax.models.uav.vehicle import GRAVITY

G = np.array([0.0, 0.0, GRAVITY])
DT = 0.01
NOISY = {
    "gyro_noise": 0.003,
    "accel_noise": 0.03,
    "gyro_bias": 0.01,
    "accel_bias": 0.1,
    "gyro_walk": 1e-4,
    "accel_walk": 1e-3,
    "position": 0.3,
    "position_period": 10.0,
    "height": 0.2,
    "height_period": 5.0,
    "heading": 0.05,
    "heading_period": 5.0,
}
FIRST = {"initial_position": 0.5, "initial_velocity": 0.2, "initial_attitude": 0.05}


def skew(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


class DenseFilter:
    """The same filter with matrices, SciPy's rotations, a joint update, and Joseph's form."""

    def __init__(self, sensors, position, velocity, rotation, stds):
        self.sensors, self.p, self.v, self.r = sensors, position, velocity, rotation
        self.bg, self.ba = np.zeros(3), np.zeros(3)
        self.cov = np.diag(np.repeat(np.square(stds), 3))

    def step(self, increments, aids, delay):
        rotation = self.r.as_matrix()
        pushed = np.array(increments.velocity) - self.ba * DT
        shifted = np.array(increments.position) - 0.5 * self.ba * DT**2
        f = np.eye(15)
        drift = np.eye(15)
        drift[0:3, 3:6] = 0.5 * DT * np.eye(3)
        f[3:6, 6:9] = -skew(rotation @ pushed)
        f[3:6, 12:15] = f[6:9, 9:12] = -rotation * DT
        self.p = self.p + self.v * DT + rotation @ shifted - 0.5 * G * DT**2
        self.v = self.v + rotation @ pushed - G * DT
        self.r = self.r * Rotation.from_rotvec(np.array(increments.rotation) - self.bg * DT)
        s = self.sensors
        noise = np.repeat([0.0, s.accel_noise, s.gyro_noise, s.gyro_walk, s.accel_walk], 3)
        f = f @ drift
        self.cov = drift @ (f @ self.cov @ f.T + np.diag(noise**2 * DT)) @ drift.T
        rows, differences, stds = [], [], []
        if aids.has_position:
            h = np.zeros((3, 15))
            h[:, 0:3], h[:, 3:6] = np.eye(3), -delay * np.eye(3)
            rows += list(h)
            differences += list(np.array(aids.position) - self.p + self.v * delay)
            stds += [s.position] * 3
        if aids.has_height:
            rows.append(np.eye(15)[2])
            differences.append(aids.height - self.p[2])
            stds.append(s.height)
        if aids.has_heading:

            def heading(turn):
                r = (Rotation.from_rotvec(turn) * self.r).as_matrix()
                return math.atan2(r[1, 0], r[0, 0])

            h = np.zeros(15)
            h[6:9] = [(heading(1e-6 * e) - heading(-1e-6 * e)) / 2e-6 for e in np.eye(3)]
            rows.append(h)
            differences.append(aids.heading - heading(np.zeros(3)))
            stds.append(s.heading)
        if rows:
            h, noise = np.array(rows), np.diag(np.square(stds))
            gain = self.cov @ h.T @ np.linalg.inv(h @ self.cov @ h.T + noise)
            error = gain @ np.array(differences)
            left = np.eye(15) - gain @ h
            self.cov = left @ self.cov @ left.T + gain @ noise @ gain.T
            self.p, self.v = self.p + error[0:3], self.v + error[3:6]
            self.r = Rotation.from_rotvec(error[6:9]) * self.r
            self.bg, self.ba = self.bg + error[9:12], self.ba + error[12:15]


def test_filter_is_the_dense_one():
    """Estimate and covariance of 12 samples, with and without each sensor, to 1e-9 of their sizes."""
    rng = np.random.default_rng(4)
    sensors = Sensors(**NOISY)._replace(position_delay=5.0)
    stds = [0.5, 0.2, 0.05, sensors.gyro_bias, sensors.accel_bias]
    kalman = KalmanFilter(sensors, *stds[:3])
    start = Rotation.from_euler("ZYX", [2.5, 0.3, -0.4])
    x, y, z, w = start.as_quat()
    zero = Vec3(0.0, 0.0, 0.0)
    motion = Motion(Vec3(1.0, 2.0, 3.0), Vec3(0.5, -1.0, 0.2), Quaternion(w, x, y, z), zero)
    memory = kalman.start(motion, Random(jax.random.key(3)))
    rotation = np.array(memory.estimate.attitude)[[1, 2, 3, 0]]
    dense = DenseFilter(
        sensors, np.array(memory.estimate.position), np.array(memory.estimate.velocity), Rotation(rotation), stds
    )
    worst = 0.0
    for k in range(12):
        turn, push = 0.02 * rng.normal(size=3), start.inv().apply(G * DT) + 0.05 * rng.normal(size=3)
        increments = Increments(Vec3(*turn), Vec3(*push), Vec3(*(0.5 * DT * push)), zero)
        shown = dense.p + rng.normal(size=3)
        aids = Aids(Vec3(*shown), k % 3 == 0, dense.p[2] + 0.3, k % 2 == 0, 2.6, k % 4 < 2)
        memory = jax.tree.map(float, memory)
        memory = kalman.correct(kalman.predict(memory, increments, DT), aids, DT)
        dense.step(increments, aids, 5.0 * DT)
        worst = largest_difference(memory, dense)
        assert worst < 1e-9
    print(f"\nagainst the dense filter: {worst:.1e}")


def largest_difference(memory: KalmanMemory, dense):
    """Of the estimate, and of the covariance relative to the standard deviations."""
    pairs = [
        (memory.estimate.position, dense.p),
        (memory.estimate.velocity, dense.v),
        (memory.gyro_bias, dense.bg),
        (memory.accel_bias, dense.ba),
    ]
    differences = [np.abs(np.array(found) - expected).max() for found, expected in pairs]
    turned = Rotation(np.array(memory.estimate.attitude)[[1, 2, 3, 0]]) * dense.r.inv()
    differences.append(turned.magnitude())
    scale = np.sqrt(np.diag(dense.cov))
    for i, row in enumerate(memory.covariance):
        expected = dense.cov[i, : i + 1]
        differences.append((np.abs(np.array(row) - expected) / scale[i] / scale[: i + 1]).max())
    return max(differences)


def test_rotation_vectors_are_those_of_scipy():
    """Both directions, for small and large angles."""
    for size in (0.0, 1e-9, 1e-4, 0.3, 2.9):
        vector = size * np.array([0.6, -0.48, 0.64])
        q = rotation_of(Vec3(*vector))
        np.testing.assert_allclose(np.array(q)[[1, 2, 3, 0]], Rotation.from_rotvec(vector).as_quat(), atol=1e-15)
        np.testing.assert_allclose(np.array(rotation_vector(q)), vector, atol=1e-14)


def study_of(estimator, draws=1, **more):
    table = {
        "name": "estimated",
        "draws": draws,
        "loop": {"duration": 3.0, "sample_time": DT, "integrator": "euler"},
        "plant": {"kind": "uav", "estimator": estimator},
        "reference": {"kind": "hover", "position": [3.0, -2.0, 1.0], "yaw": 0.5},
        "controller": {"kind": "pid", "k_p": 0.6},
        "wind": {"kind": "constant", "x": 2.0, "y": 1.0, "z": 0.0},
    }
    return dj.Study.from_table(table | more)


def test_without_noise_the_loop_is_that_without_an_estimator():
    """Perfect sensors, each sample: every signal of the flight to 1e-12."""
    exact = dj.simulate(study_of({"kind": "none"}), draw=0)
    found = dj.simulate(study_of({"kind": "kalman"}), draw=0)
    worst = max(float(np.abs(exact[name] - found[name]).max()) for name in ("x_y", "y_y", "z_y", "psi_y", "tilt"))
    print(f"\nwithout noise: {worst:.1e}")
    assert worst < 1e-12
    assert "nees" not in exact
    assert float(found["position_estimate_error"].max()) < 1e-12


def test_covariance_is_consistent():
    """NEES of 200 flights within the 95 % band of chi-squared with 9 degrees of freedom, at three times."""
    times = (0.5, 1.5, 2.9)
    bounds = [{"signal": "nees", "metric": "max_abs", "after": t, "until": t + 0.5 * DT, "max": 1e9} for t in times]
    sensors = NOISY | {"gyro_walk": 0.0, "accel_walk": 0.0}
    study = study_of({"kind": "kalman", "sensors": sensors, **FIRST}, draws=200, requirement=bounds)
    result = evaluate(Engine(study, 200), {}, np.arange(200))
    assert not result["outcome"].any()
    low, high = chi2.ppf([0.025, 0.975], 9 * 200) / 200
    for t in times:
        (name,) = (name for name in result if name.startswith(f"max_abs_nees_after_{t:g}_"))
        mean = float(result[name].mean())
        print(f"\nNEES at {t:g} s: {mean:.2f}, band {low:.2f} to {high:.2f}")
        assert low < mean < high


def test_covariance_is_consistent_after_an_exact_start():
    """Of 200 flights: with 6 degrees of freedom at the first sample, where the velocity follows from the position."""
    freedoms = {1: 6, 2: 9, 3: 9, 5: 9}
    bounds = []
    for k in freedoms:
        around = {"after": (k - 0.5) * DT, "until": (k + 0.5) * DT}
        bounds.append({"signal": "nees", "metric": "max_abs", **around, "max": 1e9})
    study = study_of({"kind": "kalman", "sensors": NOISY}, draws=200, requirement=bounds)
    result = evaluate(Engine(study, 200), {}, np.arange(200))
    for k, degrees in freedoms.items():
        (name,) = (name for name in result if name.startswith(f"max_abs_nees_after_{(k - 0.5) * DT:g}_"))
        mean = float(result[name].mean())
        low, high = chi2.ppf([0.025, 0.975], degrees * 200) / 200
        print(f"\nNEES at sample {k}: {mean:.2f}, band {low:.2f} to {high:.2f}")
        assert low < mean < high


def test_nees_of_a_singular_covariance_is_that_of_its_pseudo_inverse():
    """Rank 6, at scales from 1e-6 to 1, for an error that the covariance admits."""
    rng = np.random.default_rng(5)
    factor = np.logspace(-6.0, 0.0, 9)[:, None] * rng.normal(size=(9, 6))
    weights = rng.normal(size=6)
    covariance = tuple(tuple(row[: i + 1]) for i, row in enumerate(factor @ factor.T))
    found = float(normalised_square(covariance, tuple(factor @ weights)))
    assert abs(found / weights.dot(weights) - 1.0) < 1e-6


def test_nees_has_no_peak_after_an_exact_start():
    """The covariance is singular for a sample, and has rank 3 where the bias of the accelerometers is all error."""
    for sensors in (NOISY, {"accel_bias": 0.05, "position": 0.3, "heading": 0.05}):
        flight = dj.simulate(study_of({"kind": "kalman", "sensors": sensors}), draw=0)
        values = flight["nees"].values
        assert values[0] == 0.0
        assert 0.0 < values[1:].max() < chi2.ppf(1.0 - 1e-6, 9)


def test_complementary_filter_finds_tilt_heading_and_bias():
    """At rest, from 0.1 rad off about each axis: errors decay as (s + 1)^2 = 0 says, and the bias is found."""
    filter_ = ComplementaryFilter(tilt_gain=2.0, heading_gain=2.0, bias_gain=1.0)
    x, y, z, w = Rotation.from_euler("ZYX", [1.0, 0.0, 0.0]).as_quat()
    zero = Vec3(0.0, 0.0, 0.0)
    motion = jax.tree.map(jnp.float64, Motion(zero, zero, Quaternion(w, x, y, z), zero))
    key = jax.random.key(0)
    memory = filter_.start(motion, Random(key))
    bias = Vec3(0.02, -0.03, 0.01)
    off = product(rotation_of(Vec3(0.1, 0.1, 0.1)), motion.attitude)
    memory = memory._replace(
        estimate=memory.estimate._replace(attitude=off), sensors=memory.sensors._replace(gyro_bias=bias)
    )

    @jax.jit
    def flown(memory):
        def step(memory, k):
            return filter_.step(memory, motion, Random(key), k, 0.02), None

        return jax.lax.scan(step, jax.tree.map(jnp.float64, memory), jnp.arange(1, 601))[0]

    end = flown(memory)
    turned = Rotation(np.array(end.estimate.attitude)[[1, 2, 3, 0]]) * Rotation.from_quat([x, y, z, w]).inv()
    found = np.array(end.gyro_bias)
    print(f"\nafter 12 s: {turned.magnitude():.1e} rad, bias within {np.abs(found - np.array(bias)).max():.1e} rad/s")
    assert turned.magnitude() < 1e-4
    np.testing.assert_allclose(found, np.array(bias), atol=1e-4)
    np.testing.assert_allclose(np.array(end.estimate.rate), 0.0, atol=1e-4)


def test_an_estimator_is_not_linearised():
    """The refusal names it, and the remedy."""
    study = study_of({"kind": "complementary"})
    assert "plant.estimator.kind = 'none'" in declared_smoothness(UAV, study.template.plant).meaning
