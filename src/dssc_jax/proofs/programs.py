"""Semidefinite programs for a common V = z'Pz, solved by Clarabel in scaled coordinates and divided by T_s."""

import importlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import cholesky, solve_discrete_lyapunov

from dssc_jax.proofs.sampled_loop import Step

clarabel: Any = importlib.import_module("clarabel")  # its extension module has no types
SLACK = 1e-7
"""Smallest eigenvalue that is asked of every scaled matrix, so that rounding P does not spoil the proof."""
TIGHT = 1e-4
"""Room that is left in every bound, for the same reason."""
TRIES = 3
"""Number of coordinates that are tried."""
SOLVED = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)


class Affine(NamedTuple):
    """A symmetric matrix that is affine in the program's variables.

    Args:
        origin: Its value at zero, (k, k).
        slopes: What one unit of each variable adds, (variables, k, k).
    """

    origin: np.ndarray
    slopes: np.ndarray


class Bounded(NamedTuple):
    """A row whose |row z| is to stay below a bound in the set V <= 1, and its weight in the cost."""

    row: np.ndarray
    bound: float
    weight: float


class Solution(NamedTuple):
    """P (n, n), the multipliers of the inputs (inputs,), and the rate lambda [1/s]."""

    p: np.ndarray
    multipliers: np.ndarray
    rate: float


def scaling(step: Step, starts: Sequence[np.ndarray], forgets: float) -> np.ndarray | None:
    """Coordinates z = S x in which what starts and inputs excite has size one; None if the loop is not stable.

    Args:
        step: One sample at one point.
        starts: Initial states.
        forgets: Share of a state that is forgotten within a sample.
    """
    n = step.a.shape[0]
    if np.max(np.abs(np.linalg.eigvals(step.a))) >= 1.0:
        return None
    columns = np.stack(starts, axis=1) * np.sqrt(forgets)
    spread = step.b @ step.b.T + columns @ columns.T
    noise = spread + 1e-9 * np.trace(spread) * np.eye(n) if np.any(spread) else np.eye(n)
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


def solved(cost: np.ndarray, psd: Sequence[Affine], least: np.ndarray) -> np.ndarray | None:
    """Minimise cost'x such that every matrix is positive semidefinite and every entry of ``least`` @ [x, 1] >= 0."""
    count = cost.size
    blocks, offsets, cones = [-least[:, :-1]], [least[:, -1]], [clarabel.NonnegativeConeT(least.shape[0])]
    for affine in psd:
        blocks.append(-triangles(affine.slopes))
        offsets.append(triangles(affine.origin)[:, 0])
        cones.append(clarabel.PSDTriangleConeT(affine.origin.shape[0]))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 100
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


def invariant_set(
    steps: Sequence[Step],
    sample_time: float,
    rate: float,
    rows: Sequence[Bounded],
    starts: Sequence[np.ndarray],
    scale: np.ndarray,
    spare: float,
) -> Solution | None:
    """Find V = z'Pz such that {V <= 1} holds every start, is invariant and attracts, with small |row z| in it.

    For every step (A, B) and inputs |w_j| <= 1: V(z+) <= (1 - T_s lambda) V(z) + T_s sum of mu_j w_j^2, and the sum of
    mu_j is at most lambda. Where a solution is not accurate enough, its own P gives the coordinates of another try.

    Args:
        steps: The steps at every corner.
        sample_time: T_s [s].
        rate: lambda [1/s].
        rows: Rows to bound; the cost is the weighted sum of (|row z|/bound)^2.
        starts: States that the set has to hold.
        scale: Coordinates z = scale x, (n, n).
        spare: Share of decay and multipliers that is left to the verifier's balls.

    Returns:
        None if the program has no solution.
    """
    if not all(np.isfinite(step.a).all() and np.isfinite(step.b).all() for step in steps):
        return None
    for _ in range(TRIES):
        solution = solved_set(steps, sample_time, rate, rows, starts, scale, spare)
        if solution is None or decreases(steps, sample_time, solution):
            return solution
        scale = np.linalg.inv(np.linalg.cholesky(solution.p)).T
    return None


