"""Classical margins of many sampled loops at once, from the response of the closed loop to a signal added to it.

With G(z) from the added signal to the signal before the sum, negative feedback has the loop transfer function
L = -G/(1 + G), the sensitivity S = 1/(1 + L) = 1 + G and the complementary sensitivity T = L/(1 + L) = -G. The margins
follow from G without cancellation:

* L is real and negative where Im G = 0; the factor of the gain that brings a pole to the unit circle is 1 + 1/G.
* |L| = 1 where Re G = -1/2; the phase to -180 degrees is the angle of G/(1 + G).
* The disk margin of balanced disks is 1/max |S - T|/2 = 1/max |G + 1/2|.

References:
    K. J. Astrom, R. M. Murray, Feedback Systems, 2nd ed. (2021), chapter 10.
    P. Seiler, A. Packard, P. Gahinet, "An introduction to disk margins", IEEE Control Systems Magazine 40 (2020) 78-95.
"""

from collections.abc import Collection
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import matrix_balance, schur

from dssc_jax.engine.linearisation.roots_and_peaks import Response, refined_peak, roots

FREQUENCIES = 240  # of a grid
FIRST_FREQUENCY = 0.03  # of a grid, relative to the slowest pole
DECADES = 6.0  # largest span of a grid below the Nyquist frequency
MOST_ENTRIES = 2_000_000  # complex numbers that are computed at once: angles times states of all loops
SMALLEST_FACTOR = 1e-6  # smallest gain factor that counts as a crossing, above the rounding of a large loop gain
HALF_POWER = 0.5  # |T|^2 at the bandwidth
GAINS = {"gain_upper", "gain_lower"}  # margins at the angles where L is real
AT_CROSSINGS = {"phase", "delay", "crossover"}  # margins at the angles where |L| = 1
PEAKS = {"disk": 0.5, "sensitivity_peak": 1.0, "complementary_peak": 0.0}
"""Offset of each margin that follows from the peak of |G + offset|."""


class ClassicalMargins(NamedTuple):
    """Margins of n loops that are stable; each of shape (n,).

    Args:
        gain_upper: Smallest factor > 1 of the loop gain at which the loop becomes unstable; infinite: there is none.
        gain_lower: Largest factor < 1 of the loop gain at which the loop becomes unstable; 0: there is none.
        phase: Phase margin [rad]; infinite if the loop gain is never 1.
        delay: Delay margin [s]; infinite if the loop gain is never 1.
        disk: Balanced disk margin alpha, in [0, 2].
        sensitivity_peak: M_s, the largest abs(S).
        complementary_peak: M_t, the largest abs(T).
        crossover: Frequency at which the phase margin is attained [rad/s]; NaN: there is none.
        bandwidth: Frequency beyond which abs(T) stays below 1/sqrt(2) [rad/s]; infinite if it does not up to the
            Nyquist frequency, NaN if it is nowhere that large.
    """

    gain_upper: np.ndarray
    gain_lower: np.ndarray
    phase: np.ndarray
    delay: np.ndarray
    disk: np.ndarray
    sensitivity_peak: np.ndarray
    complementary_peak: np.ndarray
    crossover: np.ndarray
    bandwidth: np.ndarray

    @property
    def modulus(self) -> np.ndarray:
        """Modulus margin: smallest distance of L from -1, which is 1/M_s; shape (n,)."""
        return 1.0 / self.sensitivity_peak


