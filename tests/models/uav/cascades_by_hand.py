"""The cascades of autopilots in plain NumPy, written from their sources, and a multirotor to fly them on.

PX4's attitude control is written as there: in the inertial frame, with direction cosine matrices, acos and asin.
"""

import math

import numpy as np

G = 9.81


class Craft:
    """A plus-shaped quadrotor with motor lag, without drag."""

    mass, inertia, arm, torque, k_t, lag, limit = 1.2, np.array([0.01, 0.012, 0.02]), 0.2, 0.015, 1.5e-6, 0.02, 6.0
    spins = np.array([1.0, -1.0, 1.0, -1.0])

    def __init__(self):
        angles = 0.5 * np.pi * np.arange(4)
        x, y = self.arm * np.cos(angles), self.arm * np.sin(angles)
        self.geometry = np.stack([np.ones(4), y, -x, self.torque * self.spins])
        self.inverse = np.linalg.pinv(self.geometry)

    def allocate(self, thrust, moment):
        wanted = self.inverse @ np.array([thrust, *moment])
        given = np.clip(wanted, 0.0, self.limit)
        return given, np.array(moment) - self.geometry[1:] @ given if np.any(given != wanted) else np.zeros(3)


def matrix(q):
    w, x, y, z = q
    return np.array([
        [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ])  # fmt: skip


def times(a, b):
    return np.array([a[0] * b[0] - a[1:] @ b[1:], *(a[0] * b[1:] + b[0] * a[1:] + np.cross(a[1:], b[1:]))])


def inverse(q):
    return q * np.array([1.0, -1.0, -1.0, -1.0])


def quaternion(r):
    """From a matrix whose trace is not too small."""
    w = 0.5 * math.sqrt(1.0 + np.trace(r))
    return np.array([w, *(np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]]) / (4.0 * w))])


def between(a, b):
    """The shortest rotation from one unit vector to another."""
    q = np.array([1.0 + a @ b, *np.cross(a, b)])
    return q / np.linalg.norm(q)


