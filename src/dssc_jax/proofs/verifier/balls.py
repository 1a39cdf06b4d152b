"""Ball arithmetic for the verifier: balls from intervals, matrices of balls, and a proof of positive definiteness.

A ball (`arb` of FLINT) is an interval, given by midpoint and radius, that contains an exact number. A comparison of two
balls is true only if it holds for all numbers in both. An exact ball has the radius 0.
"""

from collections.abc import Sequence
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.certificate import Interval

Balls = dict[str, arb]
"""Balls by name."""


class Rejected(Exception):
    """Raised where a premise of the theorem cannot be shown; the message names the premise and its place."""


class StageLimits(NamedTuple):
    """The bounds that a stage of a proof shows: of the signals, and of what these add to the disturbance.

    Args:
        sigma: Bound of |sigma| at the samples [m/s].
        e: Bound of |e| at the samples [m].
        change: Bound of |sigma - s|, the change of sigma in a sample [m/s].
        between: Bound of |e(t)| at all times [m].
        level: Bound of what the state adds to |d| [m/s] while the signals are within :data:`ENTERED` times their
            bounds.
        slope: Bound of what the state adds to |d'| [m/s^2], likewise.
        error_change: Bound of the change of e in a sample [m]; 0 where phi_1 does not depend on e.
    """

    sigma: arb
    e: arb
    change: arb
    between: arb
    level: arb
    slope: arb
    error_change: arb


ENTERED = "1.0001"
"""Factor, in decimals, of an upper limit (limit superior); the signal stays within it from some sample on."""


def require_premise(holds: bool, reason: str) -> None:
    """Check a premise: raise :class:`Rejected` with a reason unless it holds."""
    if not holds:
        raise Rejected(reason)


def interval_ball(low: float, high: float) -> arb:
    """The smallest ball that contains an interval."""
    return arb(low).union(arb(high))


def exact_ends(interval: Interval) -> list[arb]:
    """Both ends of an interval as exact balls; a single ball if they agree."""
    low, high = interval
    return [arb(low)] if low == high else [arb(low), arb(high)]


def ball_ends(ball: arb) -> tuple[arb, arb]:
    """Lower and upper end of a ball, as exact balls."""
    return ball.lower(), ball.upper()


def maximum(*numbers: arb) -> arb:
    """The largest of some exact balls. With wider balls, whose comparison may be undecided, the result may be wrong."""
    largest, *candidates = numbers
    for number in candidates:
        largest = largest if largest >= number else number
    return largest


def minimum(*numbers: arb) -> arb:
    """The smallest of some exact balls; wider balls are not allowed, as in :func:`maximum`."""
    smallest, *candidates = numbers
    for number in candidates:
        smallest = smallest if smallest <= number else number
    return smallest


def minimum_bound(a: arb, b: arb) -> arb:
    """An upper bound of min(a, b) for two balls, as an exact ball: the smaller one of their upper ends."""
    return minimum(a.upper(), b.upper())


def total(terms: Sequence[arb]) -> arb:
    """The sum of some balls; 0 if there are none."""
    return sum(terms, arb(0))


def identity(n: int) -> arb_mat:
    """The unit matrix, shape (n, n)."""
    return arb_mat([[int(i == j) for j in range(n)] for i in range(n)])


def unit_rows(n: int) -> list[arb_mat]:
    """The rows of the unit matrix, shape (1, n) each."""
    return [arb_mat([row]) for row in identity(n).tolist()]


def column(matrix: arb_mat, j: int) -> arb_mat:
    """Column j of a matrix, shape (n, 1)."""
    return arb_mat([[row[j]] for row in matrix.tolist()])


def matrix_of_columns(columns: Sequence[Sequence[arb]]) -> arb_mat:
    """Put columns of equal length side by side into one matrix."""
    return arb_mat([list(row) for row in zip(*columns, strict=True)])


def side_by_side(*blocks: arb_mat) -> arb_mat:
    """Join blocks with equally many rows into one matrix, from left to right."""
    columns = [column_entries for block in blocks for column_entries in block.transpose().tolist()]
    return matrix_of_columns(columns)


def stack(blocks: Sequence[arb_mat]) -> arb_mat:
    """Join blocks with equally many columns into one matrix, from top to bottom."""
    return arb_mat([row for block in blocks for row in block.tolist()])


def quadratic_form(matrix: arb_mat, state: arb_mat) -> arb:
    """z'Mz, for a matrix M, shape (n, n), and a column z, shape (n, 1)."""
    return (state.transpose() * matrix * state)[0, 0]


def symmetric_matrix(rows: Sequence[Sequence[float]]) -> arb_mat:
    """A symmetric matrix of exact balls, shape (n, n), from the upper triangle of some rows."""
    n = len(rows)
    return arb_mat([[arb(rows[min(i, j)][max(i, j)]) for j in range(n)] for i in range(n)])


def symmetric_part(rows: list[list[arb]]) -> arb_mat:
    """The mean of a matrix of balls and its transpose, which encloses every symmetric matrix that the balls enclose.

    The balls themselves may be unsymmetric through rounding.

    Args:
        rows: Rows of the matrix, n rows of n balls.
    """
    n = len(rows)
    return arb_mat([[(rows[i][j] + rows[j][i]) / 2 for j in range(n)] for i in range(n)])


def approximate_root(matrix: arb_mat) -> arb_mat | None:
    """A lower triangular matrix L of exact balls with L L' close to the midpoint of a matrix, shape (n, n).

    L is a Cholesky factor, computed row by row. Its rounding errors are not bounded: a caller may use L only where any
    invertible matrix would be valid.

    Returns:
        L; None if a pivot is not positive, so that the midpoint does not appear positive definite.
    """
    n = matrix.nrows()
    root = [[arb(0)] * n for _ in range(n)]
    for i in range(n):
        for j in range(i):
            inner_sum = total([root[i][k] * root[j][k] for k in range(j)])
            root[i][j] = ((matrix[i, j].mid() - inner_sum) / root[j][j]).mid()
        squares = total([root[i][k] * root[i][k] for k in range(i)])
        pivot = (matrix[i, i].mid() - squares).mid()
        if not pivot > 0:
            return None
        root[i][i] = pivot.sqrt().mid()
    return arb_mat(root)


def positive_definite(matrix: arb_mat) -> bool:
    """Whether every symmetric matrix M within a matrix of balls is shown to be positive definite.

    With L L' close to M, the matrix L^-1 M L^-T is close to I. If in each row the magnitudes of its difference from I
    add up to less than 1, it is positive definite by Gershgorin's theorem, and so is M. False proves nothing.
    """
    root = approximate_root(matrix)
    if root is None:
        return False
    inverse = root.inv()
    difference = inverse * matrix * inverse.transpose() - identity(matrix.nrows())
    return all(total([abs(entry) for entry in row]) < 1 for row in difference.tolist())


def bound_in_set(inverse: arb_mat, row: arb_mat) -> arb:
    """Upper bound of |row z| over the set {z'Pz <= 1}: (row P^-1 row')^(1/2), from the inverse of P."""
    return abs(quadratic_form(inverse, row.transpose())).upper().sqrt().upper()
