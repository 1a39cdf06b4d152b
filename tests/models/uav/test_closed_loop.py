"""The UAV in closed loop: an independent integration, symmetry, singular attitudes, bad vehicles, batches."""

import itertools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import dssc_jax as dj
from dssc_jax.closed_loop.draw import simulate_recorded
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Outcome
from dssc_jax.engine.plain import plain_options
from dssc_jax.engine.sampling import draw_key
from dssc_jax.runs.trajectory import recorder

CHANNELS = ("x", "y", "z", "psi")
G = 9.81


def square_root(kappa_o, tau_av):
    return {"kind": "square_root", "kappa_o": kappa_o, "kappa_m": 4.0166, "delta_o": 1.0, "delta_m": 1.0} | {
        "tau_av": tau_av
    }


CONTROLLER = {
    "kind": "dssc",
    "discretisation": "implicit",
    "predictor_start": "zero",
    "l0": 0.2,
    "rho": 1.5,
    "functions": square_root(110.651, 0.03),
    "nominal": {"a": 1.0, "k": 1.0},
    "z": {"rho": 0.5, "functions": square_root(55.3255, 0.06)},
    "psi": {"rho": 0.15, "functions": square_root(55.3255, 0.06)},
}
CASE_1 = {
    "name": "case-1",
    "draws": 1,
    "loop": {"duration": 3.0, "sample_time": 0.005},
    "plant": {"kind": "uav", "position": [40.0, 10.0, 10.0], "yaw": math.pi / 4},
    "reference": {"kind": "mission"},
    "controller": CONTROLLER,
    "wind": {"kind": "constant", "x": 8.0, "y": -8.0, "z": 8.0, "at": 1.0},
}
HARSH = {
    "kind": "m600_hexacopter",
    "mass": 12.0,
    "rotor_inertia_z": 2e-3,
    "propeller_drag": 1e-3,
    "structure_drag": [0.05, 0.09, 0.02],
    "motor_lag": 0.05,
}
HARSH_NUMBERS = {"rotors": 6, "mass": 12.0, "hub": 2e-3, "drag": (0.05, 0.09, 0.02), "propeller": 1e-3, "lag": 0.05}


