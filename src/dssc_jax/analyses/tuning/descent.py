"""Gradient descent by optax with an augmented Lagrangian."""

from typing import Any

import jax
import numpy as np
import optax

from dssc_jax.analyses.tuning.problem import Point, Problem
from dssc_jax.analyses.tuning.progress import FINEST, PENALTY, UPDATE, Search, headroom
from dssc_jax.core.signals import ProgressCallback

LAST = 0.01  # final share of the learning rate in the cosine schedule
HALVINGS = 8
CLIFF = 0.5  # a step may not worsen the objective by more, relative to the start's: beyond lies a loop that chatters
STEEPEST = 1e6  # slope of the objective, relative to the start's: where a loop chatters, it grows with every sample
SWERVE = 0.05  # a step may not exceed a limit by more, relative to it, unless the point before did
EXACT = 0.2  # share of the steps, the last ones, in which the sign is not smoothed


class Multipliers:
    """The augmented Lagrangian of relative excesses, g <= 0: f + sum (max(0, lambda + c g)^2 - lambda^2)/(2 c).

    If a limit is exceeded by more on the validation draws than on the training draws, the difference is added to g. The
    search thus keeps away from limits by as much as its training draws mislead it.

    Reference:
        J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), section 17.4.
    """

    def __init__(self, scale: float) -> None:
        self.scale = scale
        self.values: dict[str, float] = {}
        self.gaps: dict[str, float] = {}

    def pushes(self, point: Point) -> dict[str, float]:
        """max(0, lambda + c g) of each limit: its weight in the gradient, and its next multiplier."""
        return {
            name: max(0.0, self.values.get(name, 0.0) + PENALTY * (excess + headroom(name) + self.gaps.get(name, 0.0)))
            for name, excess in point.merit.excess.items()
        }

    def gradient(self, point: Point) -> np.ndarray:
        """Gradient of the augmented Lagrangian; the limits' part alone where the objective has the slope of chatter."""
        total, pushes = point.gradient / self.scale, self.pushes(point)
        chatters = not np.all(np.abs(total) <= STEEPEST)  # an overflow, too
        if chatters and any(pushes.values()):
            total = np.zeros_like(total)
        for name, push in pushes.items():
            total = total + push * point.slopes[name]
        return total

    def move(self, train: Point, validation: Point) -> None:
        """Update the multipliers in the usual way, and compute the gaps anew."""
        self.values = self.pushes(train)
        if not validation.merit.ended:
            seen = train.merit.excess
            self.gaps = {name: max(0.0, excess - seen[name]) for name, excess in validation.merit.excess.items()}


def descend(problem: Problem, first: tuple[Point, Point], progress: ProgressCallback | None) -> Search:
    """Descend by gradients of single batches; the best point is chosen on the validation draws.

    A step is halved if the new point is not certified, a draw of the batch ends early, or the objective or violation
    increases abruptly.

    Args:
        problem: The problem, initialised.
        first: The start on training and validation draws.
        progress: Called after each step.
    """
    table = problem.plan.table
    rate: Any = table.learning_rate
    if table.schedule == "cosine":
        rate = optax.cosine_decay_schedule(table.learning_rate, table.steps, LAST)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), getattr(optax, table.optimiser)(rate))
    multipliers = Multipliers(abs(first[0].merit.objective) or 1.0)
    rng = np.random.default_rng(problem.plan.seed)
    search, iterate, waited = Search(first[1]), first[0], 0
    search.look(problem, 0, *first)
    with jax.enable_x64(True):
        state = optimiser.init(iterate.z)
    for step in range(1, table.steps + 1):
        if table.smoothing is not None:
            problem.width = falling(table.smoothing, (step - 1) / table.steps)
        with jax.enable_x64(True):
            change, state = optimiser.update(multipliers.gradient(iterate), state, iterate.z)
        batch = rng.choice(problem.train, table.batch, replace=False) if table.batch else problem.train
        iterate, halvings = reached_box(problem, iterate, np.asarray(change), batch, CLIFF * multipliers.scale)
        search.shortened += halvings
        if step % UPDATE == 0 or step == table.steps:
            validation = problem.seen(iterate.z)
            multipliers.move(iterate, validation)
            better = search.look(problem, step, iterate, validation)
            waited = 0 if better else waited + 1
        if progress:
            progress(step, table.steps)
        if waited >= table.patience:
            search.stopped = f"no better on the validation draws for {waited} looks"
            break
    return search


def falling(first: float, done: float) -> float:
    """Width of the smoothed sign after a share of the steps: it decreases geometrically, and is 0 in the last ones."""
    return first * FINEST ** (done / (1.0 - EXACT)) if done < 1.0 - EXACT else 0.0


def reached_box(
    problem: Problem, iterate: Point, change: np.ndarray, batch: np.ndarray, leap: float
) -> tuple[Point, int]:
    """The point after a step, halved until the point is allowed; if none is, the same point again."""
    highest, farthest = iterate.merit.objective + leap, max(iterate.merit.violation, SWERVE)
    for halvings in range(HALVINGS):
        after = iterate.z + change * 0.5**halvings
        if problem.allowed(after):
            point = problem.at(after, batch)
            if point.merit.objective <= highest and point.merit.violation <= farthest:
                return point, halvings
    return problem.at(iterate.z, batch), HALVINGS
