"""Ball arithmetic for the verifier: intervals, and matrices that are positive definite for certain."""

from typing import Any, NamedTuple

from flint import arb, arb_mat

Balls = dict[str, arb]
"""Balls by name."""


class Rejected(Exception):
    """A premise that could not be shown."""


class StageLimits(NamedTuple):
    """Bounds of |sigma| and |e| at the samples, and of |e(t)| at all times.

    ``level`` and ``slope`` bound what the state adds to |d| and |d'|, with :data:`ENTERED` times these bounds.
    ``moved`` bounds the change of e in a sample, where phi_1 depends on e.
    """

    sigma: arb
    e: arb
    between: arb
    level: arb
    slope: arb
    moved: arb


ENTERED = "1.0001"
"""A multiple of an upper limit, which a signal does not exceed from some sample on."""


def require_premise(holds: bool, reason: str) -> None:
    """Reject unless the premise holds."""
    if not holds:
        raise Rejected(reason)


def enclosing(low: float, high: float) -> arb:
    """The smallest ball that contains an interval."""
    return arb(low).union(arb(high))


def exact_ends(pair: Any) -> list[arb]:
    """Both ends of an interval, exact; one if they agree."""
    low, high = pair
    return [arb(low)] if low == high else [arb(low), arb(high)]


def both(ball: arb) -> tuple[arb, arb]:
    """Lower and upper end of a ball, exact."""
    return ball.lower(), ball.upper()


def larger(a: arb, b: arb) -> arb:
    """The larger of two exact numbers."""
    return a if a >= b else b


def symmetric_ball(rows: list[list[float]]) -> arb_mat:
    """P, from its upper triangle."""
    n = len(rows)
    return arb_mat([[arb(rows[min(i, j)][max(i, j)]) for j in range(n)] for i in range(n)])


def symmetrised(block: list[list[arb]]) -> arb_mat:
    """The mean of a matrix and its transpose, both of which contain the same symmetric matrix."""
    n = len(block)
    return arb_mat([[(block[i][j] + block[j][i]) / 2 for j in range(n)] for i in range(n)])


def approximate_root(matrix: arb_mat) -> arb_mat | None:
    """A lower triangular L with L L' close to the matrix's midpoint, in exact numbers; None if there is none."""
    n = matrix.nrows()
    root = [[arb(0)] * n for _ in range(n)]
    for i in range(n):
        for j in range(i + 1):
            left = matrix[i, j].mid() - sum((root[i][k] * root[j][k] for k in range(j)), arb(0))
            if i == j:
                if not left.mid() > 0:
                    return None
                root[i][i] = left.mid().sqrt().mid()
            else:
                root[i][j] = (left / root[j][j]).mid()
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
    near = inverse * matrix * inverse.transpose()
    n = matrix.nrows()
    rows = (sum((abs(near[i, j] - (1 if i == j else 0)) for j in range(n)), arb(0)) for i in range(n))
    return all(row < 1 for row in rows)


def bound_in_set(inverse: arb_mat, row: arb_mat) -> arb:
    """Upper bound of |row z| over z'Pz <= 1, from the inverse of P."""
    return abs((row * inverse * row.transpose())[0, 0]).upper().sqrt().upper()