class Independent:
    """The same equations written from the model's text: rotation matrix, NumPy, DOP853, a sampled controller."""

    def __init__(
        self, rotors=4, mass=10.9, hub=0.5e-5, drag=(0.03, 0.03, 0.015), propeller=8e-6, lag=None, believed=10.9
    ):
        self.rotors, self.mass, self.hub, self.believed, self.lag = rotors, mass, hub, believed, lag
        self.drag, self.propeller = np.diag(drag), propeller
        angles = 2 * np.pi * np.arange(rotors) / rotors
        self.p = 0.57 * np.stack([np.cos(angles), np.sin(angles), 0 * angles], axis=1)
        self.s = (-1.0) ** np.arange(rotors)
        self.j = np.array([0.4 + rotors * 0.01, 0.4 + rotors * 0.01, 0.74 + rotors * hub])
        e3 = np.array([0.0, 0.0, 1.0])
        moments = np.cross(self.p, e3) + np.outer(self.s * 0.57, e3)
        self.geometry = np.vstack([np.ones(rotors), moments.T])
        self.inverse = np.linalg.pinv(self.geometry)
        self.f_max = 2 * mass * G / rotors

    def start(self, velocity):
        c, s = np.cos(np.pi / 4), np.sin(np.pi / 4)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        speeds = [] if self.lag is None else np.full(self.rotors, np.sqrt(self.believed * G / self.rotors / 0.0024))
        return np.concatenate([[40.0, 10.0, 10.0], velocity, turn.ravel(), np.zeros(3), np.zeros(4), speeds])

    @staticmethod
    def euler(r):
        return np.array([np.arctan2(r[2, 1], r[2, 2]), -np.arcsin(r[2, 0]), np.arctan2(r[1, 0], r[0, 0])])

    @staticmethod
    def w_inverse(phi, theta):
        sp, cp, ct, tt = np.sin(phi), np.cos(phi), np.cos(theta), np.tan(theta)
        return np.array([[1.0, sp * tt, cp * tt], [0.0, cp, -sp], [0.0, sp / ct, cp / ct]])

    def slope(self, t, x, u, wind):
        v, r, omega, yaw_integral = x[3:6], x[6:15].reshape(3, 3), x[15:18], x[21]
        phi, theta, psi = self.euler(r)
        rates = self.w_inverse(phi, theta) @ omega
        sp, cp, st, ct = np.sin(phi), np.cos(phi), np.sin(theta), np.cos(theta)
        w = np.array([[1.0, 0.0, -st], [0.0, cp, sp * ct], [0.0, -sp, cp * ct]])
        by_phi = np.array([[0.0, 0.0, 0.0], [0.0, -sp, cp * ct], [0.0, -cp, -sp * ct]])
        by_theta = np.array([[0.0, 0.0, -ct], [0.0, 0.0, -sp * st], [0.0, 0.0, -cp * st]])
        a = u[:3] - v
        lift = max(a[2] + G, 0.1 * G)
        theta_d = np.arctan((a[0] * np.cos(psi) + a[1] * np.sin(psi)) / lift)
        phi_d = np.arctan(np.cos(theta_d) * (a[0] * np.sin(psi) - a[1] * np.cos(psi)) / lift)
        expected = np.array(
            [
                60.0 * (phi_d - phi) - 15.0 * rates[0],
                60.0 * (theta_d - theta) - 15.0 * rates[1],
                u[3] - rates[2] + 0.2 * yaw_integral,
            ]
        )
        spin_matrix = np.array([[0, -omega[2], omega[1]], [omega[2], 0, -omega[0]], [-omega[1], omega[0], 0]])
        moment = self.j * (w @ expected + (by_phi * rates[0] + by_theta * rates[1]) @ rates)
        moment = moment + spin_matrix @ (self.j * omega)
        f = np.clip(self.inverse @ np.array([self.believed * lift / (cp * ct), *moment]), 0.0, self.f_max)
        speeds = np.sqrt(f / 0.0024)
        accelerations = np.zeros(0)
        if self.lag is not None:
            accelerations = (speeds - x[22:]) / self.lag
            speeds = x[22:]
        total = self.geometry @ (0.0024 * speeds**2)
        v_r = v - wind
        at_rotors = v_r + (r @ spin_matrix @ self.p.T).T
        drags = -self.propeller * speeds[:, None] * at_rotors
        force = -r @ self.drag @ r.T @ v_r * np.linalg.norm(v_r) + drags.sum(axis=0) + total[0] * r[:, 2]
        torque = total[1:] + np.cross(self.p, drags @ r).sum(axis=0)
        h, h_dot = self.hub * -(self.s @ speeds), (self.hub * -(self.s @ accelerations) if self.lag else 0.0)
        torque = torque - np.array([h * omega[1], -h * omega[0], h_dot])
        omega_dot = (torque - spin_matrix @ (self.j * omega)) / self.j
        return np.concatenate(
            [
                v,
                force / self.mass - [0.0, 0.0, G],
                (r @ spin_matrix).ravel(),
                omega_dot,
                u[:3] - v,
                [u[3] - rates[2]],
                accelerations,
            ]
        )

    def fly(self, steps, velocity, dt=0.005):
        """Outputs (x, y, z, psi) and their rates, roll, pitch and commands u at the samples."""
        l0, kappa_m = 0.2, 4.0166
        kappa_o = np.array([110.651, 110.651, 55.3255, 55.3255])
        tau_av, rho = np.array([0.03, 0.03, 0.06, 0.06]), np.array([1.5, 1.5, 0.5, 0.15])
        u_av, sigma_hat, x = np.zeros(4), np.zeros(4), self.start(velocity)
        rows = []
        for k in range(steps):
            t = k * dt
            a, b = 2 * np.pi * t / 40, 2 * np.pi * t / 60
            wa, wb, q = 2 * np.pi / 40, 2 * np.pi / 60, np.pi / 4
            y_m = np.array([20 * np.sin(a), 20 * np.cos(a), 3 * np.sin(b) + 5, -q * np.sin(a) + q])
            dy_m = np.array([20 * wa * np.cos(a), -20 * wa * np.sin(a), 3 * wb * np.cos(b), -q * wa * np.cos(a)])
            swing = np.array([wa**2, wa**2, wb**2, wa**2])
            ddy_m = -swing * (y_m - np.array([0.0, 0.0, 5.0, q]))
            angles = self.euler(x[6:15].reshape(3, 3))
            psi_dot = (self.w_inverse(*angles[:2]) @ x[15:18])[2]
            y, dy = np.array([*x[:3], angles[2]]), np.array([*x[3:6], psi_dot])
            e = y - y_m
            sigma = dy - dy_m + l0 * e
            root = np.sqrt(np.abs(sigma))
            k_o, tau_m = kappa_o * (root + 1.0), kappa_m * (root + 1.0)
            p, m = dt / tau_av, dt / tau_m
            c = dt * k_o / ((1 + p) * (1 + m))
            free = sigma - (sigma_hat / (1 + m) - c * u_av)
            u_0 = np.clip(free / c, -rho, rho)
            sigma_hat = sigma_hat / (1 + m) + c * (u_0 - u_av)
            u_av = (u_av + p * u_0) / (1 + p)
            nominal = -(1.0 - l0) * l0 * e - (l0 - 1.0 + 1.0 / tau_m) * sigma + dy_m + ddy_m
            rows.append([*y, *dy, *angles[:2], *(-u_av)])
            wind = np.array([8.0, -8.0, 8.0]) if k >= 200 else np.zeros(3)
            held = nominal - u_av
            found = solve_ivp(self.slope, (t, t + dt), x, method="DOP853", rtol=1e-11, atol=1e-12, args=(held, wind))
            assert found.success
            x = found.y[:, -1]
        return np.array(rows)


