"""Semidefinite programs for a V = z'Pz that falls along every step z+ = A z + B w of a loop, solved by Clarabel.

The programs are stated in coordinates z = S x in which typical states have size 1, and their inequalities are divided
by T_s. Without both the solver is not accurate enough at short sample times.
"""

import importlib
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.linalg import cholesky, solve_discrete_lyapunov

from dssc_jax.proofs.search.impulse_responses import spectral_radius
from dssc_jax.proofs.search.sampled_loop import Step

clarabel: Any = importlib.import_module("clarabel")  # its extension module has no types
SLACK = 1e-7
"""Smallest eigenvalue that every scaled matrix must have, so that the rounding of P does not invalidate the proof."""
TIGHT = 1e-4
"""Share of every bound that is left free, so that the rounding of P does not invalidate the proof."""
TRIES = 3
"""Number of coordinates S in which a program is solved before it counts as unsolved."""
FIRST_STEPS = 16
"""Number of steps in the first program of a loop."""
ADDED = 6
"""Largest number of violated steps that are added to a program before it is solved again."""
GAP = 1e-4
"""Accuracy of a program's cost; its inequalities are met as well as Clarabel meets them by default."""
SOLVED = (clarabel.SolverStatus.Solved, clarabel.SolverStatus.AlmostSolved)


class Affine(NamedTuple):
    """A symmetric matrix that is affine in the variables of a program.

    Args:
        origin: Value where all variables are zero, shape (k, k).
        slopes: Increase per unit of each variable, shape (variables, k, k).
    """

    origin: np.ndarray
    slopes: np.ndarray


class BoundedRow(NamedTuple):
    """A signal, row z, that should be small in the set {V <= 1}.

    Args:
        row: The signal as a row over z, shape (n,).
        bound: The bound of |row z|.
        weight: Weight of the largest (|row z|/bound)^2 in the cost; the bound must then hold. None: the bound may be
            exceeded, and the largest (|row z|/bound)^2 over all such rows is added to the cost.
    """

    row: np.ndarray
    bound: float
    weight: float | None


class Solution(NamedTuple):
    """A set {z'Pz <= 1} that is invariant and attracts.

    Args:
        p: P, shape (n, n).
        multipliers: mu_j [1/s] of each input, shape (inputs,); see :func:`invariant_set`.
        rate: lambda [1/s].
    """

    p: np.ndarray
    multipliers: np.ndarray
    rate: float


def scaling(step: Step, starts: Sequence[np.ndarray], decay: float) -> np.ndarray | None:
    """Coordinates z = S x in which the states that starts and inputs excite have size 1.

    S is a Cholesky factor of the stationary covariance of z+ = A z + noise. The noise acts along the inputs and the
    starts, and a little in all other directions.

    Args:
        step: One sample.
        starts: States in which the loop may start, shape (n,) each.
        decay: Share that the slowest mode loses in a sample.

    Returns:
        S, shape (n, n); None if the loop is not stable, or if the covariance is not numerically positive definite.
    """
    n = step.a.shape[0]
    if spectral_radius(step.a) >= 1.0:
        return None
    columns = np.stack(starts, axis=1) * np.sqrt(decay)
    excitation = step.b @ step.b.T + columns @ columns.T
    floor = 1e-9 * np.trace(excitation) if np.any(excitation) else 1.0
    covariance = solve_discrete_lyapunov(step.a, excitation + floor * np.eye(n))
    try:
        return cholesky(0.5 * (covariance + covariance.T), lower=True)
    except np.linalg.LinAlgError:
        return None


def triangles(matrices: np.ndarray) -> np.ndarray:
    """Write symmetric matrices for Clarabel's cones: the upper triangle by columns, off-diagonals times sqrt(2).

    Args:
        matrices: k symmetric matrices, shape (k, n, n), or a single one, shape (n, n).

    Returns:
        One column for each matrix, shape (n (n + 1)/2, k).
    """
    columns, rows = np.tril_indices(matrices.shape[-1])  # the lower triangle by rows is the upper one by columns
    weights = np.where(rows == columns, 1.0, np.sqrt(2.0))
    return weights[:, None] * matrices[..., rows, columns].reshape(-1, rows.size).T


def symmetric_of(values: np.ndarray, n: int) -> np.ndarray:
    """The symmetric matrix, shape (n, n), from the n (n + 1)/2 entries of its upper triangle, row by row."""
    matrix = np.zeros((n, n))
    matrix[np.triu_indices(n)] = values
    return matrix + np.triu(matrix, 1).T