class Px4:
    """PositionControl, AttitudeControl and RateControl of PX4 1.14, with its default parameters."""

    def __init__(self, craft, velocity, q):
        self.craft, self.q_d, self.yaw_rate = craft, q, 0.0
        self.vel_int, self.last_velocity, self.vel_dot = np.zeros(3), velocity, np.zeros(3)
        self.hover = craft.mass * G / (4 * craft.limit)
        self.thr_sp = np.array([0.0, 0.0, self.hover])
        self.rate_int, self.missing, self.last_rate, self.slope = (np.zeros(3) for _ in range(4))
        self.delays = [np.zeros(3), np.zeros(3)]
        mix = craft.inverse[:, 1:]
        tilting = max(math.sqrt(mix[:, i] @ mix[:, i] / (np.sum(np.abs(mix[:, i]) > 1e-3) / 2.0)) for i in (0, 1))
        self.unit = craft.limit / np.array([tilting, tilting, mix[:, 2].max()])

    def sample(self, velocity, q, command, yaw_rate, dt):
        p, i, d = np.array([1.8, 1.8, 4.0]), np.array([0.4, 0.4, 2.0]), np.array([0.2, 0.2, 0.0])
        alpha = dt / (dt + 1.0 / (2.0 * np.pi * 5.0))
        self.vel_dot = self.vel_dot + alpha * ((velocity - self.last_velocity) / dt - self.vel_dot)
        self.last_velocity = velocity
        error = command - velocity
        acc = error * p + self.vel_int - self.vel_dot * d
        body_z = np.array([acc[0], acc[1], G]) / np.linalg.norm([acc[0], acc[1], G])
        angle = math.acos(body_z[2])
        if angle > math.radians(45.0):
            flat = np.array([body_z[0], body_z[1], 0.0]) / np.hypot(body_z[0], body_z[1])
            body_z = math.cos(math.radians(45.0)) * np.array([0, 0, 1.0]) + math.sin(math.radians(45.0)) * flat
        collective = max((acc[2] * self.hover / G + self.hover) / body_z[2], 0.12)
        thr = body_z * collective
        if (thr[2] <= 0.12 and error[2] <= 0.0) or (thr[2] >= 1.0 and error[2] >= 0.0):
            error[2] = 0.0
        norm = np.hypot(thr[0], thr[1])
        thr[2] = min(thr[2], math.sqrt(1.0 - min(norm, 0.3) ** 2))
        room = math.sqrt(max(1.0 - thr[2] ** 2, 0.0))
        if norm > room:
            thr[:2] *= room / norm
        produced = thr[:2] * G / self.hover
        if acc[:2] @ acc[:2] > produced @ produced:
            error[:2] -= 2.0 / 1.8 * (acc[:2] - produced)
        self.vel_int = self.vel_int + i * error * dt
        self.vel_int[2] = np.clip(self.vel_int[2], -G, G)
        self.thr_sp, self.yaw_rate = thr, yaw_rate
        r = matrix(q)
        yaw = math.atan2(r[1, 0], r[0, 0])
        z = thr / np.linalg.norm(thr)
        x = np.cross([-math.sin(yaw), math.cos(yaw), 0.0], z)
        x /= np.linalg.norm(x)
        self.q_d = quaternion(np.stack([x, np.cross(z, x), z], axis=1))

    def rates(self, q):
        reduced = times(between(matrix(q)[:, 2], matrix(self.q_d)[:, 2]), q)
        mix = times(inverse(reduced), self.q_d)
        mix = np.clip(mix if mix[0] >= 0.0 else -mix, -1.0, 1.0)
        w = 0.4
        q_d = times(reduced, np.array([math.cos(w * math.acos(mix[0])), 0.0, 0.0, math.sin(w * math.asin(mix[3]))]))
        error = times(inverse(q), q_d)
        error = error if error[0] >= 0.0 else -error
        wanted = 2.0 * error[1:] * np.array([6.5, 6.5, 2.8 / w]) + matrix(q).T[:, 2] * self.yaw_rate
        limit = np.radians([220.0, 220.0, 200.0])
        return np.clip(wanted, -limit, limit)

    def tick(self, q, rate, dt):
        ohm = math.tan(math.pi * 40.0 * dt)
        c = 1.0 + 2.0 * math.cos(math.pi / 4.0) * ohm + ohm * ohm
        b0, a1, a2 = (
            ohm * ohm / c,
            2.0 * (ohm * ohm - 1.0) / c,
            (1.0 - 2.0 * math.cos(math.pi / 4.0) * ohm + ohm * ohm) / c,
        )
        d0 = rate - a1 * self.delays[0] - a2 * self.delays[1]
        filtered = b0 * (d0 + 2.0 * self.delays[0] + self.delays[1])
        self.delays = [d0, self.delays[0]]
        alpha = dt / (dt + 1.0 / (2.0 * np.pi * 30.0))
        self.slope = self.slope + alpha * ((filtered - self.last_rate) / dt - self.slope)
        self.last_rate = filtered
        wanted = self.rates(q)
        error = wanted - filtered
        torque = error * [0.15, 0.15, 0.2] + self.rate_int - self.slope * [0.003, 0.003, 0.0]
        for i, gain in enumerate((0.2, 0.2, 0.1)):
            held = error[i]
            held = min(held, 0.0) if self.missing[i] / self.unit[i] > 2.0**-23 else held
            held = max(held, 0.0) if self.missing[i] / self.unit[i] < -(2.0**-23) else held
            factor = max(0.0, 1.0 - (held / math.radians(400.0)) ** 2)
            self.rate_int[i] = np.clip(self.rate_int[i] + factor * gain * held * dt, -0.3, 0.3)
        thrusts, self.missing = self.craft.allocate(
            np.linalg.norm(self.thr_sp) * 4 * self.craft.limit, torque * self.unit
        )
        return thrusts


def capped(angle):
    """An angle in degrees within (-180, 180]."""
    return angle - 360.0 * math.ceil((angle - 180.0) / 360.0)


class Pid:
    """pid.c of the Crazyflie, without filters."""

    def __init__(self, kp, ki, kd, limit, measured):
        self.kp, self.ki, self.kd, self.limit, self.last, self.integral = kp, ki, kd, limit, measured, 0.0

    def update(self, error, measured, dt, angle=False):
        change = capped(measured - self.last) if angle else measured - self.last
        self.integral = min(max(self.integral + error * dt, -self.limit), self.limit)
        self.last = measured
        return self.kp * error + self.ki * self.integral - self.kd * change / dt