COLUMNS = (
    [f"{c}_y" for c in CHANNELS] + [f"{c}_y_dot" for c in CHANNELS] + ["phi", "theta"] + [f"{c}_u" for c in CHANNELS]
)


@pytest.mark.parametrize(
    ("vehicle", "numbers", "velocity", "substeps"),
    [
        ({}, {}, [0.0, 0.0, 0.0], (1, 2)),
        (HARSH, HARSH_NUMBERS, [4.0, -3.0, 1.0], (1,)),
    ],
    ids=["case_1", "hexacopter_with_lag"],
)
def test_agrees_with_an_independent_integration(vehicle, numbers, velocity, substeps):
    """3 s of Case 1 at T_s = 5 ms, wind from 1 s: below 1e-7 with one substep, 16 times less with two."""
    table = CASE_1 | {"plant": CASE_1["plant"] | {"vehicle": vehicle, "believed": {"mass": 10.9}, "velocity": velocity}}
    study = dj.Study.from_table(table)
    exact = Independent(**numbers).fly(study.loop.steps, velocity)
    errors = []
    for n in substeps:
        found = dj.simulate(study.override({"loop.substeps": n}))
        assert found.attrs["rotor_limited"] == 0.0
        errors.append(np.array([np.abs(found[c].values - exact[:, i]).max() for i, c in enumerate(COLUMNS)]))
        print(f"\n{n} substeps:", ", ".join(f"{c} {e:.1e}" for c, e in zip(COLUMNS, errors[-1], strict=True)))
    print(f"span of roll {np.ptp(exact[:, 8]):.3f}, pitch {np.ptp(exact[:, 9]):.3f} rad")
    assert min(np.ptp(exact[:, 8]), np.ptp(exact[:, 9])) > 0.005
    assert errors[0].max() < 1e-7
    if len(errors) == 2:
        orders = np.log2(errors[0] / errors[1])
        resolved = errors[1] > 1e-12
        print("orders", np.round(orders, 2), "of", resolved.sum(), "resolved columns")
        assert resolved.sum() >= 8
        assert np.all(np.abs(orders[resolved] - 4.0) < 0.3)


STEPS = {
    "name": "steps",
    "draws": 1,
    "loop": {"duration": 4.0, "sample_time": 0.01},
    "plant": {"kind": "uav", "position": [1.0, 2.0, 3.0], "velocity": [0.5, -1.0, 0.2], "yaw": 0.8},
    "reference": {"kind": "steps", "position": [3.0, -2.0, 5.0], "yaw": -0.4, "at": 0.5},
    "controller": CONTROLLER,
    "wind": {"kind": "constant", "x": 5.0, "y": -7.0, "z": 2.0, "at": 1.0},
}