def decreases(steps: Sequence[Step], sample_time: float, solution: Solution) -> bool:
    """Whether V obeys its inequality at every corner, in floating point and coordinates in which P is I."""
    root = np.linalg.cholesky(solution.p)
    live = solution.multipliers > 0.0
    weights = np.sqrt(sample_time * solution.multipliers[live])
    n, keep = root.shape[0], 1.0 - sample_time * solution.rate
    limit = np.diag([*(keep for _ in range(n)), *(1.0 for _ in weights)])
    for step in steps:
        both = root.T @ np.concatenate([step.a @ np.linalg.inv(root).T, step.b[:, live] / weights], axis=1)
        if np.any(step.b[:, ~live]) or np.linalg.eigvalsh(limit - both.T @ both)[0] <= 0.0:
            return False
    return True


def solved_set(
    steps: Sequence[Step],
    sample_time: float,
    rate: float,
    rows: Sequence[Bounded],
    starts: Sequence[np.ndarray],
    scale: np.ndarray,
    spare: float,
) -> Solution | None:
    """One try of :func:`invariant_set`."""
    n, inputs, m = scale.shape[0], steps[0].b.shape[1], scale.shape[0] * (scale.shape[0] + 1) // 2
    inverse = np.linalg.inv(scale)
    live = [j for j in range(inputs) if any(np.any(step.b[:, j]) for step in steps)]
    count = m + len(live) + len(rows)

    basis = symmetric_basis(n)

    def decrease(step: Step) -> Affine:
        a = inverse @ step.a @ scale
        delta, b = (a - np.eye(n)) / sample_time, inverse @ step.b[:, live] / sample_time
        size = n + len(live)
        slopes = np.zeros((count, size, size))
        moved = basis @ delta
        growth = moved + moved.transpose(0, 2, 1) + sample_time * delta.T @ moved
        slopes[:m, :n, :n] = -growth - (1.0 + spare) * rate * basis
        slopes[:m, :n, n:] = -a.T @ basis @ b
        slopes[:m, n:, :n] = slopes[:m, :n, n:].transpose(0, 2, 1)
        slopes[:m, n:, n:] = -sample_time * b.T @ basis @ b
        for j in range(len(live)):
            slopes[m + j, n + j, n + j] = 1.0 - spare
        return Affine(-SLACK * np.eye(size), slopes)

    def below(index: int, row: np.ndarray, bound: float) -> Affine:
        origin, slopes = np.zeros((n + 1, n + 1)), np.zeros((count, n + 1, n + 1))
        origin[:n, n] = origin[n, :n] = row @ scale / bound
        slopes[:m, :n, :n], slopes[m + len(live) + index, n, n] = basis, 1.0
        return Affine(origin, slopes)

    psd = [decrease(step) for step in steps] + [below(i, one.row, one.bound) for i, one in enumerate(rows)]
    least = np.zeros((1 + len(starts) + len(live) + len(rows), count + 1))
    least[0, m : m + len(live)], least[0, -1] = -1.0, rate * (1.0 - 1e-6)
    for i, start in enumerate(starts):
        x = inverse @ start
        weights = np.outer(x, x)
        weights = 2.0 * weights - np.diag(np.diag(weights))
        least[1 + i, :m], least[1 + i, -1] = -weights[np.triu_indices(n)], 1.0 - TIGHT
    first = 1 + len(starts)
    for j in range(len(live)):
        least[first + j, m + j] = 1.0
    for i in range(len(rows)):  # the set stays within the bounds
        least[first + len(live) + i, m + len(live) + i] = -1.0
        least[first + len(live) + i, -1] = 1.0 - TIGHT
    cost = np.zeros(count)
    cost[m + len(live) :] = [one.weight for one in rows]
    x = solved(cost, psd, least)
    if x is None:
        return None
    scaled = symmetric_of(x[:m], n)
    p = inverse.T @ scaled @ inverse
    if np.linalg.eigvalsh(scaled)[0] <= 0.0 or any(largest_in_set(p, one.row) > one.bound for one in rows):
        return None  # solved, but not well enough
    multipliers = np.zeros(inputs)
    multipliers[live] = np.maximum(x[m : m + len(live)], 0.0)
    if (total := multipliers.sum()) > rate:  # by the solver's tolerance
        multipliers *= (1.0 - 1e-12) * rate / total
    return Solution(0.5 * (p + p.T), multipliers, rate)


def largest_in_set(p: np.ndarray, row: np.ndarray) -> float:
    """The largest |row z| in z'Pz <= 1."""
    return float(np.sqrt(row @ np.linalg.solve(p, row)))
