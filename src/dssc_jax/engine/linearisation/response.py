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

from collections.abc import Callable, Collection
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import matrix_balance, schur

FREQUENCIES = 240  # of a grid
FIRST_FREQUENCY = 0.03  # of a grid, relative to the slowest pole
DECADES = 6.0  # largest span of a grid below the Nyquist frequency
MOST_ENTRIES = 2_000_000  # complex numbers that are computed at once: angles times states of all loops
ROOT_STEPS = 14  # of the Illinois method
PEAK_STEPS = 24  # of the golden-section search
SMALLEST_FACTOR = 1e-6  # smallest gain factor that counts as a crossing, above the rounding of a large loop gain
GOLDEN = 0.5 * (5.0**0.5 - 1.0)
HALF_POWER = 0.5  # |T|^2 at the bandwidth
GAINS = {"gain_upper", "gain_lower"}
AT_CROSSINGS = {"phase", "delay", "crossover"}
PEAKS = {"disk": 0.5, "sensitivity_peak": 1.0, "complementary_peak": 0.0}
"""Offset of each margin that follows from the peak of |G + offset|."""

Response = Callable[[np.ndarray], np.ndarray]
"""Angles theta = omega T_s of shape (n, m) -> G(e^(i theta)), shape (n, m)."""


class ClassicalMargins(NamedTuple):
    """Margins of n loops that are stable; each of shape (n,).

    Args:
        gain_upper: Smallest factor > 1 of the loop gain at which the loop becomes unstable; infinite: none.
        gain_lower: Largest factor < 1 at which it does; 0: none.
        phase: Phase margin [rad]; infinite if the loop gain is never 1.
        delay: Delay margin [s]; infinite if the loop gain is never 1.
        disk: Balanced disk margin alpha, in [0, 2].
        sensitivity_peak: M_s, the largest abs(S).
        complementary_peak: M_t, the largest abs(T).
        crossover: Frequency at which the phase margin is attained [rad/s]; NaN: none.
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
    """The response G(z) = c (z - A)^-1 b of n loops, from the Schur form of each balanced A.

    The Schur form is triangular even if A has no basis of eigenvectors, as with delays. Back substitution then takes
    the angles of all loops at once.

    Args:
        a: Shape (n, states, states).
        b: Shape (n, states).
        c: Shape (n, states).
    """
    order = a.shape[-1]
    triangles = np.empty(a.shape, complex)
    columns = np.empty(b.shape, complex)
    rows = np.empty(c.shape, complex)
    for i, matrix in enumerate(a if order else ()):
        balancing = matrix_balance(matrix, permute=False, separate=True)
        scale = balancing[1][0]
        decomposition = schur(balancing[0], output="complex")
        basis = decomposition[1]
        triangles[i] = decomposition[0]
        columns[i] = basis.conj().T @ (b[i] / scale)
        rows[i] = (c[i] * scale) @ basis

    def response(angles: np.ndarray) -> np.ndarray:
        width = max(1, MOST_ENTRIES // max(1, order * len(angles)))
        parts = [response_at(angles[:, first : first + width]) for first in range(0, angles.shape[1], width)]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def response_at(angles: np.ndarray) -> np.ndarray:
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
    """Angles in (0, pi), evenly spaced in the logarithm, that cover the dynamics of all loops, shape (FREQUENCIES,).

    Args:
        poles: Closed-loop eigenvalues of all loops, any shape.
    """
    return loop_grids(poles.reshape(1, -1))[0]


def loop_grids(poles: np.ndarray) -> np.ndarray:
    """The :func:`common_grid` of each single loop, shape (n, FREQUENCIES).

    Args:
        poles: Closed-loop eigenvalues, shape (n, states).
    """
    rates = np.abs(np.log(np.where(np.abs(poles) > SMALLEST_FACTOR, poles, 1.0).astype(complex)))
    slowest = np.min(np.where(rates > 10.0**-DECADES, rates, np.inf), axis=1, initial=1.0)
    first = np.maximum(FIRST_FREQUENCY * slowest, np.pi * 10.0**-DECADES)
    return np.geomspace(first, np.pi * (1.0 - 1e-9), FREQUENCIES, axis=1)


def margin_angles(a: np.ndarray, b: np.ndarray, c: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """The angles of a search for margins of stable loops, with those of closed-loop and open-loop poles, shape (n, m).

    Args:
        a: State matrices of the closed loops, shape (n, states, states).
        b: Input columns from the break point, shape (n, states).
        c: Output rows to the break point, shape (n, states).
        poles: Eigenvalues of a, shape (n, states).
    """
    open_loop_poles = np.linalg.eigvals(a - b[:, :, None] * c[:, None, :])
    return grid_with_poles(loop_grids(poles), np.concatenate([poles, open_loop_poles], axis=1))


def grid_with_poles(common: np.ndarray, poles: np.ndarray) -> np.ndarray:
    """The angles of n loops with 0, pi and the frequencies of each loop's poles, ascending, shape (n, m).

    A pole above the real axis adds its damped frequency, any other pole its natural frequency.

    Args:
        common: Angles of all loops, shape (count,), or of each loop, shape (n, count).
        poles: Poles of each loop, shape (n, poles).
    """
    natural = np.abs(np.log(np.where(poles == 0.0, -1.0, poles).astype(complex)))
    pole_angles = np.where(np.imag(poles) > 0.0, np.angle(poles), np.minimum(natural, np.pi))
    shared = np.broadcast_to(common, (len(poles), common.shape[-1]))
    ends = np.broadcast_to([0.0, np.pi], (len(poles), 2))
    return np.sort(np.concatenate([ends, shared, pole_angles], axis=1))


def with_touching(function: Response, angles: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Add the angles at which a function comes near 0 and turns back, so that no pair of roots is missed.

    Args:
        function: (angles of shape (n, r)) -> real values.
        angles: Ascending, shape (n, m).
        values: The function at the angles, shape (n, m).

    Returns:
        The ascending angles and the function there, shape (n, m + r).
    """
    left = values[:, :-2]
    middle = values[:, 1:-1]
    right = values[:, 2:]
    size = np.abs(middle)
    same_sign = (left * middle > 0.0) & (middle * right > 0.0)
    places, nearest = true_columns(same_sign & (size <= np.abs(left)) & (size <= np.abs(right)))
    if not places.shape[1]:
        return angles, values
    low = np.take_along_axis(angles, places, 1)
    high = np.take_along_axis(angles, places + 2, 1)
    sign = np.sign(np.take_along_axis(values, places + 1, 1))
    closest = golden_section_peak(lambda theta: -sign * function(theta), low, high)[0]
    fresh = np.where(nearest, closest, np.take_along_axis(angles, places + 1, 1))
    all_angles = np.concatenate([angles, fresh], axis=1)
    all_values = np.concatenate([values, function(fresh)], axis=1)
    order = np.argsort(all_angles, axis=1, kind="stable")
    return np.take_along_axis(all_angles, order, 1), np.take_along_axis(all_values, order, 1)