def response_of(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> Response:
    """Return the function that gives the frequency response G(z) = c (z - A)^-1 b of n loops.

    The function uses the Schur form A = Q T Q* of each balanced A, with T triangular. The Schur form exists even if A
    has no basis of eigenvectors, as with delays. Back substitution then takes the angles of all loops at once.

    Args:
        a: A, shape (n, states, states).
        b: b, shape (n, states).
        c: c, shape (n, states).
    """
    order = a.shape[-1]
    triangles = np.empty(a.shape, complex)
    columns = np.empty(b.shape, complex)
    rows = np.empty(c.shape, complex)
    loops_with_states = len(a) if order else 0
    for i in range(loops_with_states):
        balancing = matrix_balance(a[i], permute=False, separate=True)
        balanced = balancing[0]
        scale = balancing[1][0]  # of the states; [1][1] permutes them, which is off
        decomposition = schur(balanced, output="complex")
        triangles[i] = decomposition[0]
        basis = decomposition[1]
        columns[i] = basis.conj().T @ (b[i] / scale)
        rows[i] = (c[i] * scale) @ basis

    def response(angles: np.ndarray) -> np.ndarray:
        """G at any number of angles, shape (n, m), computed in parts of a limited size."""
        width = max(1, MOST_ENTRIES // max(1, order * len(angles)))
        parts = [response_at(angles[:, first : first + width]) for first in range(0, angles.shape[1], width)]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def response_at(angles: np.ndarray) -> np.ndarray:
        """G at some angles, shape (n, m), by back substitution in (z - T) x = Q* b."""
        z = np.exp(1j * angles)
        total = np.zeros(angles.shape, complex)
        right_sides = np.repeat(columns[:, :, None], angles.shape[1], axis=2)
        for i in reversed(range(order)):  # element by element, so that no loop's digits depend on the others
            x = right_sides[:, i] / (z - triangles[:, i, i, None])
            right_sides[:, :i] += triangles[:, :i, i, None] * x[:, None]
            total += rows[:, i, None] * x
        return total

    return response


def common_grid(poles: np.ndarray) -> np.ndarray:
    """Angles theta = omega T_s in (0, pi) at which all loops are evaluated, shape (FREQUENCIES,).

    The angles are evenly spaced in the logarithm, from below the slowest pole to the Nyquist frequency.

    Args:
        poles: Closed-loop eigenvalues of all loops, any shape.
    """
    return loop_grids(poles.reshape(1, -1))[0]


def loop_grids(poles: np.ndarray) -> np.ndarray:
    """Angles theta = omega T_s in (0, pi) at which each loop is evaluated, shape (n, FREQUENCIES).

    The grid is as in :func:`common_grid`, but follows each loop's own slowest pole.

    Args:
        poles: Closed-loop eigenvalues, shape (n, states).
    """
    finite_poles = np.where(np.abs(poles) > SMALLEST_FACTOR, poles, 1.0)  # a pole at 0, a delay, has no rate
    rates = np.abs(np.log(finite_poles.astype(complex)))
    slowest = np.min(np.where(rates > 10.0**-DECADES, rates, np.inf), axis=1, initial=1.0)
    first = np.maximum(FIRST_FREQUENCY * slowest, np.pi * 10.0**-DECADES)
    return np.geomspace(first, np.pi * (1.0 - 1e-9), FREQUENCIES, axis=1)


def margin_angles(a: np.ndarray, b: np.ndarray, c: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """The angles between which margins of n stable loops are searched, ascending, shape (n, m).

    The angles are a grid and the frequencies of the closed-loop and open-loop poles, near which the response may be
    steep.

    Args:
        a: State matrices of the closed loops, shape (n, states, states).
        b: Input columns from the break point, shape (n, states).
        c: Output rows to the break point, shape (n, states).
        poles: Eigenvalues of a, shape (n, states).
    """
    open_loop_poles = np.linalg.eigvals(a - b[:, :, None] * c[:, None, :])
    return grid_with_poles(loop_grids(poles), np.concatenate([poles, open_loop_poles], axis=1))


def grid_with_poles(common: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """Add 0, pi and the frequencies of each loop's poles to a grid of angles; ascending, shape (n, m).

    A pole above the real axis adds its damped frequency. Any other pole adds its natural frequency.

    Args:
        common: Angles of all loops, shape (count,), or of each loop, shape (n, count).
        poles: Poles of each loop, shape (n, poles).
    """
    nonzero_poles = np.where(poles == 0.0, -1.0, poles)  # a pole at 0, a delay, adds pi once more
    natural = np.abs(np.log(nonzero_poles.astype(complex)))
    pole_angles = np.where(np.imag(poles) > 0.0, np.angle(poles), np.minimum(natural, np.pi))
    shared = np.broadcast_to(common, (len(poles), common.shape[-1]))
    ends = np.broadcast_to([0.0, np.pi], (len(poles), 2))
    return np.sort(np.concatenate([ends, shared, pole_angles], axis=1))


def classical_margins(respond: Response, angles: np.ndarray, sample_time: float) -> ClassicalMargins:
    """All classical margins of n stable loops.

    Args:
        respond: G of the loops.
        angles: Ascending angles from 0 to pi between which crossings and peaks are found, shape (n, m).
        sample_time: Sample time T_s [s].
    """
    return ClassicalMargins(**named_margins(respond, angles, sample_time, ClassicalMargins._fields))


def named_margins(
    respond: Response, angles: np.ndarray, sample_time: float, names: Collection[str]
) -> dict[str, np.ndarray]:
    """Some margins of n stable loops by name, shape (n,) each.

    Args:
        respond: G of the loops.
        angles: Ascending angles from 0 to pi between which crossings and peaks are found, shape (n, m).
        sample_time: Sample time T_s [s].
        names: Names of the margins: fields of :class:`ClassicalMargins`, or ``modulus``.
    """
    g = respond(angles)
    margins: dict[str, np.ndarray] = {}
    if GAINS & set(names):
        margins["gain_upper"], margins["gain_lower"] = gain_margins(respond, angles, g)
    if AT_CROSSINGS & set(names):
        margins |= margins_at_crossings(respond, angles, g, sample_time)
    peaks = {*names, "sensitivity_peak"} if "modulus" in names else set(names)  # the modulus margin is 1/M_s
    for name, offset in PEAKS.items():
        if name in peaks:
            margins[name] = refined_peak(partial(offset_size, respond, offset), angles, np.abs(g + offset))
    if "disk" in margins:
        margins["disk"] = 1.0 / margins["disk"]
    if "modulus" in names:
        margins["modulus"] = 1.0 / margins["sensitivity_peak"]
    if "bandwidth" in names:
        margins["bandwidth"] = bandwidth(respond, angles, g) / sample_time
    return {name: margins[name] for name in names}


def crossing_frequencies(respond: Response, angles: np.ndarray, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
    """The frequencies of one loop at which abs(L) is 1, and those at which L is real and negative [rad/s], ascending.

    Roots of real functions give both: abs(L) = 1 where Re G = -1/2, and L is real where Im G = 0.

    Args:
        respond: G of the loop.
        angles: Ascending angles from 0 to pi between which crossings are found, shape (1, m).
        sample_time: Sample time T_s [s].
    """
    g = respond(angles)
    gains, is_gain = roots(lambda theta: np.real(respond(theta)) + 0.5, angles, np.real(g) + 0.5)
    phases, is_phase = roots(lambda theta: np.imag(respond(theta)), angles, np.imag(g))
    inner = phases[is_phase]
    is_inner = (inner > np.pi * 10.0**-DECADES) & (inner < np.pi * (1.0 - 10.0**-DECADES))  # no rounding at the ends
    phases = np.append(inner[is_inner], np.pi)
    at = respond(phases[None, :])[0]
    with np.errstate(all="ignore"):
        is_negative = np.real(-at / (1.0 + at)) < -SMALLEST_FACTOR
    return np.sort(gains[is_gain]) / sample_time, np.sort(phases[is_negative]) / sample_time


def offset_size(respond: Response, offset: float, angles: np.ndarray) -> np.ndarray:
    """The size |G + offset| of the shifted response at some angles, shape (n, m).

    Args:
        respond: G of n loops.
        offset: The shift, a real number.
        angles: The angles [rad], shape (n, m).
    """
    return np.abs(respond(angles) + offset)


def margins_at_crossings(
    respond: Response, angles: np.ndarray, g: np.ndarray, sample_time: float
) -> dict[str, np.ndarray]:
    """Phase margin, delay margin and crossover by name, shape (n,) each, from the angles at which |L| is 1.

    Args:
        respond: G of the loops.
        angles: Ascending angles, shape (n, m).
        g: G at these angles, shape (n, m).
        sample_time: Sample time T_s [s].
    """
    crossings, is_crossing = roots(lambda theta: np.real(respond(theta)) + 0.5, angles, np.real(g) + 0.5)
    g_at_crossings = respond(crossings) if crossings.size else 1.0
    at = np.where(is_crossing, g_at_crossings, 1.0)  # at other angles 1 + G may be 0
    lag = np.angle(at / (1.0 + at))  # angle of -L: the phase that remains to -180 degrees
    size = np.where(is_crossing, np.abs(lag), np.inf)
    safe_angles = np.where(is_crossing, crossings, 1.0)
    delays = np.where(is_crossing, np.mod(lag, 2.0 * np.pi) * sample_time / safe_angles, np.inf)
    phase = np.full(len(g), np.inf)
    crossover = np.full(len(g), np.nan)
    if size.shape[1]:
        nearest = np.argmin(size, axis=1)[:, None]
        phase = np.take_along_axis(size, nearest, 1)[:, 0]
        frequency = np.take_along_axis(crossings, nearest, 1)[:, 0] / sample_time
        crossover = np.where(np.isfinite(phase), frequency, np.nan)
    return {"phase": phase, "delay": delays.min(axis=1, initial=np.inf), "crossover": crossover}


def gain_margins(respond: Response, angles: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Upper and lower gain margin, shape (n,) each, from the angles at which G is real, including 0 and pi.

    At such an angle, the factor 1 + 1/G of the loop gain puts a pole on the unit circle.

    Args:
        respond: G of the loops.
        angles: Ascending angles from 0 to pi, shape (n, m).
        g: G at these angles, shape (n, m).
    """
    crossings, is_crossing = roots(lambda theta: np.imag(respond(theta)), angles, np.imag(g))
    at_crossings = np.real(respond(crossings)) if crossings.size else np.empty(crossings.shape)
    at_crossings = np.where(is_crossing, at_crossings, np.nan)
    at_ends = np.real(g)[:, [0, -1]]  # angles 0 and pi
    with np.errstate(all="ignore"):
        factors = 1.0 + 1.0 / np.concatenate([at_crossings, at_ends], axis=1)
    is_margin = np.isfinite(factors) & (factors > SMALLEST_FACTOR) & (factors < 1.0 / SMALLEST_FACTOR)
    upper = np.where(is_margin & (factors > 1.0), factors, np.inf).min(axis=1)
    lower = np.where(is_margin & (factors < 1.0), factors, 0.0).max(axis=1)
    return upper, lower


def bandwidth(respond: Response, angles: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Angle beyond which abs(T) = abs(G) stays below 1/sqrt(2), shape (n,).

    The angle is infinite if abs(T) exceeds 1/sqrt(2) at the Nyquist frequency, and NaN if abs(T) exceeds it nowhere.

    Args:
        respond: G of the loops.
        angles: Ascending angles from 0 to pi, shape (n, m).
        g: G at these angles, shape (n, m).
    """
    power_above_half = np.abs(g) ** 2 - HALF_POWER
    crossings, is_crossing = roots(lambda theta: np.abs(respond(theta)) ** 2 - HALF_POWER, angles, power_above_half)
    largest = np.where(is_crossing, crossings, -np.inf).max(axis=1, initial=-np.inf)
    largest = np.where(power_above_half[:, -1] > 0.0, np.inf, largest)
    return np.where(np.isneginf(largest), np.nan, largest)