def minimiser(cost: np.ndarray, matrices: Sequence[Affine], linear: np.ndarray) -> np.ndarray | None:
    """Solve a semidefinite program: the x, shape (variables,), that minimises cost'x.

    Args:
        cost: Cost of each variable, shape (variables,).
        matrices: Matrices, affine in x, that must be positive semidefinite.
        linear: Rows whose product with (x, 1) must not be negative, shape (rows, variables + 1).

    Returns:
        x; None if Clarabel finds no solution.
    """
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
        sparse.csc_matrix((count, count)),  # no quadratic cost
        cost,
        sparse.csc_matrix(np.concatenate(blocks)),
        np.concatenate(offsets),
        cones,
        settings,
    )
    solution = solver.solve()
    return np.asarray(solution.x) if solution.status in SOLVED else None


class SetPrograms(NamedTuple):
    """The data that all semidefinite programs of one loop share.

    Args:
        sample_time: T_s [s].
        starts: States that a set may have to hold, shape (n,) each.
        scale: S of the coordinates z = S x, shape (n, n).
        spare: Share of lambda and of the multipliers that is left for the widths of the verifier's balls.
        active: Indices of the steps in the last program. The list is changed in place, so that the next program begins
            with the same steps.
    """

    sample_time: float
    starts: Sequence[np.ndarray]
    scale: np.ndarray
    spare: float
    active: list[int]


def invariant_set(
    programs: SetPrograms, steps: Sequence[Step], rate: float, rows: Sequence[BoundedRow], *, holds_start: bool
) -> Solution | None:
    """Find V = z'Pz such that {V <= 1} is invariant, attracts, and keeps some signals small (premise P6).

    For every step (A, B) and inputs |w_j| <= 1: V(z+) <= (1 - T_s lambda) V(z) + T_s sum of mu_j w_j^2, and the sum of
    mu_j is at most lambda. Few steps decide the solution. So the program has only some steps at first, and those that
    its solution violates are added. If a solution violates only steps that the program already has, the solver was not
    accurate enough; then the P of this solution gives the coordinates S of another try.

    Args:
        programs: The data that the programs of the loop share.
        steps: A and B at every corner of plant and gains.
        rate: lambda [1/s].
        rows: Signals to bound in the set.
        holds_start: Whether the set has to hold the starts.

    Returns:
        The set; None if the program has no solution, or none that is accurate enough.
    """
    a = np.stack([step.a for step in steps])
    b = np.stack([step.b for step in steps])
    if not (np.isfinite(a).all() and np.isfinite(b).all()):
        return None
    active = programs.active
    tries = 0
    evenly_spread = np.linspace(0, len(steps) - 1, min(FIRST_STEPS, len(steps))).astype(int).tolist()
    active[:] = [i for i in active if i < len(steps)] or evenly_spread
    while tries < TRIES:
        solution = solve_set(programs, [steps[i] for i in active], rate, rows, holds_start=holds_start)
        if solution is None:
            return None
        slack = decrease_slack(a, b, programs.sample_time, solution)
        if np.all(slack > 0.0):
            return solution
        new_violated_steps = [int(i) for i in np.argsort(slack) if slack[i] <= 0.0 and i not in active]
        active += new_violated_steps[:ADDED]
        if not new_violated_steps:  # the solver was not accurate enough
            tries += 1
            programs = programs._replace(scale=np.linalg.inv(np.linalg.cholesky(solution.p)).T)
    return None


def decrease_slack(a: np.ndarray, b: np.ndarray, sample_time: float, solution: Solution) -> np.ndarray:
    """The excess of V's fall over the required fall in each step; P6 holds where it is positive.

    With P = R R', x = R'z and inputs scaled by (T_s mu_j)^(1/2), P6 reads |x+|^2 <= (1 - T_s lambda) |x|^2 + |w|^2.

    Args:
        a: A of each step, shape (steps, n, n).
        b: B of each step, shape (steps, n, inputs).
        sample_time: T_s [s].
        solution: P, multipliers and rate.

    Returns:
        The smallest eigenvalue of the right side less the left side, a quadratic form of (x, w), for each step, shape
        (steps,); -inf where an input without a multiplier acts.
    """
    root = np.linalg.cholesky(solution.p)  # R
    has_multiplier = solution.multipliers > 0.0
    weights = np.sqrt(sample_time * solution.multipliers[has_multiplier])
    n = root.shape[0]
    limit = np.diag(np.concatenate([np.full(n, 1.0 - sample_time * solution.rate), np.ones(weights.size)]))
    scaled_step = root.T @ np.concatenate([a @ np.linalg.inv(root).T, b[:, :, has_multiplier] / weights], axis=2)
    slack = np.linalg.eigvalsh(limit - scaled_step.transpose(0, 2, 1) @ scaled_step)[:, 0]
    other_input_acts = np.any(b[:, :, ~has_multiplier], axis=(1, 2))
    return np.where(other_input_acts, -np.inf, slack)


