"""Searches with derivatives: gradient descent by optax, and sequential quadratic programming by SciPy."""

from dataclasses import dataclass, field
from typing import NamedTuple

import jax
import numpy as np
import optax
from scipy.optimize import minimize

from dssc_jax.analyses.tuning.objective import Merit
from dssc_jax.analyses.tuning.problem import (
    BOX_HALF_WIDTH,
    FINAL_WIDTH,
    PENALTY,
    UNFIT,
    UPDATE,
    EvaluatedPoint,
    Problem,
    SearchRecord,
    StartPoints,
    headroom,
)
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.study.schema import TuneTable

FINAL_RATE = 0.01  # final share of the learning rate in the cosine schedule
HALVINGS = 8  # most halvings of a step
OBJECTIVE_STEP = 0.5  # most that a step may worsen the objective, relative to that of the start
STEEPEST = 1e6  # largest useful slope of the relative objective: where a loop chatters, slopes grow with every sample
VIOLATION_STEP = 0.05  # most that a step may exceed a limit, relative to it, unless the point before exceeded it more
EXACT_SHARE = 0.2  # share of the steps, the last ones, in which the sign is not smoothed


class Multipliers:
    """Multipliers lambda of the limits in a descent, by the augmented Lagrangian.

    The relative objective f is minimised; the relative excesses g over the limits have to be g <= 0. With the penalty c
    the Lagrangian is f + sum (max(0, lambda + c g)^2 - lambda^2)/(2 c). A limit may be exceeded by more on the
    validation draws than on the training draws. This difference, the gap of the limit, is added to g, so that the
    search keeps a distance from a limit for which the training draws are too optimistic.

    Args:
        scale: Objective of the start, relative to which f is taken.

    Reference:
        J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), section 17.4.
    """

    def __init__(self, scale: float) -> None:
        """Start with multipliers and gaps of 0."""
        self.scale = scale
        self.values: dict[str, float] = {}  # lambda of each limit; a missing one is 0
        self.gaps: dict[str, float] = {}

    def pushes(self, point: EvaluatedPoint) -> dict[str, float]:
        """The value max(0, lambda + c g) of each limit, by name: the weight of the limit in the gradient.

        It also is the next multiplier. lambda is the present multiplier, c the penalty, and g the relative excess over
        the limit with headroom and gap added.
        """
        pushes = {}
        for name, excess in point.merit.excess.items():
            tightened_excess = excess + headroom(name) + self.gaps.get(name, 0.0)
            pushes[name] = max(0.0, self.values.get(name, 0.0) + PENALTY * tightened_excess)
        return pushes

    def gradient(self, point: EvaluatedPoint) -> np.ndarray:
        """Gradient of the augmented Lagrangian by the search's coordinates, shape (n,).

        The objective of a loop that chatters may have a useless, huge slope. In this case only the limits count if one
        of them pushes. A gradient that is not finite, as where a draw has ended early, counts as 0.
        """
        total = point.gradient / self.scale
        pushes = self.pushes(point)
        is_useful = np.all(np.abs(total) <= STEEPEST)  # False for an overflow, too
        if not is_useful and (any(pushes.values()) or not np.isfinite(total).all()):
            total = np.zeros_like(total)
        for name, push in pushes.items():
            total = total + push * point.slopes[name]
        return total

    def update(self, train: EvaluatedPoint, validation: EvaluatedPoint) -> None:
        """Update the multipliers, and the gaps between validation and training draws, at a point of the search.

        Args:
            train: The point, evaluated on the training draws.
            validation: The same point, evaluated on the validation draws. If a draw ended early, the gaps stay.
        """
        self.values = self.pushes(train)
        if not train.merit.ended and not validation.merit.ended:
            self.gaps = validation_gaps(train.merit, validation.merit)


def validation_gaps(train: Merit, validation: Merit) -> dict[str, float]:
    """How much more a point exceeds each limit on the validation draws than on the training draws, at least 0."""
    return {name: max(0.0, excess - train.excess[name]) for name, excess in validation.excess.items()}


