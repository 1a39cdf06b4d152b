"""A multirotor's equations of motion in NumPy, from rotation matrices: an independent model for the tests of proofs.

Derivatives in time are complex steps along the state's own rates, so that no formula of the page is used.
"""

from dataclasses import dataclass

import numpy as np

GRAVITY = 9.81
STEP = 1e-30


@dataclass
class Multirotor:
    """One vehicle: the true numbers and, with the suffix ``_n``, the believed ones."""

    mass: float
    inertia: np.ndarray
    k_t: float
    mass_n: float
    inertia_n: np.ndarray
    k_n: float
    rotors: int
    arm: float
    c_tau: float
    lag: float
    hub: float
    k_h: float
    k_z: float
    k_p: float
    a_0: float
    a_1: float

    @property
    def places(self) -> np.ndarray:
        """Directions of the rotors, (n, 3)."""
        angle = 2.0 * np.pi * np.arange(self.rotors) / self.rotors
        return np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)

    @property
    def spins(self) -> np.ndarray:
        """Alternating signs."""
        return np.where(np.arange(self.rotors) % 2 == 0, 1.0, -1.0)

    def wrench(self, thrusts: np.ndarray) -> np.ndarray:
        """Net thrust and moment of the rotors' thrusts, (4,)."""
        forces = thrusts[:, None] * np.array([0.0, 0.0, 1.0])
        moment = np.cross(self.arm * self.places, forces).sum(axis=0)
        moment = moment + np.array([0.0, 0.0, self.c_tau * (self.spins * thrusts).sum()])
        return np.concatenate([[thrusts.sum()], moment])

    def allocated(self, wrench: np.ndarray) -> np.ndarray:
        """Thrusts of the pseudo-inverse."""
        matrix = np.stack([self.wrench(unit) for unit in np.eye(self.rotors)], axis=1)
        return np.linalg.pinv(matrix) @ wrench


@dataclass
class Motion:
    """A state: velocity, Euler angles and their rates, speeds of the rotors, the wanted accelerations, and the wind."""

    velocity: np.ndarray
    angles: np.ndarray
    rates: np.ndarray
    speeds: np.ndarray
    wanted: np.ndarray
    eta_psi: float
    wind: np.ndarray


def rotation(angles: np.ndarray) -> np.ndarray:
    """R = R_z(psi) R_y(theta) R_x(phi)."""
    phi, theta, psi = angles
    zero, one = 0.0 * phi, 1.0 + 0.0 * phi
    about_x = np.array([[one, zero, zero], [zero, np.cos(phi), -np.sin(phi)], [zero, np.sin(phi), np.cos(phi)]])
    about_y = np.array([[np.cos(theta), zero, np.sin(theta)], [zero, one, zero], [-np.sin(theta), zero, np.cos(theta)]])
    about_z = np.array([[np.cos(psi), -np.sin(psi), zero], [np.sin(psi), np.cos(psi), zero], [zero, zero, one]])
    return about_z @ about_y @ about_x