def test_mirrored_flight_has_mirrored_errors():
    """Initial state, reference, wind and spins mirrored in the plane y = 0: errors of x, z stay, of y, psi turn over.

    Mirrored rotor 2 is rotor 4 and the other way round, so that the spins alone change. The vehicle has a hub and
    propellers that matter.
    """
    vehicle = {"rotor_inertia_z": 0.01, "propeller_drag": 1e-2, "motor_lag": 0.03, "body_inertia": [0.4, 0.6, 0.74]}
    table = STEPS | {"plant": STEPS["plant"] | {"vehicle": vehicle}}
    plain = dj.Study.from_table(table)
    spins = {"spins": [-1.0, 1.0, -1.0, 1.0]}
    mirror = {"plant.position.1": -2.0, "plant.velocity.1": 1.0, "plant.yaw": -0.8}
    mirror |= {"reference.position.1": 2.0, "reference.yaw": 0.4, "wind.y": 7.0}
    turned = dj.Study.from_table(table | {"plant": table["plant"] | {"vehicle": vehicle | spins}})
    for i, row in enumerate(turned.template.plant.allocation):
        mirror |= {f"plant.allocation.{i}.{j}": value for j, value in enumerate(row)}
    mirror |= {f"plant.vehicle.spins.{i}": s for i, s in enumerate(spins["spins"])}
    custom = {name: leaf for name, leaf in plain.leaves().items() if name in mirror}
    custom |= {
        f"plant.allocation.{i}.{j}": v
        for i, row in enumerate(plain.template.plant.allocation)
        for j, v in enumerate(row)
    }
    assert custom.keys() == mirror.keys()
    wrong = mirror | {name: value for name, value in custom.items() if "spins" in name or "allocation" in name}
    stacked = {name: jnp.array([custom[name], mirror[name], wrong[name]]) for name in mirror}

    def fly(values):
        run, recorded = simulate_recorded(plain.loop, plain.params(values), draw_key(0, 0))
        return run.outcome, jnp.stack([s.e for s in recorded.instant.channels])

    outcome, errors = jax.jit(jax.vmap(fly), compiler_options=plain_options())(stacked)
    assert np.all(np.array(outcome) == Outcome.OK)
    sign = np.array([1.0, -1.0, 1.0, -1.0])[:, None]
    gap = np.abs(np.array(errors[1]) - sign * errors[0]).max()
    control = np.abs(np.array(errors[2]) - sign * errors[0]).max()
    print(f"\nmirrored errors differ by {gap:.1e}; with the spins left alone {control:.1e}")
    assert gap < 1e-11
    assert control > 1e-7


def test_a_singular_attitude_is_an_outcome_with_its_time():
    """A storm that tilts beyond 85 degrees ends its draws at the sample where that happens, and not the others."""
    study = dj.Study.from_table(
        STEPS
        | {
            "draws": 6,
            "plant": {"kind": "uav"},
            "reference": {"kind": "hover"},
            "wind": {"kind": "constant", "x": {"choice": [2.0, 900.0]}, "y": 0.0, "z": 0.0, "at": 1.0},
            "requirement": [{"metric": "tilt_max", "max": 1.0}],
        }
    )
    result = dj.run(study)
    stormy = result.dataset["wind.x"].values == 900.0
    outcome, failed_at = result.dataset["outcome"].values, result.dataset["failed_at"].values
    print("\noutcome", outcome, "failed at", failed_at)
    assert 0 < stormy.sum() < 6
    assert set(outcome[stormy]) == {Outcome.SINGULAR_ATTITUDE}
    assert set(outcome[~stormy]) == {Outcome.OK}
    assert np.all(failed_at[stormy] > 1.0)
    assert np.all(np.isnan(failed_at[~stormy]))
    assert np.all(np.isnan(result.dataset["error_rms_x"].values[stormy]))
    assert np.all(np.isfinite(result.dataset["error_rms_x"].values[~stormy]))
    assert np.all(result.dataset["slack_tilt_max"].values[stormy] == -np.inf)
    draw = int(np.flatnonzero(stormy)[0])
    run = dj.replay(result, draw)
    tilt = np.degrees(run["tilt"].values)
    final = run["t"].values < failed_at[draw] - 1e-9
    print(f"tilt before the end {np.nanmax(tilt[final]):.2f} deg")
    assert run.attrs["outcome_meaning"] == "singular_attitude"
    assert run.attrs["failed_at"] == failed_at[draw]
    assert np.nanmax(tilt[final]) <= 85.0
    assert np.nanmax(tilt[final]) > 45.0