def solve_set(
    programs: SetPrograms, steps: Sequence[Step], rate: float, rows: Sequence[BoundedRow], *, holds_start: bool
) -> Solution | None:
    """Solve the program of :func:`invariant_set`, with the same arguments, for some steps only; None if unsolved."""
    program = SetProgram(programs, steps, rate, rows, programs.starts if holds_start else [])
    x = minimiser(program.cost(), program.matrices(), program.inequalities())
    return None if x is None else program.solution(x)


class SetProgram:
    """The matrices of one semidefinite program of :func:`invariant_set`.

    The variables are, in this order: the entries of S'P S, which is P in the coordinates z = S x; the multiplier of
    each input that acts; for each row with a weight, a bound of the largest (|row z|/bound)^2 in the set; and one such
    bound for all rows without a weight, if there are any.

    Args:
        programs: The data that the programs of the loop share.
        steps: A and B of the steps over which V has to fall.
        rate: lambda [1/s].
        rows: Signals to bound in the set.
        starts: States that the set has to hold, shape (n,) each.
    """

    def __init__(
        self,
        programs: SetPrograms,
        steps: Sequence[Step],
        rate: float,
        rows: Sequence[BoundedRow],
        starts: Sequence[np.ndarray],
    ) -> None:
        """Store the arguments, find the inputs that act and the rows with a weight, and count the variables."""
        self.sample_time = programs.sample_time
        self.scale = programs.scale
        self.inverse = np.linalg.inv(programs.scale)
        self.spare = programs.spare
        self.steps = steps
        self.rate = rate
        self.starts = starts
        self.n = self.scale.shape[0]
        self.entries = self.n * (self.n + 1) // 2
        # for each entry of P, the symmetric matrix in which this entry is 1
        self.basis = np.stack([symmetric_of(unit, self.n) for unit in np.eye(self.entries)])
        self.inputs = steps[0].b.shape[1]
        self.active_inputs = [j for j in range(self.inputs) if any(np.any(step.b[:, j]) for step in steps)]
        self.weighted_rows = [row for row in rows if row.weight is not None]
        self.minimax_rows = [row for row in rows if row.weight is None]
        self.first_square = self.entries + len(self.active_inputs)  # index of the first bound of a square
        self.count = self.first_square + len(self.weighted_rows) + bool(self.minimax_rows)

    def cost(self) -> np.ndarray:
        """Cost of each variable: the weight of a row for the bound of its square, 1 for the common bound, else 0."""
        cost = np.zeros(self.count)
        cost[self.first_square :] = 1.0
        for j, bounded_row in enumerate(self.weighted_rows):
            cost[self.first_square + j] = bounded_row.weight
        return cost

    def matrices(self) -> list[Affine]:
        """The matrices that must be positive semidefinite, so that V falls over each step and squares are bounded."""
        matrices = [self.decrease(step) for step in self.steps]
        for j, bounded_row in enumerate(self.weighted_rows):
            matrices.append(self.bounded_square(self.first_square + j, bounded_row))
        for bounded_row in self.minimax_rows:
            matrices.append(self.bounded_square(self.count - 1, bounded_row))
        return matrices

    def decrease(self, step: Step) -> Affine:
        """The excess of V's fall over a step, over T_s, as a quadratic form of the state z and the inputs w.

        It is ((1 - T_s lambda) V(z) - V(z+))/T_s + sum of mu_j w_j^2; see :func:`invariant_set`. ``spare`` enlarges
        lambda and reduces the multipliers mu_j, and ``SLACK`` is subtracted from all eigenvalues. With A = I + T_s
        Delta and B = T_s B_delta, (V(z+) - V(z))/T_s at w = 0 is the form of P Delta + Delta'P + T_s Delta'P Delta.
        """
        n = self.n
        entries = self.entries
        a = self.inverse @ step.a @ self.scale
        delta = (a - np.eye(n)) / self.sample_time
        b_delta = self.inverse @ step.b[:, self.active_inputs] / self.sample_time
        size = n + len(self.active_inputs)
        slopes = np.zeros((self.count, size, size))
        p_delta = self.basis @ delta
        growth = p_delta + p_delta.transpose(0, 2, 1) + self.sample_time * delta.T @ p_delta
        slopes[:entries, :n, :n] = -growth - (1.0 + self.spare) * self.rate * self.basis
        slopes[:entries, :n, n:] = -a.T @ self.basis @ b_delta
        slopes[:entries, n:, :n] = slopes[:entries, :n, n:].transpose(0, 2, 1)
        slopes[:entries, n:, n:] = -self.sample_time * b_delta.T @ self.basis @ b_delta
        for j in range(len(self.active_inputs)):
            slopes[entries + j, n + j, n + j] = 1.0 - self.spare
        return Affine(-SLACK * np.eye(size), slopes)

    def bounded_square(self, square: int, bounded_row: BoundedRow) -> Affine:
        """The matrix [[P, c'], [c, x_square]], positive semidefinite if x_square bounds (c x)^2 in the set.

        Args:
            square: Index of the variable x_square.
            bounded_row: The signal and its bound; c = row S/bound.
        """
        n = self.n
        ratio = bounded_row.row @ self.scale / bounded_row.bound
        origin = np.zeros((n + 1, n + 1))
        origin[:n, n] = ratio
        origin[n, :n] = ratio
        slopes = np.zeros((self.count, n + 1, n + 1))
        slopes[: self.entries, :n, :n] = self.basis
        slopes[square, n, n] = 1.0
        return Affine(origin, slopes)

    def inequalities(self) -> np.ndarray:
        """Rows whose product with (x, 1) must not be negative, shape (rows, variables + 1).

        The rows state, in this order, that the multipliers add up to at most lambda, that the set holds each start,
        that no multiplier is negative, and that each row with a weight stays within its bound.
        """
        multipliers = len(self.active_inputs)
        linear = np.zeros((1 + len(self.starts) + multipliers + len(self.weighted_rows), self.count + 1))
        linear[0, self.entries : self.first_square] = -1.0
        linear[0, -1] = self.rate * (1.0 - 1e-6)
        for i, start in enumerate(self.starts):
            x = self.inverse @ start
            squares = np.outer(x, x)
            weights = 2.0 * squares - np.diag(np.diag(squares))  # an entry off the diagonal counts twice in x'Px
            linear[1 + i, : self.entries] = -weights[np.triu_indices(self.n)]
            linear[1 + i, -1] = 1.0 - TIGHT
        first = 1 + len(self.starts)
        for j in range(multipliers):
            linear[first + j, self.entries + j] = 1.0
        for j in range(len(self.weighted_rows)):
            linear[first + multipliers + j, self.first_square + j] = -1.0
            linear[first + multipliers + j, -1] = 1.0 - TIGHT
        return linear

    def solution(self, x: np.ndarray) -> Solution | None:
        """Convert the solver's x to a set in z; None if, by the solver's error, P is not definite or a bound fails."""
        scaled_p = symmetric_of(x[: self.entries], self.n)
        p = self.inverse.T @ scaled_p @ self.inverse
        is_exceeded = any(largest_in_set(p, bounded_row.row) > bounded_row.bound for bounded_row in self.weighted_rows)
        if np.linalg.eigvalsh(scaled_p)[0] <= 0.0 or is_exceeded:
            return None
        multipliers = np.zeros(self.inputs)
        multipliers[self.active_inputs] = np.maximum(x[self.entries : self.first_square], 0.0)
        total = multipliers.sum()
        if total > self.rate:  # by the solver's tolerance
            multipliers *= (1.0 - 1e-12) * self.rate / total
        return Solution(0.5 * (p + p.T), multipliers, self.rate)


def largest_in_set(p: np.ndarray, row: np.ndarray) -> float:
    """The largest |row z| over the set {z'Pz <= 1}, (row P^-1 row')^(1/2)."""
    return float(np.sqrt(row @ np.linalg.solve(p, row)))