def body_rate(angles: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Omega, from R' = R [Omega]_x with the derivatives of R by complex steps."""
    r = rotation(angles)
    slope = sum(rates[i] * rotation(angles + 1j * STEP * np.eye(3)[i]).imag / STEP for i in range(3))
    spin = r.T @ slope
    return np.array([spin[2, 1], spin[0, 2], spin[1, 0]])


def rate_matrix(angles: np.ndarray) -> np.ndarray:
    """W with Omega = W (phi', theta', psi')', for complex angles, too."""
    phi, theta, _ = angles
    zero, one = 0.0 * phi, 1.0 + 0.0 * phi
    return np.array(
        [
            [one, zero, -np.sin(theta)],
            [zero, np.cos(phi), np.sin(phi) * np.cos(theta)],
            [zero, -np.sin(phi), np.cos(phi) * np.cos(theta)],
        ]
    )


def rate_matrix_slope(angles: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """W'."""
    return rate_matrix(angles + 1j * STEP * rates).imag / STEP


def wanted_angles(at: Motion) -> np.ndarray:
    """phi_d and theta_d of the inner loops."""
    psi = at.angles[2]
    up = at.wanted[2] + GRAVITY
    forward = at.wanted[0] * np.cos(psi) + at.wanted[1] * np.sin(psi)
    left = at.wanted[0] * np.sin(psi) - at.wanted[1] * np.cos(psi)
    theta_d = np.arctan(forward / up)
    return np.array([np.arctan(np.cos(theta_d) * left / up), theta_d])


def commanded(craft: Multirotor, at: Motion) -> np.ndarray:
    """Commanded thrusts of the rotors."""
    eta = np.append(craft.a_0 * (wanted_angles(at) - at.angles[:2]) - craft.a_1 * at.rates[:2], at.eta_psi)
    omega = body_rate(at.angles, at.rates)
    turning = rate_matrix(at.angles) @ eta + rate_matrix_slope(at.angles, at.rates) @ at.rates
    moment = craft.inertia_n * turning + np.cross(omega, craft.inertia_n * omega)
    thrust = craft.mass_n * (GRAVITY + at.wanted[2]) / (np.cos(at.angles[0]) * np.cos(at.angles[1]))
    return craft.allocated(np.concatenate([[thrust], moment]))


def accelerations(craft: Multirotor, at: Motion, spin_ups: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """v' and the second derivatives of the Euler angles, rotor by rotor."""
    r = rotation(at.angles)
    omega = body_rate(at.angles, at.rates)
    air = at.velocity - at.wind
    in_body = r.T @ air
    force = -np.linalg.norm(air) * np.array([craft.k_h, craft.k_h, craft.k_z]) * in_body
    torque = np.zeros(3)
    for place, speed in zip(craft.arm * craft.places, at.speeds, strict=True):
        blade = -craft.k_p * speed * (in_body + np.cross(omega, place))
        force = force + blade
        torque = torque + np.cross(place, blade)
    thrust, *moment = craft.wrench(craft.k_t * at.speeds**2)
    spin = -(craft.spins * at.speeds).sum() * craft.hub
    spin_up = -(craft.spins * spin_ups).sum() * craft.hub
    torque = torque + moment - np.array([0.0, 0.0, spin_up]) - np.cross(omega, [0.0, 0.0, spin])
    omega_dot = (torque - np.cross(omega, craft.inertia * omega)) / craft.inertia
    v_dot = (r @ (force + np.array([0.0, 0.0, thrust]))) / craft.mass - [0.0, 0.0, GRAVITY]
    turned = omega_dot - rate_matrix_slope(at.angles, at.rates) @ at.rates
    return v_dot, np.linalg.solve(rate_matrix(at.angles), turned)


def turned(psi: complex, angles: np.ndarray) -> np.ndarray:
    """R_psi (theta, -phi), of angles or of what belongs to them."""
    phi, theta = angles[0], angles[1]
    return np.array([np.cos(psi) * theta + np.sin(psi) * phi, np.sin(psi) * theta - np.cos(psi) * phi])


def tilt_slope(angles: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """The derivative of R_psi (theta, -phi), for complex arguments, too."""
    x, y = turned(angles[2], angles)
    return rates[2] * np.array([-y, x]) + turned(angles[2], rates)


def lift_of(craft: Multirotor, angles: np.ndarray, speeds: np.ndarray) -> complex:
    """q = P cos phi cos theta - g."""
    return craft.k_n * (speeds**2).sum() / craft.mass_n * np.cos(angles[0]) * np.cos(angles[1]) - GRAVITY


def believed_turning(craft: Multirotor, speeds: np.ndarray) -> np.ndarray:
    """mu, for complex speeds, too."""
    return craft.wrench(craft.k_n * speeds**2)[1:] / craft.inertia_n


def believed_gamma(craft: Multirotor, angles: np.ndarray, speeds: np.ndarray) -> np.ndarray:
    """gamma = g R_psi (mu_y, -mu_x)."""
    return GRAVITY * turned(angles[2], believed_turning(craft, speeds))


def signals_and_remainders(
    craft: Multirotor, at: Motion, dampings: tuple[float, float]
) -> tuple[dict[str, dict[str, float]], dict[str, dict[str, float]]]:
    """Magnitudes of the signals that the map F takes, and of the remainders, of one state.

    Args:
        craft: The vehicle.
        at: Its state. Without a rotor lag the speeds follow from the commanded thrusts.
        dampings: c of the plane and of z.
    """
    lagging = craft.lag > 0.0
    thrusts = commanded(craft, at)
    wanted_speeds = np.sqrt(thrusts / craft.k_n)
    spin_ups = (wanted_speeds - at.speeds) / craft.lag if lagging else np.zeros(craft.rotors)
    if not lagging:
        at = Motion(at.velocity, at.angles, at.rates, wanted_speeds, at.wanted, at.eta_psi, at.wind)
    v_dot, angles_dd = accelerations(craft, at, spin_ups)
    norm = np.linalg.norm
    alpha = GRAVITY * turned(at.angles[2], at.angles)
    alpha_dot = GRAVITY * tilt_slope(at.angles, at.rates)
    step = 1j * STEP
    alpha_dd = GRAVITY * tilt_slope(at.angles + step * at.rates, at.rates + step * angles_dd).imag / STEP
    turn = craft.a_0 * (at.wanted[:2] - alpha) - craft.a_1 * alpha_dot
    signals = {
        "x": {"speed": norm(at.velocity[:2]), "alpha": norm(alpha), "alpha_dot": norm(alpha_dot)},
        "z": {"e_dot": abs(at.velocity[2]), "wanted": abs(at.wanted[2])},
        "psi": {"e": 1.0, "e_dot": abs(at.rates[2]), "wanted": abs(at.eta_psi)},
    }
    signals["x"] |= {"wanted": norm(at.wanted[:2]), "turn": norm(turn)}
    rests = {"x": {"force": norm(v_dot[:2] - alpha + dampings[0] * at.velocity[:2])}}
    if not lagging:
        rests["x"]["torque"] = norm(alpha_dd - turn)
        rests["z"] = {"force": v_dot[2] - at.wanted[2] + dampings[1] * at.velocity[2]}
        rests["psi"] = {"torque": abs(angles_dd[2] - at.eta_psi)}
        return signals, rests
    gamma = believed_gamma(craft, at.angles, at.speeds)
    lift = lift_of(craft, at.angles, at.speeds)
    mu_z = believed_turning(craft, at.speeds)[2]
    moved = at.angles + step * at.rates
    faster = at.speeds + step * spin_ups
    gamma_dot = believed_gamma(craft, moved, faster).imag / STEP
    lift_dot = lift_of(craft, moved, faster).imag / STEP
    mu_z_dot = believed_turning(craft, faster)[2].imag / STEP
    signals["x"] |= {"gamma": norm(gamma), "behind": norm(turn - gamma)}
    signals["z"] |= {"lift": abs(lift), "behind": abs(at.wanted[2] - lift)}
    signals["psi"] |= {"gamma": abs(mu_z), "behind": abs(at.eta_psi - mu_z)}
    rests["x"] |= {"torque": norm(alpha_dd - gamma), "lag": norm(gamma_dot - (turn - gamma) / craft.lag)}
    rests["z"] = {
        "force": v_dot[2] - lift + dampings[1] * at.velocity[2],
        "lag": abs(lift_dot - (at.wanted[2] - lift) / craft.lag),
    }
    rests["psi"] = {"torque": abs(angles_dd[2] - mu_z), "lag": abs(mu_z_dot - (at.eta_psi - mu_z) / craft.lag)}
    return signals, rests


def plane_remainders(craft: Multirotor, at: Motion, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """The remainders of the force and of the torque in the plane as vectors, without a rotor lag.

    Args:
        craft: The vehicle.
        at: Its state; the speeds follow from the commanded thrusts.
        damping: c of the plane.
    """
    speeds = np.sqrt(commanded(craft, at) / craft.k_n)
    at = Motion(at.velocity, at.angles, at.rates, speeds, at.wanted, at.eta_psi, at.wind)
    v_dot, angles_dd = accelerations(craft, at, np.zeros(craft.rotors))
    alpha = GRAVITY * turned(at.angles[2], at.angles)
    alpha_dot = GRAVITY * tilt_slope(at.angles, at.rates)
    step = 1j * STEP
    alpha_dd = GRAVITY * tilt_slope(at.angles + step * at.rates, at.rates + step * angles_dd).imag / STEP
    turn = craft.a_0 * (at.wanted[:2] - alpha) - craft.a_1 * alpha_dot
    return v_dot[:2] - alpha + damping * at.velocity[:2], alpha_dd - turn