class Crazyflie:
    """The firmware's cascade in its own units: degrees and motor commands of 16 bit."""

    def __init__(self, craft, velocity, q):
        self.craft, roll_pitch_yaw = craft, self.angles(q)
        self.base = craft.mass * G / (4 * craft.limit) * 65535.0
        self.vel = [Pid(25.0, 1.0, 0.0, 5000.0, velocity[0]), Pid(25.0, 1.0, 0.0, 5000.0, velocity[1])]
        self.vel.append(Pid(25.0, 15.0, 0.0, 5000.0, velocity[2]))
        gains = ((6.0, 3.0, 0.0, 20.0), (6.0, 3.0, 0.0, 20.0), (6.0, 1.0, 0.35, 360.0))
        self.att = [Pid(*gain, angle) for gain, angle in zip(gains, roll_pitch_yaw, strict=True)]
        gains = ((250.0, 500.0, 2.5, 33.3), (250.0, 500.0, 2.5, 33.3), (120.0, 16.7, 0.0, 166.7))
        self.rate = [Pid(*gain, 0.0) for gain in gains]
        self.desired, self.yaw_rate, self.thrust = np.array([0.0, 0.0, roll_pitch_yaw[2]]), 0.0, self.base

    @staticmethod
    def angles(q):
        r = matrix(q)
        return np.degrees([math.atan2(r[2, 1], r[2, 2]), math.asin(-r[2, 0]), math.atan2(r[1, 0], r[0, 0])])

    def sample(self, velocity, q, command, yaw_rate, dt):
        yaw = math.radians(self.angles(q)[2])
        turn = np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
        v, u = turn @ velocity[:2], turn @ command[:2]
        pitch, roll = (
            np.clip(np.clip(self.vel[i].update(u[i] - v[i], v[i], dt), -22.0, 22.0), -20.0, 20.0) for i in (0, 1)
        )
        climb = np.clip(self.vel[2].update(command[2] - velocity[2], velocity[2], dt), -32.7675, 32.7675)
        self.thrust = min(max(climb * 1000.0 + self.base, 20000.0), 65535.0)
        self.desired[:2] = -roll, pitch
        self.yaw_rate = math.degrees(yaw_rate)

    def tick(self, q, rate, dt):
        self.desired[2] = capped(self.desired[2] + self.yaw_rate * dt)
        actual = self.angles(q)
        error = self.desired - actual
        error[2] = capped(error[2])
        rates = [self.att[i].update(error[i], actual[i], dt, angle=i == 2) for i in range(3)]
        turning = np.degrees(rate)
        roll, pitch, yaw = (self.rate[i].update(rates[i] - turning[i], turning[i], dt) for i in range(3))
        # legacy distribution of a plus-shaped quadrotor: half of roll and pitch, all of yaw
        angles = 0.5 * np.pi * np.arange(4)
        motors = self.thrust + 0.5 * roll * np.sin(angles) - 0.5 * pitch * np.cos(angles) + yaw * self.craft.spins
        return np.clip(motors / 65535.0 * self.craft.limit, 0.0, self.craft.limit)


def slope(craft, x, commanded):
    v, q, rate, speeds = x[3:6], x[6:10], x[10:13], x[13:]
    force, *moment = craft.geometry @ (craft.k_t * speeds**2)
    acceleration = matrix(q)[:, 2] * force / craft.mass - [0.0, 0.0, G]
    turning = (np.array(moment) - np.cross(rate, craft.inertia * rate)) / craft.inertia
    return np.concatenate(
        [v, acceleration, 0.5 * times(q, np.array([0.0, *rate])), turning, (commanded - speeds) / craft.lag]
    )


def flight(software, craft, commands, sample_time, ticks, substeps, steps, yaw=0.0):
    """Positions, yaw and rotor thrusts at the samples; ``commands(position, yaw)`` is the outer loop."""
    x = np.concatenate([np.zeros(6), [math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)], np.zeros(3)])
    x = np.concatenate([x, np.full(4, math.sqrt(craft.mass * G / 4 / craft.k_t))])
    cascade = software(craft, x[3:6], x[6:10])
    rows = []
    h = sample_time / substeps
    for _ in range(steps):
        r = matrix(x[6:10])
        psi = math.atan2(r[1, 0], r[0, 0])
        rows.append([*x[:3], psi])
        command, yaw_rate = commands(x[:3], psi)
        cascade.sample(x[3:6], x[6:10], command, yaw_rate, sample_time)
        for _ in range(ticks):
            thrusts = cascade.tick(x[6:10], x[10:13], sample_time / ticks)
            speeds = np.sqrt(thrusts / craft.k_t)
            for _ in range(substeps // ticks):
                a = slope(craft, x, speeds)
                b = slope(craft, x + 0.5 * h * a, speeds)
                c = slope(craft, x + 0.5 * h * b, speeds)
                d = slope(craft, x + h * c, speeds)
                x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
                x[6:10] /= np.linalg.norm(x[6:10])
    return np.array(rows)
