"""Ball arithmetic for the verifier: intervals, and matrices that are positive definite for certain."""

from collections.abc import Sequence
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.certificate import Interval

Balls = dict[str, arb]
"""Balls by name."""


class Rejected(Exception):
    """Raised where a premise cannot be shown; the message names the premise and its place."""


class StageLimits(NamedTuple):
    """Bounds that the stage of a proof shows.

    Args:
        sigma: Bound of |sigma| at the samples [m/s].
        e: Bound of |e| at the samples [m].
        change: Bound of |sigma - s|, the change of sigma in a sample [m/s].
        between: Bound of |e(t)| at all times [m].
        level: Bound of what the state adds to |d| [m/s], under :data:`ENTERED` times these bounds.
        slope: Bound of what the state adds to |d'| [m/s^2], under the same bounds.
        error_change: Bound of the change of e in a sample [m], where phi_1 depends on e; else 0.
    """

    sigma: arb
    e: arb
    change: arb
    between: arb
    level: arb
    slope: arb
    error_change: arb


ENTERED = "1.0001"
"""A multiple of an upper limit, which a signal does not exceed from some sample on."""


def require_premise(holds: bool, reason: str) -> None:
    """Raise :class:`Rejected` with a reason, unless a premise holds."""
    if not holds:
        raise Rejected(reason)


def interval_ball(low: float, high: float) -> arb:
    """The smallest ball that contains an interval."""
    return arb(low).union(arb(high))


def exact_ends(interval: Interval) -> list[arb]:
    """Both ends of an interval, exact; a single number if they agree."""
    low, high = interval
    return [arb(low)] if low == high else [arb(low), arb(high)]


def ball_ends(ball: arb) -> tuple[arb, arb]:
    """Lower and upper end of a ball, exact."""
    return ball.lower(), ball.upper()


def maximum(*numbers: arb) -> arb:
    """The largest of exact numbers."""
    largest, *candidates = numbers
    for number in candidates:
        largest = largest if largest >= number else number
    return largest


def minimum(*numbers: arb) -> arb:
    """The smallest of exact numbers."""
    smallest, *candidates = numbers
    for number in candidates:
        smallest = smallest if smallest <= number else number
    return smallest


def minimum_bound(a: arb, b: arb) -> arb:
    """An upper bound of the smaller of two numbers in balls."""
    return minimum(a.upper(), b.upper())


def total(terms: Sequence[arb]) -> arb:
    """The sum of the terms."""
    return sum(terms, arb(0))


def identity(n: int) -> arb_mat:
    """The unit matrix, (n, n)."""
    return arb_mat([[int(i == j) for j in range(n)] for i in range(n)])


def unit_rows(n: int) -> list[arb_mat]:
    """The rows of the unit matrix, (1, n) each."""
    return [arb_mat([row]) for row in identity(n).tolist()]


def column(matrix: arb_mat, j: int) -> arb_mat:
    """Column j of a matrix, (n, 1)."""
    return arb_mat([[row[j]] for row in matrix.tolist()])


def matrix_of_columns(columns: Sequence[Sequence[arb]]) -> arb_mat:
    """The matrix with these columns."""
    return arb_mat([list(row) for row in zip(*columns, strict=True)])


def side_by_side(*blocks: arb_mat) -> arb_mat:
    """The matrix of blocks with equally many rows, from left to right."""
    rows = []
    for parts in zip(*(block.tolist() for block in blocks), strict=True):
        rows.append([entry for part in parts for entry in part])
    return arb_mat(rows)


def stack(blocks: Sequence[arb_mat]) -> arb_mat:
    """The matrix of blocks with equally many columns, from top to bottom."""
    return arb_mat([row for block in blocks for row in block.tolist()])


def quadratic_form(matrix: arb_mat, state: arb_mat) -> arb:
    """z'Mz, for a matrix M and a column z."""
    return (state.transpose() * matrix * state)[0, 0]


def symmetric_matrix(rows: Sequence[Sequence[float]]) -> arb_mat:
    """A symmetric matrix of exact numbers from its upper triangle, (n, n)."""
    n = len(rows)
    return arb_mat([[arb(rows[min(i, j)][max(i, j)]) for j in range(n)] for i in range(n)])


def symmetric_part(block: list[list[arb]]) -> arb_mat:
    """The mean of a matrix and its transpose.

    The ball of a symmetric matrix need not be symmetric. Both it and its transpose hold the matrix, so their mean does.
    """
    n = len(block)
    return arb_mat([[(block[i][j] + block[j][i]) / 2 for j in range(n)] for i in range(n)])


def approximate_root(matrix: arb_mat) -> arb_mat | None:
    """A lower triangular matrix L of exact numbers with L L' close to the midpoint of a matrix.

    It is a Cholesky factor whose rounding does not matter to the caller. None if the midpoint is not positive definite.
    """
    n = matrix.nrows()
    root = [[arb(0)] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            inner_sum = total([root[i][k] * root[j][k] for k in range(j)])
            difference = matrix[i, j].mid() - inner_sum
            if i != j:
                root[i][j] = (difference / root[j][j]).mid()
                continue
            if not difference.mid() > 0:
                return None
            root[i][i] = difference.mid().sqrt().mid()
    return arb_mat(root)


def positive_definite(matrix: arb_mat) -> bool:
    """Whether every symmetric matrix M in a ball is shown to be positive definite.

    With L L' close to M, the matrix L^-1 M L^-T is close to I. By Gershgorin's theorem it is positive definite if in
    each row the magnitudes of the difference to I add up to less than 1.
    """
    root = approximate_root(matrix)
    if root is None:
        return False
    inverse = root.inv()
    difference = inverse * matrix * inverse.transpose() - identity(matrix.nrows())
    return all(total([abs(entry) for entry in row]) < 1 for row in difference.tolist())


def bound_in_set(inverse: arb_mat, row: arb_mat) -> arb:
    """Upper bound of |row z| over z'Pz <= 1, from the inverse of P."""
    return abs(quadratic_form(inverse, row.transpose())).upper().sqrt().upper()
