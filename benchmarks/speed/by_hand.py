"""The two loops as one writes them in plain Python: over arrays of draws with NumPy, draw by draw for Numba.

The equations stand here once. They take numbers or arrays alike; ``build`` is told how to compile and compare them. All
numbers that draws share are constants of the closure, in the working precision, so that Numba folds them and nothing is
promoted to float64.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from benchmarks.speed.workloads import OneAxis, Sine, Uav

GRAVITY = 9.81
LEAST_LIFT = 0.1 * GRAVITY
LEAST_UPRIGHT = math.cos(math.radians(85.0))
ROTORS = 4
SERIES_TERMS = 12
"""Of the exponential of the 1-DOF loop: h/mu is 1/4 at most, and (1/4)^13/13! is below rounding."""


class Dialect(NamedTuple):
    """How the equations are said: the decorator of every function, and the lesser and the greater of two numbers."""

    compiled: Callable
    least: Callable
    most: Callable


class Program(NamedTuple):
    """A loop for one draw or an array of them.

    Args:
        pick: ``(drawn, i) -> `` the uncertain numbers of draw i, or of all draws where i is a slice.
        start: ``(drawn, wanted of the first sample) -> (state, sums)``.
        sample: ``(drawn, state, sums, wanted, share, first) -> (state, sums)``; ``wanted`` has a row (y, y', y'') a
            channel, ``share`` is the share of the sample in which wind or disturbance act.
        ended: ``state -> (not finite, singular)``.
        channels: How many.
    """

    pick: Callable
    start: Callable
    sample: Callable
    ended: Callable
    channels: int


def trajectory(wanted: tuple[Sine, ...], samples: int, dt: float) -> np.ndarray:
    """y, y', y'' of every channel at every sample, shape (samples, channels, 3)."""
    t = np.arange(samples)[:, None] * dt
    amplitude, rate, phase, offset = np.array(wanted).T
    swing, slope = amplitude * np.sin(rate * t + phase), amplitude * np.cos(rate * t + phase)
    return np.stack([offset + swing, rate * slope, -rate * rate * swing], axis=-1)


def shares(start: float, samples: int, dt: float) -> np.ndarray:
    """Share of each sample that comes after a time."""
    return np.clip((np.arange(samples) * dt + dt - start) / dt, 0.0, 1.0)


def constants(values: Any, real: type) -> Any:
    """Nested tuples with every number in the working precision."""
    if isinstance(values, tuple):
        parts = [constants(value, real) for value in values]
        return type(values)(*parts) if hasattr(values, "_fields") else tuple(parts)
    return real(values)


def controller(dt: float, real: type, dialect: Dialect) -> Callable:
    """A DSSC channel with its metrics: ``(gains, state, sums, e, y', wanted, first) -> (state, sums, command)``."""
    compiled, least, most = dialect
    dt, one, zero = real(dt), real(1.0), real(0.0)

    @compiled
    def control(g, state, sums, e, y_dot, wanted, first):
        u_av, sigma_hat = state
        squares, largest, variation = sums
        sigma = y_dot - wanted[1] + g.l0 * e
        r = np.sqrt(np.abs(sigma))
        gain, tau_m = dt * g.kappa_o * (g.tau_av / (g.tau_av + dt)) * (r + g.delta_o), g.kappa_m * (r + g.delta_m)
        pole, decay = one / tau_m, tau_m / (tau_m + dt)
        c = gain * decay
        feedback = (g.a_n - g.l0) * g.l0 * e + (g.l0 - g.a_n + pole) * sigma
        nominal = (g.a_n * wanted[1] + wanted[2] - feedback) / g.k_n
        change = least(most((sigma - decay * sigma_hat) / c, -g.rho - u_av), g.rho - u_av)
        after = u_av + dt / (g.tau_av + dt) * change
        moved = zero * change if first else np.abs(u_av - after)
        found = (squares + e * e, most(largest, np.abs(e)), variation + moved)
        return (after, decay * sigma_hat + c * change), found, nominal - after

    return control


def largest_sum(real: type) -> float:
    """What the sum of a state stays below; its squares are finite far beyond it."""
    return 1e-4 * float(np.sqrt(np.finfo(real).max))


def axis(n: OneAxis, dt: float, real: type, dialect: Dialect) -> Program:
    """One degree of freedom behind a lag of order 2, exact between two samples; drawn: k_p, a_p, mu, d.

    Held at u, the lag settles at z = u. Its distance w = z - u from there has no input, and the loop moves as x1' = x2,
    x2' = k_p (w2 + u + d) - a_p x2, w2' = (w1 - w2)/mu, w1' = -w1/mu.
    """
    compiled, control = dialect.compiled, controller(dt, real, dialect)
    h, zero, one = real(dt), real(0.0), real(1.0)
    reciprocals = tuple(real(1.0 / k) for k in range(SERIES_TERMS, 0, -1))
    largest = real(largest_sum(real))
    gains, position, velocity = n.channel, n.position, n.velocity
    matched = n.matched > 0

    @compiled
    def pick(drawn, i):
        """d, and the rows of exp(A h) - 1 for x1, x2 and w2, at x2, w2, w1 and the input u + d: Horner's rule."""
        gain, damping, rate = h * drawn[0, i], h * drawn[1, i], h / drawn[2, i]
        nothing = zero * gain
        p2, p3, p4, p5 = nothing, nothing, nothing, nothing
        v2, v3, v4, v5 = nothing, nothing, nothing, nothing
        w3, w4 = nothing, nothing
        for share in reciprocals:
            slow, lag = one + v2, one + w3
            p2, p3, p4, p5 = share * h * slow, share * h * v3, share * h * v4, share * h * v5
            v2 = -share * damping * slow
            v3 = share * (gain * lag - damping * v3)
            v4 = share * (gain * w4 - damping * v4)
            v5 = share * (gain - damping * v5)
            w4 = share * rate * (lag - w4)
            w3 = -share * rate * lag
        return drawn[3, i], (p2, p3, p4, p5), (v2, v3, v4, v5), (w3, w4)

    @compiled
    def start(drawn, wanted):
        nothing = zero * drawn[0]
        x1, x2 = position + nothing, velocity + nothing
        sigma_hat = x2 - wanted[0][1] + gains.l0 * (x1 - wanted[0][0]) if matched else nothing
        return (x1, x2, nothing, nothing, nothing, sigma_hat), ((nothing, nothing, nothing),)

    @compiled
    def sample(drawn, state, sums, wanted, share, first):
        d, p, v, w = drawn
        x1, x2, z1, z2, u_av, sigma_hat = state
        inner, found, u = control(gains, (u_av, sigma_hat), sums[0], x1 - wanted[0][0], x2, wanted[0], first)
        w1, w2, command = z1 - u, z2 - u, u + d * share
        x1 = x1 + (p[0] * x2 + p[1] * w2 + p[2] * w1 + p[3] * command)
        x2 = x2 + (v[0] * x2 + v[1] * w2 + v[2] * w1 + v[3] * command)
        z2 = z2 + (w[0] * w2 + w[1] * w1)
        z1 = z1 + w[0] * w1
        return (x1, x2, z1, z2, inner[0], inner[1]), (found,)

    @compiled
    def ended(state):
        x1, x2, z1, z2, u_av, sigma_hat = state
        return np.logical_not(np.abs(x1 + x2 + z1 + z2 + u_av + sigma_hat) < largest), x1 != x1

    return Program(pick, start, sample, ended, 1)


def uav(n: Uav, dt: float, euler: bool, real: type, dialect: Dialect) -> Program:
    """The full UAV; drawn: M, I_bx, I_by, I_bz, k_T. A state is (p, v, attitude, Omega, integrals, controllers)."""
    compiled, least, most = dialect
    control = controller(dt, real, dialect)
    h, half_h, third, sixth = real(dt), real(dt / 2.0), real(dt / 3.0), real(dt / 6.0)
    zero, half, one, two = real(0.0), real(0.5), real(1.0), real(2.0)
    largest = real(largest_sum(real))
    gravity, least_lift, least_upright, tiny = real(GRAVITY), real(LEAST_LIFT), real(LEAST_UPRIGHT), real(1e-12)
    pi, turn = real(math.pi), real(2.0 * math.pi)
    cos_yaw, sin_yaw = real(math.cos(n.yaw / 2.0)), real(math.sin(n.yaw / 2.0))
    limit, hubs_xy, hubs_z = (
        real(2.0 * GRAVITY / ROTORS),
        real(ROTORS) * n.rotor_inertia_xy,
        real(ROTORS) * n.rotor_inertia_z,
    )
    slow = real(1.0) / n.believed_thrust_coefficient
    rotors = tuple(zip(n.allocation, n.rotor_x, n.rotor_y, n.spin, strict=True))
    r1, r2, r3, r4 = rotors

    @compiled
    def along(x, by, d):
        return (x[0] + by * d[0], x[1] + by * d[1], x[2] + by * d[2])

    @compiled
    def along4(x, by, d):
        return (x[0] + by * d[0], x[1] + by * d[1], x[2] + by * d[2], x[3] + by * d[3])

    @compiled
    def moved(state, by, slope):
        p, v, q, w, path, turned = state
        dp, dv, dq, dw, dpath, dturned = slope
        return (
            along(p, by, dp),
            along(v, by, dv),
            along4(q, by, dq),
            along(w, by, dw),
            along(path, by, dpath),
            turned + by * dturned,
        )

    @compiled
    def matrix(q):
        w, x, y, z = q
        return (
            (one - two * (y * y + z * z), two * (x * y - w * z), two * (x * z + w * y)),
            (two * (x * y + w * z), one - two * (x * x + z * z), two * (y * z - w * x)),
            (two * (x * z - w * y), two * (y * z + w * x), one - two * (x * x + y * y)),
        )

    @compiled
    def trigonometry(r, w):
        """(c_phi, s_phi, c_theta, s_theta, c_psi, s_psi) and (phi', theta', psi')."""
        ct = np.sqrt(most(r[2][1] * r[2][1] + r[2][2] * r[2][2], tiny))
        inverse = one / ct
        cphi, sphi, st = r[2][2] * inverse, r[2][1] * inverse, -r[2][0]
        dpsi = (sphi * w[1] + cphi * w[2]) * inverse
        rates = (w[0] + st * dpsi, cphi * w[1] - sphi * w[2], dpsi)
        return (cphi, sphi, ct, st, r[0][0] * inverse, r[1][0] * inverse), rates

    @compiled
    def kinematics(state, u, dpsi):
        _, v, q, w, _, _ = state
        dq = (
            half * (-q[1] * w[0] - q[2] * w[1] - q[3] * w[2]),
            half * (q[0] * w[0] + q[2] * w[2] - q[3] * w[1]),
            half * (q[0] * w[1] + q[3] * w[0] - q[1] * w[2]),
            half * (q[0] * w[2] + q[1] * w[1] - q[2] * w[0]),
        )
        return v, dq, (u[0] - v[0], u[1] - v[1], u[2] - v[2]), u[3] - dpsi

    @compiled
    def demand(state, u, r, trig, rates):
        _, v, _, w, path, turned = state
        cphi, sphi, ct, st, cpsi, spsi = trig
        dphi, dtheta, dpsi = rates
        ax = n.kd_velocity * (u[0] - v[0]) + n.kp_velocity * path[0]
        ay = n.kd_velocity * (u[1] - v[1]) + n.kp_velocity * path[1]
        az = most(n.kd_velocity * (u[2] - v[2]) + n.kp_velocity * path[2] + gravity, least_lift)
        over = one / az
        forward, left = (ax * cpsi + ay * spsi) * over, (ax * spsi - ay * cpsi) * over
        phi_d, theta_d = np.arctan(left / np.sqrt(one + forward * forward)), np.arctan(forward)
        phi, theta = np.arctan(sphi / cphi), np.arctan(st / ct)
        ddphi = n.kp_attitude * (phi_d - phi) - n.kd_attitude * dphi
        ddtheta = n.kp_attitude * (theta_d - theta) - n.kd_attitude * dtheta
        ddpsi = n.kd_yaw * (u[3] - dpsi) + n.kp_yaw * turned
        turning = ct * dpsi
        pitching, yawing = ddtheta + dphi * turning, ct * ddpsi - dtheta * (dphi + st * dpsi)
        jx, jy, jz = n.believed_inertia
        moment = (
            jx * (ddphi - st * ddpsi - dtheta * turning) + (jz - jy) * w[1] * w[2],
            jy * (cphi * pitching + sphi * yawing) + (jx - jz) * w[2] * w[0],
            jz * (cphi * yawing - sphi * pitching) + (jy - jx) * w[0] * w[1],
        )
        return n.believed_mass * az / (cphi * ct), moment

    @compiled
    def rotor(row, thrust, moment, top):
        wanted = row[0] * thrust + row[1] * moment[0] + row[2] * moment[1] + row[3] * moment[2]
        f = least(most(wanted, zero), top)
        return f, np.sqrt(f * slow)

    @compiled
    def dynamics(drawn, state, u, wind, r, trig, rates):
        lighter, (jx, jy, jz), (over_x, over_y, over_z), top, ratio = drawn
        _, v, _, w, _, _ = state
        thrust, moment = demand(state, u, r, trig, rates)
        (f1, s1), (f2, s2) = rotor(r1[0], thrust, moment, top), rotor(r2[0], thrust, moment, top)
        (f3, s3), (f4, s4) = rotor(r3[0], thrust, moment, top), rotor(r4[0], thrust, moment, top)
        total = ratio * (f1 + f2 + f3 + f4)
        mx = ratio * (r1[2] * f1 + r2[2] * f2 + r3[2] * f3 + r4[2] * f4)
        my = -ratio * (r1[1] * f1 + r2[1] * f2 + r3[1] * f3 + r4[1] * f4)
        mz = n.torque_coefficient * ratio * (r1[3] * f1 + r2[3] * f2 + r3[3] * f3 + r4[3] * f4)
        s, spin = s1 + s2 + s3 + s4, r1[3] * s1 + r2[3] * s2 + r3[3] * s3 + r4[3] * s4
        sx = r1[1] * s1 + r2[1] * s2 + r3[1] * s3 + r4[1] * s4
        sy = r1[2] * s1 + r2[2] * s2 + r3[2] * s3 + r4[2] * s4
        sxx = r1[1] * r1[1] * s1 + r2[1] * r2[1] * s2 + r3[1] * r3[1] * s3 + r4[1] * r4[1] * s4
        sxy = r1[1] * r1[2] * s1 + r2[1] * r2[2] * s2 + r3[1] * r3[2] * s3 + r4[1] * r4[2] * s4
        syy = r1[2] * r1[2] * s1 + r2[2] * r2[2] * s2 + r3[2] * r3[2] * s3 + r4[2] * r4[2] * s4
        ax, ay, az = v[0] - wind[0], v[1] - wind[1], v[2] - wind[2]
        speed = np.sqrt(ax * ax + ay * ay + az * az)
        fx = r[0][0] * ax + r[1][0] * ay + r[2][0] * az
        fy = r[0][1] * ax + r[1][1] * ay + r[2][1] * az
        fz = r[0][2] * ax + r[1][2] * ay + r[2][2] * az
        k, (kx, ky, kz) = n.propeller_drag, n.structure_drag
        gx = -fx * (kx * speed + k * s) + k * w[2] * sy
        gy = -fy * (ky * speed + k * s) - k * w[2] * sx
        gz = total - fz * (kz * speed + k * s) - k * (w[0] * sy - w[1] * sx)
        dv = (
            (r[0][0] * gx + r[0][1] * gy + r[0][2] * gz) * lighter,
            (r[1][0] * gx + r[1][1] * gy + r[1][2] * gz) * lighter,
            (r[2][0] * gx + r[2][1] * gy + r[2][2] * gz) * lighter - gravity,
        )
        spun = -n.rotor_inertia_z * spin
        tx = mx - k * (sy * fz + syy * w[0] - sxy * w[1]) - spun * w[1]
        ty = my - k * (sxx * w[1] - sxy * w[0] - sx * fz) + spun * w[0]
        tz = mz - k * (sx * fy - sy * fx + (sxx + syy) * w[2])
        dw = (
            (tx - (jz - jy) * w[1] * w[2]) * over_x,
            (ty - (jx - jz) * w[2] * w[0]) * over_y,
            (tz - (jy - jx) * w[0] * w[1]) * over_z,
        )
        return dv, dw

    @compiled
    def derivative(drawn, state, u, wind):
        r = matrix(state[2])
        trig, rates = trigonometry(r, state[3])
        dv, dw = dynamics(drawn, state, u, wind, r, trig, rates)
        dp, dq, dpath, dturned = kinematics(state, u, rates[2])
        return dp, dv, dq, dw, dpath, dturned

    @compiled
    def runge_kutta(drawn, state, u, wind):
        k1 = derivative(drawn, state, u, wind)
        k2 = derivative(drawn, moved(state, half_h, k1), u, wind)
        k3 = derivative(drawn, moved(state, half_h, k2), u, wind)
        k4 = derivative(drawn, moved(state, h, k3), u, wind)
        return moved(moved(moved(moved(state, sixth, k1), third, k2), third, k3), sixth, k4)

    @compiled
    def semi_implicit(drawn, state, u, wind):
        p, v, q, w, path, turned = state
        r = matrix(q)
        trig, rates = trigonometry(r, w)
        dv, dw = dynamics(drawn, state, u, wind, r, trig, rates)
        v, w = along(v, h, dv), along(w, h, dw)
        trig, rates = trigonometry(r, w)
        dp, dq, dpath, dturned = kinematics((p, v, q, w, path, turned), u, rates[2])
        return along(p, h, dp), v, along4(q, h, dq), w, along(path, h, dpath), turned + h * dturned

    integrate = semi_implicit if euler else runge_kutta

    @compiled
    def pick(drawn, i):
        """1/M, J, 1/J, f_max, and k_T over the believed one."""
        mass, jx, jy, jz = drawn[0, i], drawn[1, i] + hubs_xy, drawn[2, i] + hubs_xy, drawn[3, i] + hubs_z
        return one / mass, (jx, jy, jz), (one / jx, one / jy, one / jz), limit * mass, drawn[4, i] * slow

    @compiled
    def start(drawn, wanted):
        o = zero * drawn[0]
        rest, idle = (o, o, o), (o, o)
        p = (n.position[0] + o, n.position[1] + o, n.position[2] + o)
        v = (n.velocity[0] + o, n.velocity[1] + o, n.velocity[2] + o)
        body = (p, v, (cos_yaw + o, o, o, sin_yaw + o), rest, rest, o)
        return (body, (idle, idle, idle, idle)), (rest, rest, rest, rest)

    @compiled
    def sample(drawn, state, sums, wanted, share, first):
        body, (cx, cy, cz, cpsi) = state
        p, v, q, w, path, turned = body
        r = matrix(q)
        _, rates = trigonometry(r, w)
        e = np.arctan2(r[1][0], r[0][0]) - wanted[3][0]
        e = e - turn * np.ceil((e - pi) / turn)
        cx, mx, ux = control(n.channel[0], cx, sums[0], p[0] - wanted[0][0], v[0], wanted[0], first)
        cy, my, uy = control(n.channel[1], cy, sums[1], p[1] - wanted[1][0], v[1], wanted[1], first)
        cz, mz, uz = control(n.channel[2], cz, sums[2], p[2] - wanted[2][0], v[2], wanted[2], first)
        cpsi, mpsi, upsi = control(n.channel[3], cpsi, sums[3], e, rates[2], wanted[3], first)
        wind = (share * n.wind[0], share * n.wind[1], share * n.wind[2])
        p, v, q, w, path, turned = integrate(drawn, body, (ux, uy, uz, upsi), wind)
        inverse = one / np.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
        q = (q[0] * inverse, q[1] * inverse, q[2] * inverse, q[3] * inverse)
        return ((p, v, q, w, path, turned), (cx, cy, cz, cpsi)), (mx, my, mz, mpsi)

    @compiled
    def total(x):
        return x[0] + x[1] + x[2]

    @compiled
    def ended(state):
        (p, v, q, w, path, turned), (cx, cy, cz, cpsi) = state
        whole = total(p) + total(v) + total(w) + total(path) + turned + q[0] + total(q[1:])
        whole = whole + cx[0] + cx[1] + cy[0] + cy[1] + cz[0] + cz[1] + cpsi[0] + cpsi[1]
        return np.logical_not(np.abs(whole) < largest), one - two * (q[1] * q[1] + q[2] * q[2]) < least_upright

    return Program(pick, start, sample, ended, 4)


def build(shared: Uav | OneAxis, dt: float, euler: bool, real: type, dialect: Dialect) -> Program:
    """A task's loop.

    Args:
        shared: Numbers that all draws share.
        dt: Sampling period [s].
        euler: The UAV by semi-implicit Euler, not Runge-Kutta; the 1-DOF loop is exact.
        real: NumPy's type of the working precision.
        dialect: How the equations are said.
    """
    own = constants(shared, real)
    if isinstance(own, Uav):
        return uav(own, dt, euler, real, dialect)
    return axis(own, dt, real, dialect)