BAD = {
    "mass": ({"vehicle": {"mass": -1.0}}, "must be > 0"),
    "mass_law": ({"vehicle": {"mass": {"uniform": [-1.0, 2.0]}}}, "must be > 0"),
    "inertia": ({"vehicle": {"body_inertia": [0.4, -0.4, 0.74]}}, "must be > 0"),
    "triangle": ({"vehicle": {"body_inertia": [0.2, 0.4, 0.74]}}, "triangle inequality"),
    "triangle_law": ({"vehicle": {"body_inertia": [{"uniform": [0.2, 0.4]}, 0.4, 0.74]}}, "triangle inequality"),
    "two_inertias": ({"vehicle": {"body_inertia": [0.4, 0.4]}}, "three values"),
    "no_yaw": ({"vehicle": {"spins": [1.0, 1.0, -1.0, -1.0]}}, "rank 3"),
    "half_spin": ({"vehicle": {"spins": [1.0, -0.5, 1.0, -1.0]}}, "1 or -1"),
    "few_spins": ({"vehicle": {"spins": [1.0, -1.0, 1.0]}}, "one sign a rotor"),
    "three_rotors": ({"vehicle": {"rotor_angles": [0.0, 2.0, 4.0], "spins": [1.0, -1.0, 1.0]}}, "four rotors"),
    "hover": ({"vehicle": {"max_thrust": 26.0}}, "hover needs"),
    "hover_law": ({"vehicle": {"max_thrust": {"uniform": [26.0, 60.0]}}}, "hover needs"),
    "position": ({"position": [1.0, 2.0]}, "three values"),
    "believed": ({"believed": {"mass": 0.0}}, "must be > 0"),
    "believed_inertia": ({"believed": {"inertia": [1.0, 1.0]}}, "three values"),
}
WIND_TABLE = {"kind": "piecewise", "times": [0.0, 3.0, 2.0], "x": [1.0, 2.0, 3.0], "y": [0.0] * 3, "z": [0.0] * 3}


@pytest.mark.parametrize("name", [*BAD, "wind"])
def test_bad_vehicles_are_refused_in_one_line(name):
    change, rule = BAD.get(name, ({}, "must increase"))
    table = STEPS | {"plant": STEPS["plant"] | change}
    if name == "wind":
        table["wind"] = WIND_TABLE
    with pytest.raises(ConfigError, match=rule) as caught:
        dj.Study.from_table(table)
    message = str(caught.value)
    print(f"\n{message}")
    assert "\n" not in message
    assert message.startswith("study: wind.times.2" if name == "wind" else "study: plant.")


def test_a_batch_equals_its_draws():
    """Uncertain mass and drag in Dryden wind: metrics of the batch against those of one trajectory after another."""
    vehicle = {"mass": {"uniform": [9.0, 12.5]}, "propeller_drag": {"loguniform": [1e-6, 1e-3]}, "motor_lag": 0.04}
    wind = {"kind": "dryden", "speed": 6.0, "altitude": 20.0, "airspeed": 6.0, "direction": {"uniform": [0.0, 6.28]}}
    table = STEPS | {"draws": 5, "plant": STEPS["plant"] | {"vehicle": vehicle}, "wind": wind}
    study = dj.Study.from_table(table)
    batch = dj.run(study).dataset
    names = [measure.name for measure in study.measures]

    alone = recorder(study)
    worst = 0.0
    for draw in range(5):
        found = alone(draw, {}).attrs
        assert found["outcome"] == batch["outcome"].values[draw] == Outcome.OK
        for name in names:
            stored = float(batch[name].values[draw])
            worst = max(worst, abs(found[name] - stored) / max(abs(stored), 1e-6))
    spread = min(
        abs(a - b) for a, b in itertools.combinations([float(v) for v in batch["position_error_rms"].values], 2)
    )
    print(f"\nbatch against single {worst:.1e}; draws differ by {spread:.1e}")
    assert worst < 1e-11
    assert spread > 1e-6