def true_columns(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Column indices of the true entries of each row, padded to one length, and a mask that is False for padding."""
    length = int(mask.sum(axis=1).max(initial=0))
    places = np.argsort(~mask, axis=1, kind="stable")[:, :length]
    return places, np.take_along_axis(mask, places, 1)


def roots(function: Response, angles: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roots of a real function of the angle, one between any two neighbours of different sign, by the Illinois method.

    Args:
        function: (angles of shape (n, r)) -> real values.
        angles: Ascending, shape (n, m).
        values: The function at the angles, shape (n, m).

    Returns:
        Angles, and a mask of those that are roots, shape (n, r) each.
    """
    angles, values = with_touching(function, angles, values)
    places, is_root = true_columns(values[:, :-1] * values[:, 1:] < 0.0)
    if not places.shape[1]:
        return np.empty(places.shape), is_root
    low = np.take_along_axis(angles, places, 1)
    high = np.take_along_axis(angles, places + 1, 1)
    f_low = np.take_along_axis(values, places, 1)
    f_high = np.take_along_axis(values, places + 1, 1)
    for _ in range(ROOT_STEPS):
        difference = f_high - f_low
        secant_step = f_high * (high - low) / np.where(difference, difference, 1.0)
        estimate = np.where(difference == 0.0, high, high - secant_step)
        estimate = np.clip(estimate, np.minimum(low, high), np.maximum(low, high))
        f_estimate = function(estimate)
        is_crossing = f_estimate * f_high < 0.0  # the root lies between the estimate and the high end
        low = np.where(is_crossing, high, low)
        f_low = np.where(is_crossing, f_high, 0.5 * f_low)
        high = estimate
        f_high = f_estimate
    return high, is_root


def golden_section_peak(function: Response, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The place and the value of the peak of a real function with one peak in each [low, high]; arrays of one shape."""
    left = high - GOLDEN * (high - low)
    right = low + GOLDEN * (high - low)
    f_left = function(left)
    f_right = function(right)
    for _ in range(PEAK_STEPS):
        is_rising = f_right > f_left
        low = np.where(is_rising, left, low)
        high = np.where(is_rising, high, right)
        inner_point = np.where(is_rising, right, left)
        f_inner = np.where(is_rising, f_right, f_left)
        new_point = np.where(is_rising, low + GOLDEN * (high - low), high - GOLDEN * (high - low))
        f_new = function(new_point)
        left = np.where(is_rising, inner_point, new_point)
        right = np.where(is_rising, new_point, inner_point)
        f_left = np.where(is_rising, f_inner, f_new)
        f_right = np.where(is_rising, f_new, f_inner)
    is_right_larger = f_right > f_left
    return np.where(is_right_larger, right, left), np.where(is_right_larger, f_right, f_left)


def refined_peak(function: Response, angles: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Largest value of a real function, refined around its largest value on a grid, shape (n,); as in :func:`roots`."""
    top = np.argmax(values, axis=1)[:, None]
    low = np.take_along_axis(angles, np.maximum(top - 1, 0), 1)
    high = np.take_along_axis(angles, np.minimum(top + 1, angles.shape[1] - 1), 1)
    _, refined = golden_section_peak(function, low, high)
    return np.maximum(np.max(values, axis=1), refined[:, 0])


def classical_margins(respond: Response, angles: np.ndarray, sample_time: float) -> ClassicalMargins:
    """Margins of n stable loops.

    Args:
        respond: G of the loops.
        angles: Ascending angles from 0 to pi between which crossings and peaks are found, shape (n, m).
        sample_time: T_s [s].
    """
    return ClassicalMargins(**named_margins(respond, angles, sample_time, ClassicalMargins._fields))


def named_margins(
    respond: Response, angles: np.ndarray, sample_time: float, names: Collection[str]
) -> dict[str, np.ndarray]:
    """Some margins of n stable loops by name, shape (n,) each.

    Args:
        respond: G of the loops.
        angles: As of :func:`classical_margins`.
        sample_time: T_s [s].
        names: Names of the margins: fields of :class:`ClassicalMargins`, or ``modulus``.
    """
    g = respond(angles)
    margins: dict[str, np.ndarray] = {}
    if GAINS & set(names):
        margins["gain_upper"], margins["gain_lower"] = gain_margins(respond, angles, g)
    if AT_CROSSINGS & set(names):
        margins |= margins_at_crossings(respond, angles, g, sample_time)
    for name, offset in PEAKS.items():
        if name in names or (name == "sensitivity_peak" and "modulus" in names):
            margins[name] = refined_peak(partial(offset_size, respond, offset), angles, np.abs(g + offset))
    if "disk" in margins:
        margins["disk"] = 1.0 / margins["disk"]
    if "modulus" in names:
        margins["modulus"] = 1.0 / margins["sensitivity_peak"]
    if "bandwidth" in names:
        margins["bandwidth"] = bandwidth(respond, angles, g) / sample_time
    return {name: margins[name] for name in names}


def crossing_frequencies(respond: Response, angles: np.ndarray, sample_time: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [rad/s] of one loop at which abs(L) is 1, and at which L is real and negative, ascending.

    Args:
        respond: G of the loop.
        angles: As of :func:`classical_margins`, shape (1, m).
        sample_time: T_s [s].
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
    """|G + offset| at some angles, shape (n, m)."""
    return np.abs(respond(angles) + offset)


def margins_at_crossings(
    respond: Response, angles: np.ndarray, g: np.ndarray, sample_time: float
) -> dict[str, np.ndarray]:
    """Phase and delay margin, and the frequency of the phase margin, from the angles at which the loop gain is 1."""
    crossings, is_crossing = roots(lambda theta: np.real(respond(theta)) + 0.5, angles, np.real(g) + 0.5)
    at = np.where(is_crossing, respond(crossings) if crossings.size else 1.0, 1.0)  # elsewhere 1 + G may be 0
    lag = np.angle(at / (1.0 + at))  # of -L: the remaining phase to -180 degrees
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
    """Upper and lower gain margin, shape (n,) each, from the angles at which G is real, 0 and pi among them."""
    crossings, is_crossing = roots(lambda theta: np.imag(respond(theta)), angles, np.imag(g))
    at = np.real(respond(crossings)) if crossings.size else np.empty(crossings.shape)
    with np.errstate(all="ignore"):
        ends = np.real(g)[:, [0, -1]]
        factors = 1.0 + 1.0 / np.concatenate([np.where(is_crossing, at, np.nan), ends], axis=1)
    is_margin = np.isfinite(factors) & (factors > SMALLEST_FACTOR) & (factors < 1.0 / SMALLEST_FACTOR)
    upper = np.where(is_margin & (factors > 1.0), factors, np.inf).min(axis=1)
    lower = np.where(is_margin & (factors < 1.0), factors, 0.0).max(axis=1)
    return upper, lower


def bandwidth(respond: Response, angles: np.ndarray, g: np.ndarray) -> np.ndarray:
    """Angle beyond which abs(T) stays below 1/sqrt(2), shape (n,); see :class:`ClassicalMargins`."""
    power_above_half = np.abs(g) ** 2 - HALF_POWER
    crossings, is_crossing = roots(lambda theta: np.abs(respond(theta)) ** 2 - HALF_POWER, angles, power_above_half)
    largest = np.where(is_crossing, crossings, -np.inf).max(axis=1, initial=-np.inf)
    largest = np.where(power_above_half[:, -1] > 0.0, np.inf, largest)
    return np.where(np.isneginf(largest), np.nan, largest)