def descend(problem: Problem, first: StartPoints, progress: ProgressCallback | None) -> SearchRecord:
    """Descend by gradients on batches of the training draws, with an optimiser of optax.

    The best point is chosen on the validation draws. A step is halved if the new point is not certified, a draw of the
    batch ends early, or the objective or violation increases abruptly.

    Args:
        problem: Objective and limits as functions of the search's coordinates.
        first: The start, evaluated on the training and on the validation draws.
        progress: Called after each step.
    """
    table = problem.plan.table
    optimiser = optimiser_of(table)
    multipliers = Multipliers(first.scale)
    rng = np.random.default_rng(problem.plan.seed)
    search = SearchRecord(first.validation)
    iterate = first.train
    stale = 0  # evaluations on the validation draws since the best one
    search.record(problem, 0, *first)
    with jax.enable_x64(True):
        optimiser_state = optimiser.init(iterate.z)
    for step in range(1, table.steps + 1):
        if table.smoothing is not None:
            problem.width = smoothing_width(table.smoothing, (step - 1) / table.steps)
        with jax.enable_x64(True):
            gradient = multipliers.gradient(iterate)
            change, optimiser_state = optimiser.update(gradient, optimiser_state, iterate.z)
        batch = rng.choice(problem.train, table.batch, replace=False) if table.batch else problem.train
        worsening = OBJECTIVE_STEP * multipliers.scale
        iterate, halvings = shortened_step(problem, iterate, np.asarray(change), batch, worsening)
        search.shortened += halvings
        if step % UPDATE == 0 or step == table.steps:
            validation = problem.evaluate(iterate.z)
            multipliers.update(iterate, validation)
            is_best = search.record(problem, step, iterate, validation)
            stale = 0 if is_best else stale + 1
        if progress:
            progress(step, table.steps)
        if stale >= table.patience:
            search.stopped = f"no better on the validation draws for {stale} looks"
            break
    return search


def optimiser_of(table: TuneTable) -> optax.GradientTransformation:
    """The optimiser of optax that ``[tune]`` names, with its learning rate; longer gradients are cut to length 1."""
    rate: float | optax.Schedule = table.learning_rate
    if table.schedule == "cosine":
        rate = optax.cosine_decay_schedule(table.learning_rate, table.steps, FINAL_RATE)
    return optax.chain(optax.clip_by_global_norm(1.0), getattr(optax, table.optimiser)(rate))


def smoothing_width(first: float, finished_share: float) -> float:
    """Width of the smoothed sign [m/s]: it decreases geometrically from ``first``, and is 0 in the last steps.

    Args:
        first: Width in the first step [m/s].
        finished_share: Share of the steps that are done.
    """
    smoothed_share = 1.0 - EXACT_SHARE
    if finished_share >= smoothed_share:
        return 0.0
    return first * FINAL_WIDTH ** (finished_share / smoothed_share)


def shortened_step(
    problem: Problem, iterate: EvaluatedPoint, change: np.ndarray, batch: np.ndarray, worsening: float
) -> tuple[EvaluatedPoint, int]:
    """Take a step, halved until the new point is allowed; if no point is, evaluate the present point again.

    Args:
        problem: Objective and limits as functions of the search's coordinates.
        iterate: The present point.
        change: The step in the search's coordinates, shape (n,).
        batch: Indices of the draws on which points are evaluated.
        worsening: Most that the objective may increase.

    Returns:
        The point after the step, and the number of halvings.
    """
    highest_objective = iterate.merit.objective + worsening
    highest_violation = max(iterate.merit.violation, VIOLATION_STEP)
    for halvings in range(HALVINGS):
        z = iterate.z + change * 0.5**halvings
        if problem.is_admissible(z):
            point = problem.differentiate(z, batch)
            if point.merit.objective <= highest_objective and point.merit.violation <= highest_violation:
                return point, halvings
    return problem.differentiate(iterate.z, batch), HALVINGS


STAGES = 4  # stages of the search, between which the width of the sign and the headroom of limits change
CONVERGED = 1e-5  # change of the relative objective at which a stage ends


