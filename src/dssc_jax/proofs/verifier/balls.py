"""Ball arithmetic for the verifier: intervals, and matrices that are positive definite for certain."""

from collections.abc import Sequence
from typing import NamedTuple

from flint import arb, arb_mat

from dssc_jax.proofs.verifier.certificate import Interval

Balls = dict[str, arb]
"""Balls by name."""


class Rejected(Exception):
    """A premise that could not be shown."""


class StageLimits(NamedTuple):
    """Bounds of |sigma|, |e| and |sigma - s| at the samples, and of |e(t)| at all times.

    ``level`` and ``slope`` bound what the state adds to |d| and |d'|, with :data:`ENTERED` times these bounds.
    ``error_change`` bounds the change of e in a sample, where phi_1 depends on e.
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
    """Reject unless the premise holds."""
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


def maximum(a: arb, b: arb) -> arb:
    """The larger of two exact numbers."""
    return a if a >= b else b


def total(terms: Sequence[arb]) -> arb:
    """The sum."""
    return sum(terms, arb(0))


def identity(n: int) -> arb_mat:
    """The unit matrix."""
    return arb_mat([[int(i == j) for j in range(n)] for i in range(n)])


def column(matrix: arb_mat, j: int) -> arb_mat:
    """A column, (n, 1)."""
    return arb_mat([[row[j]] for row in matrix.tolist()])


def matrix_of_columns(columns: Sequence[Sequence[arb]]) -> arb_mat:
    """The matrix with these columns."""
    return arb_mat([list(row) for row in zip(*columns, strict=True)])


def side_by_side(left: arb_mat, right: arb_mat) -> arb_mat:
    """Two matrices with the same number of rows, beside each other."""
    pairs = zip(left.tolist(), right.tolist(), strict=True)
    return arb_mat([[*left_row, *right_row] for left_row, right_row in pairs])


def quadratic_form(matrix: arb_mat, state: arb_mat) -> arb:
    """z'Mz of a column z."""
    return (state.transpose() * matrix * state)[0, 0]


def symmetric_matrix(rows: Sequence[Sequence[float]]) -> arb_mat:
    """P, from its upper triangle."""
    n = len(rows)
    return arb_mat([[arb(rows[min(i, j)][max(i, j)]) for j in range(n)] for i in range(n)])


def symmetric_part(block: list[list[arb]]) -> arb_mat:
    """The mean of a matrix and its transpose, both of which contain the same symmetric matrix."""
    n = len(block)
    return arb_mat([[(block[i][j] + block[j][i]) / 2 for j in range(n)] for i in range(n)])


def approximate_root(matrix: arb_mat) -> arb_mat | None:
    """A lower triangular L with L L' close to the matrix's midpoint, in exact numbers; None if there is none."""
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
    """Whether every symmetric matrix in the ball is positive definite.

    With L L' close to it, L^-1 M L^-T lies within I plus a small ball; each row's sum of magnitudes of the difference
    to I is below 1 (Gershgorin).
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
