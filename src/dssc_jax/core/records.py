"""Recorded signals as piecewise cubic functions of time: values held, joined by lines, or by a cubic spline."""

from enum import StrEnum
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from scipy.interpolate import CubicSpline

from dssc_jax.core.errors import ConfigError, errors_under
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ReferencePoint, Scalar

MOST_VALUES = 50_000
TIMES = Quantity("s", "times, rising", law=False, data=True)

Values = tuple[Scalar, ...]


class Pieces(NamedTuple):
    """A piecewise cubic function of time.

    Args:
        begins: Time at which each piece begins [s], shape (n,).
        coefficients: Coefficients of each piece in rising powers of the time since it began, shape (n + 1, 4); the
            first row holds before the first time.
    """

    begins: jax.Array | np.ndarray
    coefficients: jax.Array | np.ndarray


class HeldRecord(NamedTuple):
    """A record whose values are held, with integrals that give its mean over an interval by two searches.

    Args:
        pieces: The values as pieces of degree 0.
        integrals: Integral of the record from its first time to each time [s times the unit of the values], shape (n,).
    """

    pieces: Pieces
    integrals: jax.Array | np.ndarray


class Interpolation(StrEnum):
    """Rule by which values between two recorded times are found: the earlier value, a straight line, or a spline."""

    HOLD = "hold"
    LINEAR = "linear"
    CUBIC = "cubic"


def held_pieces(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return the coefficients of values that are held until the next time, in rising powers, shape (n - 1, 4).

    Args:
        time: Times [s], shape (n,); without effect, since all rules of interpolation have the same arguments.
        value: Values, shape (n,).
    """
    constants = value[:-1, None]
    return np.pad(constants, ((0, 0), (0, 3)))


def line_pieces(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return the coefficients of the straight lines through the values, in rising powers, shape (n - 1, 4).

    Args:
        time: Times [s], shape (n,).
        value: Values, shape (n,).
    """
    slope = np.diff(value) / np.diff(time)
    return np.pad(np.column_stack([value[:-1], slope]), ((0, 0), (0, 2)))


def spline_pieces(time: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Return the coefficients of the natural cubic spline through the values, in rising powers, shape (n - 1, 4).

    The spline's first two derivatives are continuous, and its second derivative is 0 at both ends.

    Args:
        time: Times [s], shape (n,).
        value: Values, shape (n,).
    """
    falling_powers = CubicSpline(time, value, bc_type="natural").c  # shape (4, n - 1)
    return falling_powers[::-1].T


RULES = {Interpolation.HOLD: held_pieces, Interpolation.LINEAR: line_pieces, Interpolation.CUBIC: spline_pieces}


def check_record(time: Values, value: Values) -> None:
    """Require from 2 to :data:`MOST_VALUES` values, one for each time [s], at rising times.

    Raises:
        ConfigError: The number of values is another one, or a time is not above the time before it.
    """
    count = len(time)
    if len(value) != count:
        raise ConfigError("value", f"must hold as many numbers as time, {count}, got {len(value)}")
    if not 2 <= count <= MOST_VALUES:
        raise ConfigError("time", f"must hold 2 to {MOST_VALUES} numbers, got {count}")
    is_falling = np.diff(np.asarray(time, float)) <= 0.0
    if is_falling.any():
        index = int(is_falling.argmax()) + 1  # of the first time that is not above the time before it
        rule = f"must be above the time before it, {time[index - 1]:g} s, got {time[index]:g} s"
        raise ConfigError(f"time.{index}", rule)


def cubic_pieces(time: Values, value: Values, rule: Interpolation) -> Pieces:
    """Return the piecewise cubic through a record; before and after the record it keeps the first and the last value.

    Args:
        time: Times [s].
        value: Values at these times.
        rule: How values between two times are found.

    Raises:
        ConfigError: The record is not valid; see :func:`check_record`.
    """
    check_record(time, value)
    times = np.asarray(time, float)
    values = np.asarray(value, float)
    before, after = np.pad(values[[0, -1], None], ((0, 0), (0, 3)))  # constants
    return Pieces(times, np.concatenate([before[None], RULES[rule](times, values), after[None]]))


def last_time(pieces: Pieces) -> float:
    """Return the time from which a record keeps its last value [s]: the last recorded time."""
    return float(pieces.begins[-1])


def columns_as_pieces(time: Values, columns: dict[str, Values], rule: Interpolation) -> tuple[Pieces, ...]:
    """Return the piecewise cubic through each of several columns with the same times.

    Args:
        time: Times [s].
        columns: Values at these times, by the column's name.
        rule: How values between two times are found.

    Raises:
        ConfigError: The times are not valid (:func:`check_record`), or a column has another length; its name is told.
    """
    parts = []
    for name, values in columns.items():
        is_fault_of_column = len(values) != len(time)
        with errors_under(name if is_fault_of_column else ""):
            parts.append(cubic_pieces(time, values, rule))
    return tuple(parts)


def held_record(pieces: Pieces) -> HeldRecord:
    """Return a record whose values are held, given the values as pieces of degree 0; compute the integrals."""
    areas = np.asarray(pieces.coefficients)[1:-1, 0] * np.diff(np.asarray(pieces.begins))
    return HeldRecord(pieces, np.concatenate([np.zeros(1), np.cumsum(areas)]))


def held_mean(record: HeldRecord, t: Scalar, dt: Scalar) -> Scalar:
    """Return the mean of a held record over [t, t + dt), exactly the present value if no other one begins in between.

    A value that begins at t or at t + dt, up to the rounding error of these times, does not begin in between: it holds
    from t on, or not yet.
    """
    t = jnp.asarray(t, jnp.result_type(float))
    begins = jnp.asarray(record.pieces.begins, t.dtype)
    values = jnp.asarray(record.pieces.coefficients, t.dtype)[:, 0]
    integrals = jnp.asarray(record.integrals, t.dtype)
    end = t + dt
    rounding = 4.0 * jnp.finfo(t.dtype).eps
    first = jnp.searchsorted(begins, t + rounding * jnp.abs(t), side="right", method="scan_unrolled")
    last = jnp.searchsorted(begins, end - rounding * jnp.abs(end), side="left", method="scan_unrolled")
    has_jump = last > first
    next_begin = jnp.minimum(first, len(begins) - 1)
    last_begin = jnp.maximum(last - 1, 0)
    # the integral over the interval: up to the first jump, between the jumps, and from the last jump on
    integral_before = values[first] * (begins[next_begin] - t)
    integral_between = integrals[last_begin] - integrals[next_begin]
    integral_after = values[last] * (end - begins[last_begin])
    integral = integral_before + integral_between + integral_after
    return jnp.where(has_jump, integral / dt, values[first])


def piece_at(pieces: Pieces, t: Scalar) -> ReferencePoint:
    """Return the value of a piecewise cubic at t [s], with its first two derivatives.

    A piece counts from a few units in the last place before its time, because sample times k T_s have rounding errors.
    """
    t = jnp.asarray(t, jnp.result_type(float))
    begins = jnp.asarray(pieces.begins, t.dtype)
    rounded_time = t + 4.0 * jnp.finfo(t.dtype).eps * jnp.abs(t)
    index = jnp.searchsorted(begins, rounded_time, side="right", method="scan_unrolled")
    a, b, c, d = jnp.asarray(pieces.coefficients, t.dtype)[index]
    x = jnp.maximum(t - begins[jnp.maximum(index - 1, 0)], 0.0)
    return ReferencePoint(a + x * (b + x * (c + x * d)), b + x * (2.0 * c + 3.0 * x * d), 2.0 * c + 6.0 * x * d)
