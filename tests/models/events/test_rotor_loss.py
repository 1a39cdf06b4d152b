"""A hexacopter that loses a rotor at a random time, in wind: against an independent model in NumPy, to 1e-9."""

import numpy as np

import dssc_jax as dj

STUDY = {
    "name": "rotor-loss",
    "seed": 3,
    "draws": 40,
    "loop": {"duration": 7.0, "sample_time": 0.01},
    "plant": {"kind": "uav", "vehicle": "m600"},
    "reference": {"kind": "hover"},
    "controller": {"kind": "pi", "l0": 0.5, "k_p": 1.0, "k_i": 0.1},
    "wind": {"kind": "constant", "x": {"uniform": [-8.0, 8.0]}, "y": {"uniform": [-8.0, 8.0]}, "z": 0.0},
    "event": [{"rotor": 2, "at": {"uniform": [1.0, 6.0]}, "effectiveness": {"uniform": [0.0, 0.9]}}],
    "requirement": [{"metric": "position_error_max", "max": 3.0}],
}


def numpy_flight(at, kept, wx, wy, steps, dt):
    """Largest position error and time of an overturn of each draw: body, rotors, loops, RK4; arrays over draws."""
    n, m, g, k, c, f_max, lag = len(at), 10.0, 9.81, 2.8e-4, 0.02, 50.0, 0.05
    j = np.array([0.46, 0.46, 0.74 + 6 * 7e-4])
    angle, s = np.pi / 3 * np.arange(6), (-1.0) ** np.arange(6)
    place = 0.5665 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], 1)
    effect = np.stack([np.ones(6), place[:, 1], -place[:, 0], c * s])
    inverse, wind = np.linalg.pinv(effect), np.stack([wx, wy, 0 * wx], 1)

    def turned(q):
        w, x, y, z = q.T
        rows = [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
        return np.moveaxis(np.array(rows), 2, 0)

    def euler(r, om):
        phi, theta, psi = np.arctan2(r[:, 2, 1], r[:, 2, 2]), -np.arcsin(r[:, 2, 0]), np.arctan2(r[:, 1, 0], r[:, 0, 0])
        dpsi = (np.sin(phi) * om[:, 1] + np.cos(phi) * om[:, 2]) / np.cos(theta)
        return phi, theta, psi, om[:, 0] + np.sin(theta) * dpsi, np.cos(phi) * om[:, 1] - np.sin(phi) * om[:, 2], dpsi

    def slope(x, u, share):
        v, q, om, integral, w = x[:, 3:6], x[:, 6:10], x[:, 10:13], x[:, 13], x[:, 14:]
        r = turned(q)
        phi, theta, psi, dphi, dtheta, dpsi = euler(r, om)
        a, lift = u[:, :3] - v, np.maximum(u[:, 2] - v[:, 2] + g, 0.1 * g)
        theta_d = np.arctan2(a[:, 0] * np.cos(psi) + a[:, 1] * np.sin(psi), lift)
        phi_d = np.arctan2((a[:, 0] * np.sin(psi) - a[:, 1] * np.cos(psi)) * np.cos(theta_d), lift)
        sp, cp, st, ct = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
        e1, e2 = 60 * (phi_d - phi) - 15 * dphi, 60 * (theta_d - theta) - 15 * dtheta
        e3 = u[:, 3] - dpsi + 0.2 * integral
        roll = e1 - st * e3 - ct * dtheta * dpsi
        pitch = cp * e2 + sp * ct * e3 - sp * dphi * dtheta + (cp * ct * dphi - sp * st * dtheta) * dpsi
        yaw = -sp * e2 + cp * ct * e3 - cp * dphi * dtheta - (sp * ct * dphi + cp * st * dtheta) * dpsi
        alpha = np.stack([roll, pitch, yaw], 1)
        wanted = np.column_stack([m * lift / (cp * ct), alpha * j + np.cross(om, om * j)])
        dw = (np.sqrt(np.clip(wanted @ inverse.T, 0.0, f_max) / k) - w) / lag
        root = np.ones((n, 6))
        root[:, 1] = np.sqrt(1 - share * (1 - kept))
        speed, f = root * w, k * (root * w) ** 2
        air = np.einsum("nji,nj->ni", r, v - wind)
        local = -8e-6 * speed[:, :, None] * (air[:, None] + np.cross(om[:, None], place[None]))
        body = -np.array([0.03, 0.03, 0.015]) * air * np.linalg.norm(air, axis=1)[:, None] + local.sum(1)
        body[:, 2] += f.sum(1)
        h = -7e-4 * (speed * s).sum(1)
        spin = np.stack([-h * om[:, 1], h * om[:, 0], 7e-4 * (root * dw * s).sum(1)], 1)
        torque = f @ effect[1:].T + np.cross(place[None], local).sum(1) + spin
        dom = (torque - np.cross(om, om * j)) / j
        turn = 0.5 * np.stack([-(q[:, 1:] * om).sum(1), *(q[:, :1] * om + np.cross(q[:, 1:], om)).T], 1)
        acceleration = np.einsum("nij,nj->ni", r, body) / m - [0, 0, g]
        return np.column_stack([v, acceleration, turn, dom, u[:, 3] - dpsi, dw])

    x = np.tile(np.array([0] * 6 + [1] + [0] * 7 + [np.sqrt(m * g / 6 / k)] * 6, float), (n, 1))
    total, worst, failed = np.zeros((n, 4)), np.zeros(n), np.full(n, np.nan)
    for i in range(steps):
        _, _, psi, _, _, dpsi = euler(turned(x[:, 6:10]), x[:, 10:13])
        e, rate = np.column_stack([x[:, :3], psi]), np.column_stack([x[:, 3:6], dpsi])
        total += dt * (rate + 0.5 * e)
        u, share = -1.0 * (rate + 0.5 * e) - 0.1 * total, np.clip((i * dt + dt - at) / dt, 0.0, 1.0)
        worst = np.fmax(worst, np.linalg.norm(e[:, :3], axis=1))
        k1 = slope(x, u, share)
        k2 = slope(x + dt / 2 * k1, u, share)
        k3 = slope(x + dt / 2 * k2, u, share)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + slope(x + dt * k3, u, share))
        x[:, 6:10] /= np.linalg.norm(x[:, 6:10], axis=1)[:, None]
        over = np.isnan(failed) & ~(turned(x[:, 6:10])[:, 2, 2] >= np.cos(np.radians(85.0)))
        failed[over] = (i + 1) * dt
        x[~np.isnan(failed)] = x[0] * 0 + np.array([0] * 6 + [1] + [0] * 13)  # frozen
    return worst, failed


def test_the_same_survive_in_an_independent_model():
    study = dj.Study.from_table(STUDY)
    found = dj.run(study).dataset
    drawn = [found[name].values for name in ("event.0.at", "event.0.effectiveness", "wind.x", "wind.y")]
    with np.errstate(all="ignore"):
        worst, failed = numpy_flight(*drawn, study.loop.steps, study.loop.sample_time)
    ended = ~np.isnan(failed)
    np.testing.assert_allclose(found["failed_at"].values[ended], failed[ended], atol=1e-12)
    assert np.array_equal(np.isnan(found["failed_at"].values), ~ended)
    gap = np.abs(found["position_error_max"].values - worst)[~ended]
    violated = (found["outcome"].values >= 10).sum()
    survive = (found["outcome"].values == 0).sum()
    print(f"\n{ended.sum()} overturn, {violated} go too far, {survive} survive; {gap.max():.1e}")
    assert (gap / np.fmax(1.0, worst[~ended])).max() < 1e-9
    assert 0 < survive < 40