def quadratic_programming(problem: Problem, first: StartPoints, progress: ProgressCallback | None) -> SearchRecord:
    """Search by sequential quadratic programming (SLSQP) on the training draws.

    The best iterate is chosen on the validation draws. The largest excess is an additional coordinate, so that
    linearised limits never contradict each other. If a limit is exceeded by more on the validation draws than on the
    training draws, the difference is added to its headroom, and the search continues from there.

    Args:
        problem: Objective and limits as functions of the search's coordinates.
        first: The start, evaluated on the training and on the validation draws.
        progress: Called after each step.

    Reference:
        D. Kraft, "A software package for sequential quadratic programming", DFVLR-FB 88-28 (1988); the elastic mode is
        from J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), section 18.5.
    """
    iteration = QuadraticSearch(problem, SearchRecord(first.validation), first.train, first.scale, progress)
    iteration.search.record(problem, 0, *first)
    first_width = problem.plan.table.smoothing
    steps = problem.plan.table.steps
    for stage in range(1, STAGES + 1):
        steps_until_stage_ends = steps
        if first_width is not None:
            problem.width = stage_width(first_width, stage)
            steps_until_stage_ends = stage * steps // STAGES
        iteration.run_stage(steps_until_stage_ends)
        exceeds_limit = iteration.update_gaps()
        is_done = first_width is None and not exceeds_limit
        if is_done or iteration.step_count >= steps:
            break
    return iteration.search


def stage_width(first: float, stage: int) -> float:
    """Width of the smoothed sign in a stage [m/s]: it decreases geometrically from ``first``; 0 in the last stage.

    Args:
        first: Width in the first stage [m/s].
        stage: Number of the stage, from 1 to :data:`STAGES`.
    """
    if stage == STAGES:
        return 0.0
    return first * FINAL_WIDTH ** ((stage - 1) / (STAGES - 2))


class OutOfPatience(Exception):
    """Raised to end SLSQP: no point was better on the validation draws for as many steps as the patience allows."""


class AssessedPoint(NamedTuple):
    """A point of the search, and whether SLSQP may use it.

    Args:
        point: The point, evaluated on the training draws.
        is_fit: Whether its draws do not end early, and its certificates hold.
    """

    point: EvaluatedPoint
    is_fit: bool


