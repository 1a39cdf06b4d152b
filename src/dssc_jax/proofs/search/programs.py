"""Semidefinite programs for a common V = z'Pz, solved by Clarabel in scaled coordinates and divided by T_s."""

import importlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import cholesky, solve_discrete_lyapunov

from dssc_jax.proofs.search.sampled_loop import Step

clarabel: Any = importlib.import_module("clarabel")  # its extension module has no types
SLACK = 1e-7
"""Smallest eigenvalue that is asked of every scaled matrix, so that rounding P does not spoil the proof."""
TIGHT = 1e-4
"""Room that is left in every bound, for the same reason."""
TRIES = 3
"""Number of coordinates that are tried."""
FIRST_STEPS = 16
"""Number of steps in the first program."""
ADDED = 6
"""Number of violated steps that join a program at a time."""
GAP = 1e-4
"""Accuracy of a program's cost; its inequalities are met as well as Clarabel meets them by default."""
SOLVED = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)


class Affine(NamedTuple):
    """A symmetric matrix that is affine in the program's variables.

    Args:
        origin: Its value at zero, (k, k).
        slopes: What one unit of each variable adds, (variables, k, k).
    """

    origin: np.ndarray
    slopes: np.ndarray


class BoundedRow(NamedTuple):
    """A row whose |row z| is to stay below a bound in the set V <= 1.

    Args:
        row: (n,).
        bound: The bound.
        weight: Weight of (|row z|/bound)^2 in the cost; None: the bound may be exceeded, and the cost is the largest
            (|row z|/bound)^2 of all such rows.
    """

    row: np.ndarray
    bound: float
    weight: float | None


class Solution(NamedTuple):
    """P (n, n), the multipliers of the inputs (inputs,), and the rate lambda [1/s]."""

    p: np.ndarray
    multipliers: np.ndarray
    rate: float


def scaling(step: Step, starts: Sequence[np.ndarray], decay: float) -> np.ndarray | None:
    """Coordinates z = S x in which what starts and inputs excite has size one; None if the loop is not stable.

    ``decay`` is the share of a state that is lost within a sample.
    """
    n = step.a.shape[0]
    if np.max(np.abs(np.linalg.eigvals(step.a))) >= 1.0:
        return None
    columns = np.stack(starts, axis=1) * np.sqrt(decay)
    excitation = step.b @ step.b.T + columns @ columns.T
    noise = excitation + 1e-9 * np.trace(excitation) * np.eye(n) if np.any(excitation) else np.eye(n)
    gramian = solve_discrete_lyapunov(step.a, noise)
    try:
        return cholesky(0.5 * (gramian + gramian.T), lower=True)
    except np.linalg.LinAlgError:
        return None


def triangles(matrices: np.ndarray) -> np.ndarray:
    """Upper triangles by columns, off-diagonal entries times sqrt(2), as Clarabel's cones want them; (entries, ...)."""
    columns, rows = np.tril_indices(matrices.shape[-1])  # the lower triangle by rows is the upper one by columns
    weights = np.where(rows == columns, 1.0, np.sqrt(2.0))
    return weights[:, None] * matrices[..., rows, columns].reshape(-1, rows.size).T


