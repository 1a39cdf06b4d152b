"""The way to better numbers: descent by optax under an augmented Lagrangian, or differential evolution."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np
import optax
from scipy.optimize import differential_evolution

from dssc_jax.engine import BLOCK
from dssc_jax.probing import Probe
from dssc_jax.tuning.plan import EVOLUTION
from dssc_jax.tuning.problem import Point, Problem

PENALTY = 20.0  # of the augmented Lagrangian, for objective and excess relative to their scales
HEADROOM = 0.01  # by which the search keeps within limits, relative
UPDATE = 5  # steps between two looks at the validation draws, after which multipliers move
LAST = 0.01  # share of the learning rate that the cosine schedule ends with
HALVINGS = 8
CLIFF = 0.5  # a step may not worsen the objective by more, relative to the start's: beyond lies a loop that chatters
SWERVE = 0.05  # a step may not exceed a limit by more, relative to it, unless the point before did
POPULATION = 8  # members a coordinate
UNFIT = 1e6  # cost of a member that is not certified, or whose draws end early
REACH = 6.0  # |z| at the ends of the evolution's box: 0.25 % of the interval's logarithm is left out

Report = Callable[[int, int, str], None]
"""Called with the steps done, the steps in all, and a line of what they found."""


@dataclass
class Search:
    """What a search found.

    Args:
        best: The best point on the validation draws.
        history: A row for each look: step, objective and violation on training and validation draws, tuned numbers.
        stopped: Why it ended.
        shortened: Halvings of steps that led where no point may be.
    """

    best: Point
    history: list[dict[str, Any]] = field(default_factory=list)
    stopped: str = "all steps done"
    shortened: int = 0

    def look(self, problem: Problem, step: int, train: Point, validation: Point) -> bool:
        """Note a point; whether it is the best so far."""
        row = {"step": step, "objective": train.merit.objective, "violation": train.merit.violation}
        row |= {"validation": validation.merit.objective, "validation_violation": validation.merit.violation}
        tuned = problem.plan.mirror.tuned(train.z)
        self.history.append(row | {name: float(value) for name, value in tuned.items()})
        better = rank(validation) < rank(self.best)
        if better or step == 0:
            self.best = validation
        return better

    def text(self) -> str:
        """The last look, for people."""
        last, best = self.history[-1], self.best.merit
        return f"objective {last['objective']:.4g}, best {best.objective:.4g}, violation {best.violation:.2g}"


def rank(point: Point) -> tuple[float, float]:
    """Within the limits first, then the least objective."""
    return point.merit.violation, point.merit.objective


class Multipliers:
    """The augmented Lagrangian of relative excesses, g <= 0: f + sum (max(0, lambda + c g)^2 - lambda^2)/(2 c).

    What a limit is exceeded by on the validation draws and not on the training draws is added to g, so that the search
    keeps away from limits by as much as its draws mislead it.

    Reference:
        J. Nocedal, S. J. Wright, Numerical Optimization, 2nd ed. (2006), section 17.4.
    """

    def __init__(self, scale: float) -> None:
        self.scale = scale
        self.values: dict[str, float] = {}
        self.gaps: dict[str, float] = {}

    def pushes(self, point: Point) -> dict[str, float]:
        """max(0, lambda + c g) of each limit: its share in the gradient, and its next multiplier."""
        return {
            name: max(0.0, self.values.get(name, 0.0) + PENALTY * (excess + HEADROOM + self.gaps.get(name, 0.0)))
            for name, excess in point.merit.excess.items()
        }

    def gradient(self, point: Point) -> np.ndarray:
        """Of the augmented Lagrangian."""
        total = point.gradient / self.scale
        for name, push in self.pushes(point).items():
            total = total + push * point.slopes[name]
        return total

    def move(self, train: Point, validation: Point) -> None:
        """The usual update of the multipliers, and the gaps anew."""
        self.values = self.pushes(train)
        if not validation.merit.ended:
            seen = train.merit.excess
            self.gaps = {name: max(0.0, excess - seen[name]) for name, excess in validation.merit.excess.items()}


def descend(problem: Problem, first: tuple[Point, Point], report: Report) -> Search:
    """Descent by gradients of single batches; the best point is chosen on the validation draws.

    A step after which the point is not certified, a draw of the batch ends early, or objective or violation have leapt
    up, is halved.

    Args:
        problem: The problem, begun.
        first: The start on training and validation draws.
        report: Told after each step.
    """
    table = problem.plan.table
    rate: Any = table.learning_rate
    if table.schedule == "cosine":
        rate = optax.cosine_decay_schedule(table.learning_rate, table.steps, LAST)
    optimiser = optax.chain(optax.clip_by_global_norm(1.0), getattr(optax, table.optimiser)(rate))
    multipliers = Multipliers(abs(first[0].merit.objective) or 1.0)
    rng = np.random.default_rng(problem.plan.seed)
    found, here, waited = Search(first[1]), first[0], 0
    found.look(problem, 0, *first)
    with jax.enable_x64(True):
        state = optimiser.init(here.z)
    for step in range(1, table.steps + 1):
        with jax.enable_x64(True):
            change, state = optimiser.update(multipliers.gradient(here), state, here.z)
        batch = rng.choice(problem.train, table.batch, replace=False) if table.batch else problem.train
        here, halvings = reach(problem, here, np.asarray(change), batch, CLIFF * multipliers.scale)
        found.shortened += halvings
        if step % UPDATE == 0 or step == table.steps:
            validation = problem.at(here.z, problem.validation)
            multipliers.move(here, validation)
            better = found.look(problem, step, here, validation)
            waited = 0 if better else waited + 1
        report(step, table.steps, found.text())
        if waited >= table.patience:
            found.stopped = f"no better on the validation draws for {waited} looks"
            break
    return found


def reach(problem: Problem, here: Point, change: np.ndarray, batch: np.ndarray, leap: float) -> tuple[Point, int]:
    """The point after a step, which is halved until the point may be visited; then the same point again."""
    highest, farthest = here.merit.objective + leap, max(here.merit.violation, SWERVE)
    for halvings in range(HALVINGS):
        after = here.z + change * 0.5**halvings
        if problem.allowed(after):
            point = problem.at(after, batch)
            if point.merit.objective <= highest and point.merit.violation <= farthest:
                return point, halvings
    return problem.at(here.z, batch), HALVINGS


def evolve(problem: Problem, first: tuple[Point, Point], report: Report) -> Search:
    """Differential evolution on the training draws, for objectives whose derivatives say nothing.

    A generation is one batch. It gets as many generations as a descent gets steps.

    Reference:
        R. Storn, K. Price, "Differential evolution", J. Global Optimization 11 (1997) 341-359.
    """
    plan, table = problem.plan, problem.plan.table
    probe = Probe(problem.probe.study, problem.probe.extents, BLOCK)
    goal, scale = problem.goal_on(problem.train), abs(first[0].merit.objective) or 1.0
    lanes = len(problem.train) + len(problem.extra)
    found, done = Search(first[1]), 0
    found.look(problem, 0, *first)

    def cost(columns: np.ndarray) -> np.ndarray:
        z = np.atleast_2d(columns.T)
        results = problem.results(z, problem.train, probe)
        values = np.empty(len(z))
        for i in range(len(z)):
            own = {name: array[i * lanes : (i + 1) * lanes] for name, array in results.items()}
            merit = goal.merit(own, (), len(problem.extra))
            fit = not merit.ended and problem.allowed(z[i])
            values[i] = merit.objective / scale + PENALTY * merit.violation if fit else UNFIT
        return values

    def told(z: np.ndarray, convergence: float) -> bool:
        nonlocal done
        done += 1
        if done % UPDATE == 0:
            found.look(problem, done, problem.at(z, problem.train), problem.at(z, problem.validation))
        report(min(done, table.steps), table.steps, found.text())
        return False

    size = len(plan.mirror.names)
    box = [(-REACH, REACH)] * size
    ended = differential_evolution(
        cost, box, x0=np.clip(first[0].z, -REACH, REACH), rng=plan.seed, popsize=POPULATION, maxiter=table.steps,
        polish=False, vectorized=True, updating="deferred", callback=told,
    )  # fmt: skip
    if done % UPDATE:
        found.look(problem, done, problem.at(ended.x, problem.train), problem.at(ended.x, problem.validation))
    return found


METHODS: dict[bool, Callable[[Problem, tuple[Point, Point], Report], Search]] = {False: descend, True: evolve}


def search(problem: Problem, first: tuple[Point, Point], useful: bool, report: Report) -> Search:
    """Descent, or evolution where it is asked for or derivatives are not useful."""
    return METHODS[problem.plan.table.optimiser == EVOLUTION or not useful](problem, first, report)
