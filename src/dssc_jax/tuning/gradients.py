"""Whether the derivatives say what small changes do: against central differences, in the mirror's coordinates."""

from typing import NamedTuple

import numpy as np
from scipy.special import logit

from dssc_jax.probing import derivative
from dssc_jax.tuning.problem import Problem

STEP = 1e-5  # of the differences
AGREEMENT = 1e-4  # relative
NOISE = 1e-8  # relative to the value: rounding of a difference, some 1e-16/STEP, with three powers of ten of room
KINK = 1e-3  # relative jump of the slope between both sides; curvature alone changes it by about STEP
EDGE = 0.05  # share of an interval's logarithm that is left out at both ends


class Agreement(NamedTuple):
    """What came of the comparison.

    Args:
        points: Random points, each with a draw of its own.
        compared: Derivatives compared: of each metric at each point, along each coordinate.
        kinks: Share of them at which the slopes of both sides differ.
        agreeing: Share of the others that agree to 1e-4 relative.
        useful: Share of all that agree.
        ended: Points whose draw ended early, of which none is compared.
        finite: Whether no derivative of a draw that lasted is NaN or infinite.
    """

    points: int
    compared: int
    kinks: float
    agreeing: float
    useful: float
    ended: int
    finite: bool

    @property
    def text(self) -> str:
        """One line for people."""
        return (
            f"{100 * self.agreeing:.1f} % of {self.compared} derivatives agree with central differences to 1e-4 away "
            f"from kinks, which are {100 * self.kinks:.1f} %"
        )


def check_gradients(problem: Problem, points: int, seed: int = 0) -> Agreement:
    """Compare forward-mode derivatives of single draws with central differences.

    Points are uniform in the logarithm of the tuned numbers, all over their intervals.

    Args:
        problem: Objective and limits name the metrics.
        points: How many.
        seed: Of the points.
    """
    rng = np.random.default_rng(seed)
    mirror, size = problem.plan.mirror, len(problem.plan.mirror.names)
    centre = logit(rng.uniform(EDGE, 1.0 - EDGE, (points, size)))
    draws = rng.choice(problem.train, points)
    shifts = STEP * np.concatenate([np.zeros((1, size)), np.eye(size), -np.eye(size)])
    z = (centre + shifts[:, None, :]).reshape(-1, size)
    lanes = {name: np.tile(column[draws], len(shifts)) for name, column in problem.laws.items()}
    results = problem.probe(np.tile(draws, len(shifts)), {**lanes, **mirror.numbers(z)})
    chain = mirror.slopes(centre)
    exact, value, above, below = [], [], [], []
    for name in problem.plan.measures:
        table = results[name].reshape(len(shifts), points)
        rows = [results[derivative(name, of)][:points, None] * chain[of] for of in problem.names]
        exact.append(np.sum(rows, axis=0))
        value.append(np.repeat(table[0][:, None], size, axis=1))
        above.append((table[1 : 1 + size] - table[0]).T / STEP)
        below.append((table[0] - table[1 + size :]).T / STEP)
    lasted = np.isfinite(results["failed_at"].reshape(len(shifts), points)).sum(0) == 0
    of = (np.stack(parts)[:, lasted] for parts in (exact, value, above, below))
    return compared(*of, points=points, ended=int(np.count_nonzero(~lasted)))


def compared(
    exact: np.ndarray, value: np.ndarray, above: np.ndarray, below: np.ndarray, points: int, ended: int
) -> Agreement:
    """Derivatives against the differences on both sides; any shape, the same for all."""
    noise = NOISE * np.abs(value)
    central, larger = 0.5 * (above + below), np.maximum(np.abs(above), np.abs(below))
    kink = np.abs(above - below) > KINK * larger + noise
    agree = np.abs(exact - central) <= AGREEMENT * np.maximum(np.abs(exact), np.abs(central)) + noise
    smooth = int(np.count_nonzero(~kink))
    total = max(exact.size, 1)
    return Agreement(
        points=points,
        compared=exact.size,
        kinks=float(np.count_nonzero(kink) / total),
        agreeing=float(np.count_nonzero(agree & ~kink) / max(smooth, 1)),
        useful=float(np.count_nonzero(agree) / total),
        ended=ended,
        finite=bool(np.isfinite(exact).all()),
    )
