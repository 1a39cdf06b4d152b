"""Vectors, matrices and quaternions of scalars against NumPy and SciPy's Rotation, and Euler angles read off them."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from dssc_jax.core.vectors import Mat3, Quaternion, Vec3, quaternion_from_euler
from dssc_jax.models.uav.inner_loops.article import Trig, euler_of, euler_rates, trig_of

EULER = [
    (0.0, 0.0, 0.0),
    (0.3, -0.4, 0.7),
    (-1.2, 1.1, 3.0),
    (0.7, -1.4, -2.9),
    (-2.8, 0.6, -1.7),
    (1.4, 0.2, np.pi / 4),
]


def quaternion_of(rotation):
    x, y, z, w = rotation.as_quat()
    return Quaternion(w, x, y, z)


def turned(phi, theta, psi):
    """R_z(psi) R_y(theta) R_x(phi) of SciPy: intrinsic z, y', x''."""
    return Rotation.from_euler("ZYX", [psi, theta, phi])


def test_vectors_and_matrices_equal_numpy():
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(20):
        a, b, m = rng.normal(size=3), rng.normal(size=3), rng.normal(size=(3, 3))
        factor = rng.normal()
        u, v = Vec3(*a), Vec3(*b)
        matrix = Mat3(*(Vec3(*row) for row in m))
        pairs = [
            (u + v, a + b),
            (u - v, a - b),
            (-u, -a),
            (u * factor, a * factor),
            (factor * u, a * factor),
            (u / factor, a / factor),
            (u.dot(v), a @ b),
            (u.cross(v), np.cross(a, b)),
            (u.scale(v), a * b),
            (u.over(v), a / b),
            (u.norm(), np.linalg.norm(a)),
            (matrix @ u, m @ a),
            (matrix.transpose @ u, m.T @ a),
            (matrix.transpose, m.T),
        ]
        for found, expected in pairs:
            gap = np.max(np.abs(np.array(found) - expected) / np.maximum(np.abs(expected), 1.0))
            worst = max(worst, float(gap))
    print(f"\nvectors and matrices: {worst:.1e}")
    assert worst < 1e-14


def test_products_with_known_zeros_equal_numpy():
    """Of two vectors with any of their components 0: plain numbers, and traced ones beside plain zeros."""
    a, b = np.array([1.3, -0.7, 2.1]), np.array([-0.4, 1.9, 0.8])
    for mask in itertools.product((0.0, 1.0), repeat=6):
        left, right = a * mask[:3], b * mask[3:]
        expected = np.cross(left, right), left * right
        u = Vec3(*(jnp.asarray(value) if value else 0.0 for value in left))
        v = Vec3(*(float(value) for value in right))
        for found in ((u.cross(v), u.scale(v)), (Vec3(*left).cross(v), Vec3(*left).scale(v))):
            np.testing.assert_allclose(np.array(found, float), expected, rtol=1e-15, atol=1e-16)


def test_a_product_with_a_known_zero_is_zero_for_every_number():
    assert [float(value) for value in Vec3(np.nan, np.inf, 1.0) * 0.0] == [0.0, 0.0, 0.0]


def test_norm_has_a_gradient_at_zero():
    found = jax.grad(lambda x: Vec3(x, 0.0 * x, 2.0 * x).norm())
    assert float(found(0.0)) == 0.0
    assert float(found(3.0)) == pytest.approx(np.sqrt(5.0), rel=1e-15)


@pytest.mark.parametrize("angles", EULER)
def test_quaternion_equals_scipy(angles):
    """Rotation matrix, the quaternion of Euler angles up to its sign, and normalisation."""
    expected = turned(*angles)
    q = quaternion_from_euler(*angles)
    matrix = np.array(q.matrix())
    gap = np.abs(matrix - expected.as_matrix()).max()
    second = np.array(quaternion_of(expected))
    sign = np.sign(np.dot(second, np.array(q)))
    gap_q = np.abs(np.array(q) - sign * second).max()
    longer = Quaternion(*(3.7 * x for x in q)).normalised()
    gap_n = np.abs(np.array(longer) - np.array(q)).max()
    print(f"\nmatrix {gap:.1e}, quaternion {gap_q:.1e}, normalised {gap_n:.1e}")
    assert max(gap, gap_q, gap_n) < 1e-15 * 8


