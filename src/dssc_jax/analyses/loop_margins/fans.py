"""Quantiles of frequency responses over the draws, a fan at each frequency; their phases are unwrapped together."""

from itertools import pairwise

import numpy as np

FAN_LEVELS = (0.05, 0.5, 0.95)  # of the quantiles
TURN = 2.0 * np.pi  # [rad]
FARTHEST = 0.75 * TURN  # difference of a curve from the median from which it is shifted by whole turns [rad]
OTHER_SIGN = 0.125  # share of a turn by which a loop that is half a turn away counts as below

FANS = {
    "loop_gain": ("1", "magnitude of L"),
    "loop_phase": ("rad", "phase of L"),
    "sensitivity": ("1", "magnitude of S = 1/(1 + L)"),
    "complementary": ("1", "magnitude of T = L/(1 + L)"),
}
"""Unit and meaning of each magnitude and phase over frequency."""


def fan_quantiles(response: np.ndarray, poles: np.ndarray, angles: np.ndarray) -> dict[str, np.ndarray]:
    """Quantiles over the draws of the quantities in :data:`FANS`, shape (levels, frequencies) each.

    Args:
        response: G = -T, the response from a signal added at the break point to the signal before the sum, shape
            (draws, frequencies); NaN for a draw without an operating point.
        poles: Poles of the loop transfer function L, shape (draws, states).
        angles: omega T_s, shape (frequencies,).
    """
    has_response = np.all(np.isfinite(response), axis=1)
    response = response[has_response]
    if not len(response):
        return {name: np.full((len(FAN_LEVELS), response.shape[1]), np.nan) for name in FANS}
    loop = -response / (1.0 + response)  # L = T/(1 - T) with T = -G
    values_by_name = {
        "loop_gain": np.abs(loop),
        "loop_phase": joint_phase(loop, poles[has_response], angles),
        "sensitivity": np.abs(1.0 + response),
        "complementary": np.abs(response),
    }
    return {name: np.quantile(values, FAN_LEVELS, axis=0) for name, values in values_by_name.items()}


def joint_phase(loop: np.ndarray, poles: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Phases of several loop transfer functions [rad], shape (draws, frequencies), unwrapped so that they compare.

    A phase is known up to whole turns. Three steps choose the turns:

    * Each curve is made continuous over frequency. The phase of its poles is computed exactly, since a lightly damped
      resonance turns the phase by half a turn between two frequencies of the grid.
    * Each curve is shifted by whole turns, so that all curves agree at the frequency where most loops cross the gain 1.
      A loop of the opposite sign lies half a turn below the others there.
    * Elsewhere a curve may still be a whole turn away from the median of all curves, for instance above a resonance
      that is unstable in some draws. It is shifted back there (:func:`turns_apart`).

    Args:
        loop: L, shape (draws, frequencies).
        poles: Poles of L, shape (draws, states).
        angles: omega T_s, ascending, shape (frequencies,).
    """
    phase_of_poles = pole_phase(poles, angles)
    phase_of_zeros = np.unwrap(np.angle(loop * np.exp(1j * phase_of_poles)), axis=1)
    phase = phase_of_zeros - phase_of_poles
    with np.errstate(divide="ignore"):
        log_gain = np.log(np.abs(loop))
    distance_from_crossover = np.median(np.abs(log_gain), axis=0)
    crossover = int(np.argmin(distance_from_crossover))
    middle = np.angle(np.mean(np.exp(1j * phase[:, crossover])))
    middle -= TURN * np.ceil(middle / TURN - 0.25)  # into (-3 pi/2, pi/2], around the phase of an integrator, -pi/2
    phase -= TURN * np.round((phase[:, crossover] - middle) / TURN + OTHER_SIGN)[:, None]
    return phase - TURN * turns_apart(phase - np.median(phase, axis=0), crossover)


def turns_apart(difference: np.ndarray, start: int) -> np.ndarray:
    """Whole turns by which curves of phase differ from their median, shape (draws, frequencies).

    The number of turns of a curve changes only where the difference that remains without these turns exceeds
    :data:`FARTHEST`. A curve that is half a turn from the median, as for a loop of the opposite sign, therefore stays
    on its side of the median at all frequencies.

    Args:
        difference: Difference of each curve from the median [rad], shape (draws, frequencies).
        start: Index of the frequency from which the curves are followed up and down; there the turns are 0.
    """
    turns = np.zeros(difference.shape)
    frequencies = difference.shape[1]
    for before, after in [*pairwise(range(start, frequencies)), *pairwise(range(start, -1, -1))]:
        kept = turns[:, before]
        is_far = np.abs(difference[:, after] - TURN * kept) > FARTHEST
        turns[:, after] = np.where(is_far, np.round(difference[:, after] / TURN), kept)
    return turns


def pole_phase(poles: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Sum of the arguments of e^(j theta) - p over the poles p [rad], shape (draws, angles), continuous in theta.

    With z = e^(j theta), z - p = z (1 - p/z) for a pole inside the unit circle, and z - p = -p (1 - z/p) for a pole
    outside. In both cases the factor in brackets has a positive real part, so that its argument does not jump.

    Args:
        poles: Poles p of each draw, shape (draws, states).
        angles: theta, shape (angles,).
    """
    z = np.exp(1j * angles)
    total = np.zeros((len(poles), angles.size))
    for column in poles.T:
        p = column[:, None]
        is_inside = np.abs(p) <= 1.0
        outer_p = np.where(is_inside, 2.0, p)  # 2 in place of a p that could be 0; the result is not used
        phase_inside = angles + np.angle(1.0 - p / z)
        phase_outside = np.angle(-p) + np.angle(1.0 - z / outer_p)
        total += np.where(is_inside, phase_inside, phase_outside)
    return total