@dataclass
class QuadraticSearch:
    """Cost, limits and derivatives as functions for SLSQP, of x = (z, e).

    z are the coordinates of the plan, shape (n,). The last entry e >= 0 is the largest excess over the limits (elastic
    mode): every limit g has to be g <= e, and the cost grows with e.

    Args:
        problem: Objective and limits as functions of the search's coordinates.
        search: The record of the search.
        iterate: The present iterate.
        scale: Objective of the start, relative to which the objective is taken.
        progress: Called after each step.
        step_count: Number of steps taken so far.
        gaps: How much more each limit is exceeded on the validation draws than on the training draws, by name.
    """

    problem: Problem
    search: SearchRecord
    iterate: EvaluatedPoint
    scale: float
    progress: ProgressCallback | None
    step_count: int = 0
    gaps: dict[str, float] = field(default_factory=dict)
    _points: dict[bytes, AssessedPoint] = field(default_factory=dict)  # points of the stage, by bytes of z
    _stale: int = 0  # steps since the best point

    def __post_init__(self) -> None:
        """Fix the order of the limits, in which constraints are passed to SLSQP."""
        self.names = list(self.iterate.merit.excess)  # names of the limits

    def at(self, x: np.ndarray) -> AssessedPoint:
        """The point at x, shape (n + 1,); a point is evaluated only once in a stage."""
        z = x[:-1]
        key = z.tobytes()
        if key not in self._points:
            point = self.problem.differentiate(z, self.problem.train)
            is_fit = not point.merit.ended and self.problem.is_admissible(z)
            self._points[key] = AssessedPoint(point, is_fit)
        return self._points[key]

    def cost(self, x: np.ndarray) -> float:
        """The relative objective plus the penalty of the largest excess, the last entry of x.

        A point that SLSQP must not use has the cost :data:`UNFIT`.
        """
        point, is_fit = self.at(x)
        if not is_fit:
            return UNFIT
        return point.merit.objective / self.scale + PENALTY * float(x[-1])

    def gradient(self, x: np.ndarray) -> np.ndarray:
        """Gradient of the cost by x, shape (n + 1,).

        SLSQP asks for the gradient at iterates only. So each new point here is a step, and is evaluated on the
        validation draws.

        Raises:
            OutOfPatience: No point was better for as many steps as the patience allows.
        """
        point = self.at(x).point
        if not np.array_equal(point.z, self.iterate.z):
            self.take_step(point)
        return np.append(point.gradient / self.scale, PENALTY)

    def take_step(self, point: EvaluatedPoint) -> None:
        """Count a step to a point, and record the point on the validation draws.

        Raises:
            OutOfPatience: No point was better for as many steps as the patience allows.
        """
        table = self.problem.plan.table
        self.step_count += 1
        self.iterate = point
        is_best = self.search.record(self.problem, self.step_count, point, self.problem.evaluate(point.z))
        self._stale = 0 if is_best else self._stale + 1
        if self.progress:
            self.progress(self.step_count, table.steps)
        if self._stale >= table.patience:
            raise OutOfPatience

    def constraints(self, x: np.ndarray) -> np.ndarray:
        """The functions that SLSQP keeps >= 0, shape (limits,): e minus the excess over each limit.

        The largest excess e is the last entry of x. Headroom and gap are added to the excess over a limit. A point
        whose draws end early exceeds every limit by 1.
        """
        point = self.at(x).point
        tightened_excesses = []
        for name in self.names:
            excess = point.merit.excess.get(name, 1.0)
            tightened_excesses.append(excess + headroom(name) + self.gaps.get(name, 0.0))
        return x[-1] - np.array(tightened_excesses)

    def constraint_slopes(self, x: np.ndarray) -> np.ndarray:
        """Derivatives of :meth:`constraints` by x, shape (limits, n + 1); those by z are 0 if draws end early."""
        point = self.at(x).point
        no_slope = np.zeros(len(x) - 1)
        by_z = np.array([point.slopes.get(name, no_slope) for name in self.names])
        by_largest_excess = np.ones((len(by_z), 1))
        return np.hstack([-by_z, by_largest_excess])

    def run_stage(self, steps: int) -> None:
        """Run SLSQP from the present iterate, until the steps of all stages together are ``steps``."""
        self._points.clear()
        self._stale = 0
        start = np.append(np.clip(self.iterate.z, -BOX_HALF_WIDTH, BOX_HALF_WIDTH), 0.0)
        start[-1] = max([0.0, *-self.constraints(start)])  # the least excess that all limits allow
        limits = {"type": "ineq", "fun": self.constraints, "jac": self.constraint_slopes}
        constraints = [limits] if self.names else []
        box = [(-BOX_HALF_WIDTH, BOX_HALF_WIDTH)] * (len(start) - 1)
        not_negative = (0.0, None)
        try:
            minimize(
                self.cost, start, jac=self.gradient, method="SLSQP", constraints=constraints,
                bounds=[*box, not_negative],
                options={"maxiter": max(1, steps - self.step_count), "ftol": CONVERGED},
            )  # fmt: skip
        except OutOfPatience:
            self.search.stopped = f"no better on the validation draws for {self._stale} looks"
            return
        all_done = self.step_count >= self.problem.plan.table.steps
        self.search.stopped = "all steps done" if all_done else "converged"

    def update_gaps(self) -> bool:
        """Update the gaps of the limits at the present iterate; they stay if a validation draw ends early.

        Returns:
            Whether the validation draws exceed a limit; False if one of them ends early.
        """
        validation = self.problem.evaluate(self.iterate.z).merit
        if validation.ended:
            return False
        self.gaps = validation_gaps(self.iterate.merit, validation)
        return validation.violation > 0.0
