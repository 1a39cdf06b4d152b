"""How large a change of the laws may be, by new draws that are simulated under the changed laws."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated

import numpy as np

from dssc_jax.analyses.laws.all_changes import AllChanges
from dssc_jax.analyses.laws.fresh_draws import FreshDraws
from dssc_jax.core.bisection import bisect
from dssc_jax.core.quantities import Quantity
from dssc_jax.statistics import clopper_pearson
from dssc_jax.statistics.worst_changes import LargestChange, WeightedDraws

SMALLEST = 2.0**-4  # size from which the change is doubled until the limit is exceeded
LARGEST = 4.0  # largest size tried
HALVINGS = 8  # halvings of the last doubling
TRIAL = 0.3  # size at which the direction is taken from draws whose weights are not trusted
TOWARDS_FAILURE = 1.0  # sign that asks for the change with the most failures


@dataclass(frozen=True)
class FreshLimit:
    """The largest change that keeps the limit by new draws, in the direction that is worst by the weighted draws."""

    bound: Annotated[float, Quantity("that of the change", "largest change, with confidence")]
    estimate: Annotated[
        float | None,
        Quantity("that of the change", "largest change by the share of failing draws; None: the limit is not reached"),
    ]
    failures: Annotated[int, Quantity("1", "new draws that fail at the bound")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability at the bound")]


@dataclass(frozen=True)
class FreshLimits:
    """The largest shift of all means and the largest widening of all laws, tested with new draws."""

    draws: Annotated[int, Quantity("1", "number of new draws at each change")]
    simulations: Annotated[int, Quantity("1", "number of simulations")]
    changes: dict[str, FreshLimit]


def worst_direction(draws: WeightedDraws, largest: LargestChange) -> np.ndarray:
    """The direction of the worst change: an amount for each law, shape (laws,), scaled so that the largest is +-1.

    Where the weights are not trusted at any size above 0, the direction is that of the worst change of size
    :data:`TRIAL`: the weights are too uneven for a probability there, but still show the direction.

    Args:
        draws: The weighted draws.
        largest: The largest change by the weights.
    """
    amounts = largest.worst.amounts
    if largest.explored == 0.0:
        amounts = draws.extreme(TRIAL, TOWARDS_FAILURE)
    return amounts / max(float(np.abs(amounts).max()), np.finfo(float).tiny)


def fresh_limit(fresh: FreshDraws, draws: WeightedDraws, largest: LargestChange, limit: float) -> FreshLimit:
    """Find the largest change in the worst direction, by simulating new draws under changed laws.

    The bisection assumes that the failure probability grows along the direction.

    Args:
        fresh: The new draws; each changed law moves the same draws.
        draws: The weighted draws, which give the direction and the kind of change.
        largest: The largest change by the weights.
        limit: Largest failure probability allowed.
    """
    direction = worst_direction(draws, largest)

    @lru_cache
    def failures(size: float) -> int:
        """Number of new draws that fail under a change of this size in the worst direction; each size is run once."""
        return fresh.count_failures(draws.change.apply(size * direction, fresh.scores))

    def interval(size: float) -> list[float]:
        """Lower and upper limit of the failure probability (Clopper-Pearson) under a change of this size."""
        return clopper_pearson(failures(size), fresh.count, draws.confidence).tolist()

    def keeps_limit(size: float) -> bool:
        """Whether the upper limit of the failure probability's interval is at most ``limit``."""
        _, high = interval(size)
        return high <= limit

    def keeps_limit_by_estimate(size: float) -> bool:
        """Whether the share of failing draws is at most ``limit``."""
        return failures(size) <= limit * fresh.count

    bound = largest_size_by_doubling(keeps_limit)
    estimate = largest_size_by_doubling(keeps_limit_by_estimate)
    low, high = interval(bound)
    amount = draws.change.amount
    estimated_amount = None if estimate == LARGEST else amount(estimate)  # None: the limit is not reached
    return FreshLimit(amount(bound), estimated_amount, failures(bound), (low, high))


def fresh_limits(fresh: FreshDraws, changes: Sequence[AllChanges], limit: float) -> FreshLimits:
    """Find the largest change of each kind with the same new draws, in the worst direction by the weights.

    Args:
        fresh: The new draws.
        changes: The kinds of change, each with the weighted draws.
        limit: Largest failure probability allowed.
    """
    limits = {kind.draws.change.name: fresh_limit(fresh, kind.draws, kind.largest, limit) for kind in changes}
    return FreshLimits(fresh.count, fresh.simulated, limits)


def largest_size_by_doubling(holds: Callable[[float], bool]) -> float:
    """The size up to which a condition holds, from 0 to :data:`LARGEST`, found by doubling and then by bisection.

    Args:
        holds: (size) -> whether the condition holds; if it fails at a size, it fails at all larger ones.
    """
    if not holds(0.0):
        return 0.0
    inside = 0.0
    outside = SMALLEST
    while holds(outside):
        if outside == LARGEST:
            return LARGEST
        inside = outside
        outside = 2.0 * outside
    inside, _ = bisect(lambda size: holds(float(size)), inside, outside, HALVINGS)
    return float(inside)
