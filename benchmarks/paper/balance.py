"""Why DSSC oscillates in the comparison: eigenvalues at sigma = 0, and the limit cycle by harmonic balance.

The command's way to the velocity of an axis is T(s), built from the inner loops as they are linearised at hover; with
u_n of (37), a_n = k_n = 1 and no 1/tau_m, sigma = P(s) u with P = (s + l0)/s T/(1 - (a_n - l0) T). At sigma = 0 the law
(22) is a PI controller with K_P = 1/(k_o tau_av) and K_I = K_P/tau_m.

For large sigma the controller itself, sampled and with its limits, is driven by A cos(w t) and answers with the
fundamental N(A, w) A: a limit cycle is where N P = 1.
"""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from scipy.optimize import brentq, least_squares

import dssc_jax as dj
from benchmarks.paper.signals import settled
from dssc_jax.core.signals import Measurement, ReferencePoint
from dssc_jax.models.uav.inner_loops.article import InnerGains

INNER = InnerGains()
L0, DAMPING = 0.2, 1.0  # l0 and a_n of the comparison [1/s]
SECONDS_DRIVEN = 120.0  # s: the second half is looked at

Element = Callable[[float, float, float], complex]
"""Describing function N of (amplitude, frequency, value of the number that is varied)."""


class Cycle(NamedTuple):
    """A limit cycle: frequency [rad/s], amplitudes of the fundamentals of sigma and u [m/s]."""

    frequency: float
    sigma: float
    u: float


def tilt(s: complex, motor_lag: float = 0.0) -> complex:
    """From the wanted to the true tilt: the attitude loop, whose moment the rotors delay."""
    return INNER.kp_attitude / (s * s * (motor_lag * s + 1.0) + INNER.kd_attitude * s + INNER.kp_attitude)


def plant(s: complex, motor_lag: float = 0.0) -> complex:
    """P(s) of the x and y axes."""
    forward = INNER.kd_velocity * tilt(s, motor_lag)
    velocity = forward / (s + forward)
    return (s + L0) / s * velocity / (1.0 - (DAMPING - L0) * velocity)


def eigenvalues(proportional: float, tau_m: float) -> np.ndarray:
    """Poles of P without motor lag under K_P (1 + 1/(tau_m s)), by falling real part [1/s]."""
    stiffness, damping = INNER.kp_attitude, INNER.kd_attitude
    own = np.polymul([1.0, 0.0], np.polyadd(np.polymul([1.0, 0.0], [1.0, damping, stiffness]), [L0 * stiffness]))
    closed = np.polyadd(np.polymul([tau_m, 0.0], own), proportional * stiffness * np.polymul([tau_m, 1.0], [1.0, L0]))
    roots = np.roots(closed)
    return roots[np.argsort(-roots.real)]


def least_tau_m(proportional: float) -> float:
    """tau_m below which the loop is unstable at sigma = 0 [s]."""
    return float(brentq(lambda tau_m: eigenvalues(proportional, tau_m)[0].real, 1e-3, 1e2))


def element(study: dj.Study, varied: str | None = None) -> Element:
    """The x axis' controller, without u_n, as an element of the loop; ``varied`` names a number of its functions."""
    controller, gains = study.loop.controller[0], study.template.controller[0]._replace(nominal=None)
    dt, still = study.loop.sample_time, ReferencePoint(0.0, 0.0, 0.0)
    steps = round(SECONDS_DRIVEN / dt)
    half = steps // 2

    def real(tree):
        return jax.tree.map(lambda leaf: jnp.asarray(leaf, float), tree)

    @jax.jit
    def answer(amplitude, frequency, value):
        used = gains if varied is None else gains._replace(functions=gains.functions._replace(**{varied: value}))

        def sample(state, k):
            seen = Measurement(0.0, amplitude * jnp.cos(frequency * k * dt))  # e = 0, sigma = y'
            state, command, _ = controller.step(used, state, seen, still, dt)
            return real(state), command.robust

        first = real(controller.init(used, Measurement(0.0, amplitude), still))
        _, u = jax.lax.scan(sample, first, jnp.arange(steps))
        phase = frequency * dt * jnp.arange(half, steps)
        waves = jnp.stack([jnp.cos(phase), jnp.sin(phase), jnp.ones(steps - half)], axis=1)
        cosine, sine, _ = jnp.linalg.lstsq(waves, u[half:])[0]
        return (cosine - 1j * sine) / amplitude

    return lambda amplitude, frequency, value: complex(answer(amplitude, frequency, value))


def limit_cycle(found: Element, value: float, guess: Cycle, sample_time: float, motor_lag: float = 0.0) -> Cycle:
    """The limit cycle near a guess; the hold counts as a delay of half a sample.

    Raises:
        RuntimeError: there is none.
    """

    def defect(point: np.ndarray) -> list[float]:
        sigma, frequency = np.exp(point)
        s = 1j * frequency
        gap = found(sigma, frequency, value) * plant(s, motor_lag) * np.exp(-0.5 * s * sample_time) - 1.0
        return [gap.real, gap.imag]

    start = np.log([guess.sigma, guess.frequency])
    solved = least_squares(defect, start, diff_step=3e-4)
    if not solved.cost < 1e-6:
        raise RuntimeError(f"no limit cycle near {guess}: defect {solved.cost:.1e}")
    sigma, frequency = (float(number) for number in np.exp(solved.x))
    return Cycle(frequency, sigma, abs(found(sigma, frequency, value)) * sigma)


def branch(found: Element, values: np.ndarray, guess: Cycle, sample_time: float, motor_lag: float = 0.0) -> list[Cycle]:
    """Limit cycles along values of the varied number, each the guess of the next."""
    cycles: list[Cycle] = []
    for value in values:
        cycles.append(limit_cycle(found, float(value), cycles[-1] if cycles else guess, sample_time, motor_lag))
    return cycles


def relay_cycle(rho: float, sample_time: float, motor_lag: float = 0.0) -> Cycle:
    """That of u = -rho sgn(sigma): the clipped STA, whose implicit form slides with the gain 1/T_s within its limit."""

    def imaginary(frequency: float) -> float:
        s = 1j * frequency
        return (plant(s, motor_lag) * np.exp(-0.5 * s * sample_time)).imag

    frequency = float(brentq(imaginary, 2.0, 20.0))
    u = 4.0 * rho / np.pi
    return Cycle(frequency, abs(plant(1j * frequency, motor_lag)) * u, u)


def fundamental(values: np.ndarray, dt: float) -> tuple[float, float]:
    """Frequency [rad/s] and amplitude of the strongest line of a signal's spectrum, Hann window, padded 32 times."""
    weights = np.hanning(len(values))
    spectrum = np.abs(np.fft.rfft((values - values.mean()) * weights, 32 * len(values)))
    line = int(np.argmax(spectrum))
    return 2.0 * np.pi * line / (32 * len(values) * dt), float(2.0 * spectrum[line] / weights.sum())


def simulated(run: xr.Dataset, axis: str = "x") -> Cycle:
    """The limit cycle of a flight."""
    dt = float(run["t"][1] - run["t"][0])
    frequency, u = fundamental(settled(run, f"{axis}_u"), dt)
    return Cycle(frequency, fundamental(settled(run, f"{axis}_sigma"), dt)[1], u)
