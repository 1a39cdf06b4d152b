"""Roots and peaks of functions of an angle, for many loops at once.

A function takes angles of shape (n, m), which are m angles for each of n loops, and returns values of the same shape.
Its values on a grid of angles are given. All loops are refined together, each by the same number of steps.
"""

from collections.abc import Callable

import numpy as np

ROOT_STEPS = 14  # of the Illinois method
PEAK_STEPS = 24  # of the golden-section search
GOLDEN = 0.5 * (5.0**0.5 - 1.0)  # ratio of the golden section

Response = Callable[[np.ndarray], np.ndarray]
"""A function of angles theta = omega T_s, shape (n, m), with values of that shape, such as G(e^(i theta))."""


def with_touching(function: Response, angles: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Add the angles at which a function comes near 0 and turns back, so that no pair of roots is missed.

    Between two neighbours of the grid the function may cross 0 twice, and then has the same sign at both. Therefore the
    least |value| of each such dip is searched, and its angle is added to the grid.

    Args:
        function: A real function of the angle.
        angles: Ascending, shape (n, m).
        values: The function at the angles, shape (n, m).

    Returns:
        The ascending angles and the values of the function at them, shape (n, m + r) each.
    """
    left = values[:, :-2]
    middle = values[:, 1:-1]
    right = values[:, 2:]
    size = np.abs(middle)
    same_sign = (left * middle > 0.0) & (middle * right > 0.0)
    # places count from the second angle of the grid, so a dip lies between the angles at places and places + 2
    places, is_dip = true_columns(same_sign & (size <= np.abs(left)) & (size <= np.abs(right)))
    if not places.shape[1]:
        return angles, values
    low = np.take_along_axis(angles, places, 1)
    high = np.take_along_axis(angles, places + 2, 1)
    sign = np.sign(np.take_along_axis(values, places + 1, 1))
    dip_angles, _ = golden_section_peak(lambda theta: -sign * function(theta), low, high)
    added_angles = np.where(is_dip, dip_angles, np.take_along_axis(angles, places + 1, 1))  # padding: a grid's angle
    all_angles = np.concatenate([angles, added_angles], axis=1)
    all_values = np.concatenate([values, function(added_angles)], axis=1)
    order = np.argsort(all_angles, axis=1, kind="stable")
    return np.take_along_axis(all_angles, order, 1), np.take_along_axis(all_values, order, 1)


def true_columns(mask: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Column indices of the true entries of each row, shape (n, r), and a mask that is False for padding.

    r is the largest number of true entries in a row; rows with fewer are padded.

    Args:
        mask: Shape (n, m).
    """
    length = int(mask.sum(axis=1).max(initial=0))
    places = np.argsort(~mask, axis=1, kind="stable")[:, :length]
    return places, np.take_along_axis(mask, places, 1)


def roots(function: Response, angles: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Roots of a real function of the angle, one between any two neighbours of different sign, by the Illinois method.

    The method is regula falsi, a secant between two ends of different sign. If one end stays, its value is halved,
    which speeds the convergence up.

    Args:
        function: A real function of the angle.
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
    """The place and the value of the peak of a real function that has one peak in each interval [low, high].

    Args:
        function: A real function of the angle.
        low: Lower ends, shape (n, m).
        high: Upper ends, shape (n, m).

    Returns:
        The angles of the peaks and the values there, shape (n, m) each.
    """
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
    """Largest value of a real function, refined around its largest value on a grid, shape (n,).

    Args:
        function: A real function of the angle.
        angles: The grid, ascending, shape (n, m).
        values: The function at the angles, shape (n, m).
    """
    top = np.argmax(values, axis=1)[:, None]
    low = np.take_along_axis(angles, np.maximum(top - 1, 0), 1)
    high = np.take_along_axis(angles, np.minimum(top + 1, angles.shape[1] - 1), 1)
    _, refined = golden_section_peak(function, low, high)
    return np.maximum(np.max(values, axis=1), refined[:, 0])