def symmetric_basis(n: int) -> np.ndarray:
    """The symmetric matrices of one free entry each, (n (n + 1)/2, n, n)."""
    return np.stack([symmetric_of(unit, n) for unit in np.eye(n * (n + 1) // 2)])


def symmetric_of(values: np.ndarray, n: int) -> np.ndarray:
    """The symmetric matrix of n (n + 1)/2 free entries."""
    matrix = np.zeros((n, n))
    matrix[np.triu_indices(n)] = values
    return matrix + np.triu(matrix, 1).T


def minimiser(cost: np.ndarray, matrices: Sequence[Affine], linear: np.ndarray) -> np.ndarray | None:
    """Minimise cost'x such that every matrix is positive semidefinite and every entry of ``linear`` @ [x, 1] >= 0."""
    count = cost.size
    blocks = [-linear[:, :-1]]
    offsets = [linear[:, -1]]
    cones = [clarabel.NonnegativeConeT(linear.shape[0])]
    for affine in matrices:
        blocks.append(-triangles(affine.slopes))
        offsets.append(triangles(affine.origin)[:, 0])
        cones.append(clarabel.PSDTriangleConeT(affine.origin.shape[0]))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 100
    settings.tol_gap_abs = GAP
    settings.tol_gap_rel = GAP
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix((count, count)),
        cost,
        sparse.csc_matrix(np.concatenate(blocks)),
        np.concatenate(offsets),
        cones,
        settings,
    )
    solution = solver.solve()
    return np.asarray(solution.x) if solution.status in SOLVED else None


class SetPrograms(NamedTuple):
    """Data that all semidefinite programs of one loop share.

    Args:
        sample_time: T_s [s].
        starts: States that a set may have to hold.
        scale: Coordinates z = scale x, (n, n).
        spare: Share of decay and multipliers that is left to the verifier's balls.
        active: Numbers of the steps that have bound a solution; the next program begins with them.
    """

    sample_time: float
    starts: Sequence[np.ndarray]
    scale: np.ndarray
    spare: float
    active: list[int]


def invariant_set(
    programs: SetPrograms, steps: Sequence[Step], rate: float, rows: Sequence[BoundedRow], *, holds_start: bool
) -> Solution | None:
    """Find V = z'Pz such that {V <= 1} holds every start, is invariant and attracts, with small |row z| in it.

    For every step (A, B) and inputs |w_j| <= 1: V(z+) <= (1 - T_s lambda) V(z) + T_s sum of mu_j w_j^2, and the sum of
    mu_j is at most lambda. Few steps bind, so that the others are left out until a solution violates them. Where a
    solution is not accurate enough, its own P gives the coordinates of another try.

    Args:
        programs: What the programs of the loop share.
        steps: The steps at every corner.
        rate: lambda [1/s].
        rows: Rows to bound.
        holds_start: Whether the set has to hold the starts.

    Returns:
        None if the program has no solution.
    """
    a = np.stack([step.a for step in steps])
    b = np.stack([step.b for step in steps])
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return None
    active = programs.active
    tries = 0
    first_steps = np.linspace(0, len(steps) - 1, min(FIRST_STEPS, len(steps))).astype(int).tolist()
    active[:] = [i for i in active if i < len(steps)] or first_steps
    while tries < TRIES:
        solution = solve_set(programs, [steps[i] for i in active], rate, rows, holds_start=holds_start)
        if solution is None:
            return None
        slack = decrease_slack(a, b, programs.sample_time, solution)
        if np.all(slack > 0.0):
            return solution
        violated_steps = [int(i) for i in np.argsort(slack) if slack[i] <= 0.0 and i not in active][:ADDED]
        active += violated_steps
        if not violated_steps:
            tries += 1
            programs = programs._replace(scale=np.linalg.inv(np.linalg.cholesky(solution.p)).T)
    return None


def decrease_slack(a: np.ndarray, b: np.ndarray, sample_time: float, solution: Solution) -> np.ndarray:
    """How much V falls more than it has to at every corner, in coordinates in which P is I; floating point.

    ``a`` has the shape (steps, n, n) and ``b`` the shape (steps, n, inputs).
    """
    root = np.linalg.cholesky(solution.p)
    is_active = solution.multipliers > 0.0
    weights = np.sqrt(sample_time * solution.multipliers[is_active])
    n = root.shape[0]
    contraction = 1.0 - sample_time * solution.rate
    limit = np.diag([*(contraction for _ in range(n)), *(1.0 for _ in weights)])
    scaled_step = root.T @ np.concatenate([a @ np.linalg.inv(root).T, b[:, :, is_active] / weights], axis=2)
    slack = np.linalg.eigvalsh(limit - scaled_step.transpose(0, 2, 1) @ scaled_step)[:, 0]
    return np.where(np.any(b[:, :, ~is_active], axis=(1, 2)), -np.inf, slack)


def solve_set(
    programs: SetPrograms, steps: Sequence[Step], rate: float, rows: Sequence[BoundedRow], *, holds_start: bool
) -> Solution | None:
    """One program of :func:`invariant_set`."""
    sample_time, starts, scale, spare, _ = programs
    starts = starts if holds_start else []
    n = scale.shape[0]
    inputs = steps[0].b.shape[1]
    m = n * (n + 1) // 2
    inverse = np.linalg.inv(scale)
    active_inputs = [j for j in range(inputs) if any(np.any(step.b[:, j]) for step in steps)]
    weighted_rows = [row for row in rows if row.weight is not None]
    minimax_rows = [row for row in rows if row.weight is None]
    first_square = m + len(active_inputs)
    count = first_square + len(weighted_rows) + bool(minimax_rows)
    squares = range(first_square, count)  # of weighted rows, and the largest of all minimax ones

    basis = symmetric_basis(n)

    def decrease(step: Step) -> Affine:
        a = inverse @ step.a @ scale
        delta = (a - np.eye(n)) / sample_time
        b = inverse @ step.b[:, active_inputs] / sample_time
        size = n + len(active_inputs)
        slopes = np.zeros((count, size, size))
        basis_by_delta = basis @ delta
        growth = basis_by_delta + basis_by_delta.transpose(0, 2, 1) + sample_time * delta.T @ basis_by_delta
        slopes[:m, :n, :n] = -growth - (1.0 + spare) * rate * basis
        slopes[:m, :n, n:] = -a.T @ basis @ b
        slopes[:m, n:, :n] = slopes[:m, :n, n:].transpose(0, 2, 1)
        slopes[:m, n:, n:] = -sample_time * b.T @ basis @ b
        for j in range(len(active_inputs)):
            slopes[m + j, n + j, n + j] = 1.0 - spare
        return Affine(-SLACK * np.eye(size), slopes)

    def bound_square(square: int, bounded_row: BoundedRow) -> Affine:
        ratio = bounded_row.row @ scale / bounded_row.bound
        origin = np.zeros((n + 1, n + 1))
        origin[:n, n] = ratio
        origin[n, :n] = ratio
        slopes = np.zeros((count, n + 1, n + 1))
        slopes[:m, :n, :n] = basis
        slopes[square, n, n] = 1.0
        return Affine(origin, slopes)

    matrices = [decrease(step) for step in steps]
    matrices += [bound_square(square, bounded_row) for square, bounded_row in zip(squares, weighted_rows, strict=False)]
    matrices += [bound_square(squares[-1], bounded_row) for bounded_row in minimax_rows]
    linear = np.zeros((1 + len(starts) + len(active_inputs) + len(weighted_rows), count + 1))
    linear[0, m:first_square] = -1.0
    linear[0, -1] = rate * (1.0 - 1e-6)
    for i, start in enumerate(starts):
        x = inverse @ start
        weights = np.outer(x, x)
        weights = 2.0 * weights - np.diag(np.diag(weights))
        linear[1 + i, :m] = -weights[np.triu_indices(n)]
        linear[1 + i, -1] = 1.0 - TIGHT
    for j in range(len(active_inputs)):
        linear[1 + len(starts) + j, m + j] = 1.0
    cost = np.zeros(count)
    cost[first_square:] = 1.0
    for j, bounded_row in enumerate(weighted_rows):  # the set stays within the bounds
        place = 1 + len(starts) + len(active_inputs) + j
        linear[place, first_square + j] = -1.0
        linear[place, -1] = 1.0 - TIGHT
        cost[first_square + j] = bounded_row.weight
    x = minimiser(cost, matrices, linear)
    if x is None:
        return None
    scaled_p = symmetric_of(x[:m], n)
    p = inverse.T @ scaled_p @ inverse
    is_exceeded = any(largest_in_set(p, bounded_row.row) > bounded_row.bound for bounded_row in weighted_rows)
    if np.linalg.eigvalsh(scaled_p)[0] <= 0.0 or is_exceeded:
        return None  # solved, but not well enough
    multipliers = np.zeros(inputs)
    multipliers[active_inputs] = np.maximum(x[m : m + len(active_inputs)], 0.0)
    if (total := multipliers.sum()) > rate:  # by the solver's tolerance
        multipliers *= (1.0 - 1e-12) * rate / total
    return Solution(0.5 * (p + p.T), multipliers, rate)


def largest_in_set(p: np.ndarray, row: np.ndarray) -> float:
    """The largest |row z| in z'Pz <= 1."""
    return float(np.sqrt(row @ np.linalg.solve(p, row)))