@pytest.mark.parametrize("angles", EULER)
def test_quaternion_rate_is_the_derivative(angles):
    """q' = q (0, Omega)/2 against exact turns by +-Omega h, to O(h^4), and R' = R [Omega]_x by forward mode."""
    omega, h = np.array([0.7, -1.3, 0.4]), 1e-3
    at = turned(*angles)
    q = quaternion_of(at)

    def after(time):
        found = np.array(quaternion_of(at * Rotation.from_rotvec(omega * time)))
        return found * np.sign(found @ np.array(q))

    numerical = (8.0 * (after(h) - after(-h)) - (after(2 * h) - after(-2 * h))) / (12.0 * h)
    rate = q.rate(Vec3(*omega))
    gap = np.abs(np.array(rate) - numerical).max()
    _, r_dot = jax.jvp(Quaternion.matrix, (Quaternion(*map(jnp.float64, q)),), (rate,))
    skew = np.cross(np.eye(3), omega)  # rows e_i x Omega: the matrix [Omega]_x
    np.testing.assert_allclose(skew @ np.array([1.0, 2.0, 3.0]), np.cross(omega, [1.0, 2.0, 3.0]), rtol=1e-14)
    gap_r = np.abs(np.array(r_dot) - at.as_matrix() @ skew).max()
    print(f"\nq' against numerical {gap:.1e}, R' against R [Omega]_x {gap_r:.1e}")
    assert gap < 1e-11
    assert gap_r < 1e-14


@pytest.mark.parametrize("angles", [a for a in EULER if abs(a[1]) < 1.5])
def test_euler_angles_and_their_rates_equal_scipy(angles):
    """euler_of and trig_of invert the rotation; euler_rates is the numerical derivative of SciPy's angles."""
    omega, h = np.array([0.7, -1.3, 0.4]), 1e-4
    at = turned(*angles)
    matrix = quaternion_of(at).matrix()
    gap = np.abs(np.array(euler_of(matrix)) - np.array(angles)).max()
    phi, theta, psi = angles
    expected = Trig(
        np.cos(phi), np.sin(phi), np.cos(theta), np.sin(theta), np.cos(psi), np.sin(psi), 1.0 / np.cos(theta)
    )
    gap_t = np.abs(np.array(trig_of(matrix)) - np.array(expected)).max()

    def angles_after(time):
        return (at * Rotation.from_rotvec(omega * time)).as_euler("ZYX")[::-1]

    steps = [np.angle(np.exp(1j * (angles_after(k * h) - angles_after(-k * h)))) for k in (1, 2)]
    numerical = (8.0 * steps[0] - steps[1]) / (12.0 * h)
    gap_r = np.abs(np.array(euler_rates(trig_of(matrix), Vec3(*omega))) - numerical).max()
    print(f"\nangles {gap:.1e}, trigonometry {gap_t:.1e}, rates {gap_r:.1e}")
    assert gap < 1e-14
    assert gap_t < 1e-14
    assert gap_r < 1e-9


def test_euler_angles_stay_finite_at_the_singularity():
    matrix = quaternion_from_euler(0.0, 0.5 * np.pi, 0.3).matrix()
    found = np.array([*euler_of(matrix), *trig_of(matrix), *euler_rates(trig_of(matrix), Vec3(0.1, 0.2, 0.3))])
    print("\nat theta = pi/2:", found)
    assert np.isfinite(found).all()
    assert found[1] == pytest.approx(0.5 * np.pi, abs=1e-7)
