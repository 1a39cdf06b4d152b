"""How far bounds can change before a design loses its certificate, and the best free parameters for a goal."""

from collections.abc import Callable, Mapping
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from scipy.optimize import differential_evolution

from dssc_jax.core.bisection import bisect
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.design.bounds import DISTURBANCE_FIELDS, LARGEST, Bounds
from dssc_jax.design.certificate import certified
from dssc_jax.design.practice import practice
from dssc_jax.design.small_gain import guarantee
from dssc_jax.design.synthesis import Free, design, synthesise
from dssc_jax.design.table1 import Parameters

LARGEST_FACTOR = 1e6  # factors beyond it count as no limit
FACTOR_HALVINGS = 60  # halvings of the interval of a factor's logarithm
AT_EDGE = 1e-3  # share of a range's logarithmic length that counts as its end
SMALLEST_VALUE = 1e-300  # least objective and residual of which a logarithm is taken
LARGEST_VALUE = 1e300
MISSED_GOAL_COST = 1e4  # added to the cost of a candidate that misses the goal; all logarithms of objectives are below
INFEASIBLE_COST = 1e9  # cost of a candidate that cannot be computed


class Limits(NamedTuple):
    """How far phi_b, or one bound, can change before a design loses its certificate; all other numbers stay.

    Args:
        phi_b: Smallest certified phi_b.
        disturbance: Largest certified factor on all bounds of the disturbance together; infinite without a limit.
        k_min: Smallest certified k_min [1/s].
        k_max: Largest certified k_max [1/s].
        a_max: Largest certified a_max [1/s].
    """

    phi_b: float
    disturbance: float
    k_min: float
    k_max: float
    a_max: float


def limits(p: Parameters, bounds: Bounds) -> Limits:
    """Find the limits of a certified design, each with all other numbers fixed; NaN for an uncertified design.

    Args:
        p: Parameters of the design, in plain numbers.
        bounds: Bounds of the design, in plain numbers.

    Example:
        >>> from dssc_jax.design import synthesise
        >>> bounds = Bounds(k_min=0.9, k_max=1.1, a_max=1.0, alpha_d3=0.1)
        >>> gains = synthesise(bounds, Free(l0=0.5, phi_a=0.1, eps=0.3, delta=0.5, eps_1=2.0, eps_2=0.1, eps_3=6.0))
        >>> round(limits(gains, bounds).k_min, 3)
        0.896
    """

    def is_certified_with_phi_b(factor: float) -> bool:
        """Whether the design is certified if phi_b is multiplied by a factor."""
        return bool(certified(p._replace(phi_b=p.phi_b * factor), bounds))

    def is_certified_with_disturbance(factor: float) -> bool:
        """Whether the design is certified if all bounds of the disturbance are multiplied by a factor."""
        return bool(certified(p, scaled_bounds(bounds, factor)))

    def is_certified_with_k_min(factor: float) -> bool:
        """Whether the design is certified if k_min is multiplied by a factor."""
        return bool(certified(p, bounds._replace(k_min=bounds.k_min * factor)))

    def is_certified_with_k_max(factor: float) -> bool:
        """Whether the design is certified if k_max is multiplied by a factor."""
        return bool(certified(p, bounds._replace(k_max=bounds.k_max * factor)))

    def is_certified_with_a_max(factor: float) -> bool:
        """Whether the design is certified if ``factor - 1`` [1/s] is added to a_max, which may be 0."""
        return bool(certified(p, bounds._replace(a_max=bounds.a_max + factor - 1.0)))

    smallest_factor = 1.0 / LARGEST_FACTOR
    return Limits(
        phi_b=p.phi_b * last_true(is_certified_with_phi_b, smallest_factor),
        disturbance=last_true(is_certified_with_disturbance, LARGEST_FACTOR),
        k_min=bounds.k_min * last_true(is_certified_with_k_min, smallest_factor),
        k_max=bounds.k_max * last_true(is_certified_with_k_max, LARGEST_FACTOR),
        a_max=last_true(is_certified_with_a_max, LARGEST_FACTOR) - 1.0 + bounds.a_max,
    )


def scaled_bounds(bounds: Bounds, factor: float) -> Bounds:
    """The bounds with every bound of the disturbance in (A1)-(A3) multiplied by a factor."""
    return bounds._replace(**{name: factor * getattr(bounds, name) for name in DISTURBANCE_FIELDS})


def last_true(holds: Callable[[float], bool], end: float) -> float:
    """The last factor, from 1 towards ``end``, at which a condition holds, by bisection of the factor's logarithm.

    Args:
        holds: (factor) -> whether the condition holds.
        end: Largest factor, above 1, or smallest factor, below 1.

    Returns:
        The factor; NaN if the condition does not hold at 1. If the condition still holds at ``end``, there is no limit:
        the result is then infinity for an ``end`` above 1, and 0 for an ``end`` below 1.
    """
    if not holds(1.0):
        return float("nan")
    if holds(end):
        return float("inf") if end > 1.0 else 0.0

    def holds_at(logarithm: np.ndarray) -> bool:
        """Whether the condition holds for the factor with this logarithm, a single number."""
        return holds(float(np.exp(logarithm)))

    holding_logarithm, _ = bisect(holds_at, 0.0, float(np.log(end)), FACTOR_HALVINGS)
    return float(np.exp(holding_logarithm))


class Criterion(StrEnum):
    """Quantity of a design that the choice of the free parameters makes as good as possible."""

    RESIDUAL = "residual"
    DECAY_RATE = "decay_rate"
    GAIN = "gain"
    PHI_B = "phi_b"


OBJECTIVES: dict[Criterion, Callable[[Parameters, Bounds], np.ndarray]] = {
    Criterion.RESIDUAL: lambda p, bounds: guarantee(p, bounds).e,
    Criterion.DECAY_RATE: lambda p, bounds: 1.0 / np.maximum(guarantee(p, bounds).decay_rate, SMALLEST_VALUE),
    Criterion.GAIN: lambda p, bounds: (p.kappa_c**2 + p.kappa_d) * (p.phi_a / p.delta + p.phi_b),
    Criterion.PHI_B: lambda p, bounds: p.phi_b,
}
"""Positive function that each criterion minimises; for ``GAIN`` it is 1/(k_o tau_av) at sigma = e = 0."""


class DesignGoal(NamedTuple):
    """The goal of an optimised design.

    Args:
        criterion: The quantity to minimise, or to maximise if it is the decay rate.
        residual: Largest admissible guaranteed bound of |e| [m]; infinite: there is no limit.
        sample_time: Sampling period [s] that the design must permit at sigma = e = 0, where half the sampling limit is
            used; 0: there is no limit.
    """

    criterion: Criterion = Criterion.RESIDUAL
    residual: float = float("inf")
    sample_time: float = 0.0


RANGES: dict[str, tuple[float, float]] = {
    "l0": (0.05, 5.0),
    "eps": (0.02, 2.0),
    "eps_1": (0.05, 50.0),
    "eps_3": (0.01, 1000.0),
}
"""Ranges of the free parameters that the optimiser varies by default, in their units (assumed)."""


def optimise(
    bounds: Bounds, free: Free, goal: DesignGoal, ranges: Mapping[str, tuple[float, float]] = RANGES, seed: int = 0
) -> Free:
    """Find the free parameters of Table 1 that are best for a goal, by differential evolution on their logarithms.

    Every candidate is a design of the strict recipe. The search minimises the logarithm of the criterion's objective.
    A candidate that misses the goal costs more than every candidate that meets the goal.

    Args:
        bounds: The bounds.
        free: Values of the parameters that are not varied.
        goal: The goal.
        ranges: Lower and upper end of each varied field of ``free``.
        seed: Seed of the search.

    Returns:
        ``free`` with the optimal values.

    Raises:
        ConfigError: A range is invalid, or no design in the ranges meets the goal; the message describes the nearest
            design.

    Example:
        >>> bounds = Bounds(k_min=0.9, k_max=1.1, a_max=1.0, alpha_d3=0.1)
        >>> start = Free(l0=0.5, phi_a=0.1, eps=0.3, delta=0.5, eps_1=2.0, eps_2=0.1, eps_3=6.0)
        >>> goal, ranges = DesignGoal(Criterion.GAIN, residual=0.1), {"eps_1": (0.1, 10.0), "eps_3": (1.0, 20.0)}
        >>> free = optimise(bounds, start, goal, ranges)
        >>> float(guarantee(synthesise(bounds, free), bounds).e) <= 0.1
        True

    Reference:
        R. Storn, K. Price, "Differential evolution", J. Global Optimization 11 (1997) 341-359.
    """
    bounds = bounds.prepare()
    for name, (low, high) in ranges.items():
        if name not in Free._fields:
            raise ConfigError(f"vary.{name}", f"unknown name; {nearest(name, Free._fields)}")
        if not 1.0 / LARGEST < low < high < LARGEST:
            raise ConfigError(
                f"vary.{name}", f"must be [low, high] with 0 < low < high < 1e30, got [{low:g}, {high:g}]"
            )

    def candidate(logarithms: np.ndarray) -> Free:
        """Free parameters with these logarithms of the varied fields, shape (fields,) or (fields, candidates)."""
        return free._replace(**dict(zip(ranges, np.exp(logarithms), strict=True)))

    def cost(logarithms: np.ndarray) -> np.ndarray:
        """Costs of the candidates of a generation, shape (candidates,), from logarithms, shape (fields, candidates)."""
        with np.errstate(all="ignore"):  # what overflows is no candidate
            p = design(bounds, candidate(logarithms))
            excess = shortfall(p, bounds, goal)
            value = np.log(np.clip(OBJECTIVES[goal.criterion](p, bounds), SMALLEST_VALUE, LARGEST_VALUE))
            costs = np.where(excess > 0.0, MISSED_GOAL_COST + excess, value)
            return np.nan_to_num(costs, nan=INFEASIBLE_COST)

    optimal_free = free
    if ranges:
        box = [(float(np.log(low)), float(np.log(high))) for low, high in ranges.values()]
        optimum = differential_evolution(
            cost, box, rng=seed, popsize=20, tol=1e-8, maxiter=400, polish=False, vectorized=True, updating="deferred"
        )
        if optimum.fun >= INFEASIBLE_COST:
            raise ConfigError("bounds", "no design in the ranges can be computed; the bounds are too far apart")
        optimal_free = Free(*map(float, candidate(optimum.x)))
    meets_goal = float(shortfall(synthesise(bounds, optimal_free), bounds, goal)) <= 0.0  # NaN: it does not
    if not meets_goal:
        raise ConfigError("goal", infeasibility_message(bounds, optimal_free, goal))
    return optimal_free


def edges(free: Free, ranges: Mapping[str, tuple[float, float]]) -> tuple[str, ...]:
    """Sentences on the optimal parameters that lie at an end of their range: a wider range may give a better design.

    Args:
        free: The optimal parameters.
        ranges: Lower and upper end of each varied field.
    """
    descriptions = []
    for name, (low, high) in ranges.items():
        share = float(np.log(getattr(free, name) / low) / np.log(high / low))
        if min(share, 1.0 - share) < AT_EDGE:
            end = "lower" if share < 0.5 else "upper"
            descriptions.append(
                f"{name} = {getattr(free, name):.4g} is the {end} end of what was sought, {low:g} to {high:g}"
            )
    return tuple(descriptions)


def shortfall(p: Parameters, bounds: Bounds, goal: DesignGoal) -> np.ndarray:
    """How far designs miss the limits of a goal; 0 for a design that meets the goal.

    The value is the sum over the violated limits of the logarithm of the ratio between value and limit.

    Args:
        p: Parameters of the designs, arrays of one shape or numbers.
        bounds: The bounds.
        goal: The goal.

    Returns:
        Array of the shape of the parameters.
    """
    excess = np.zeros(np.shape(p.phi_b))
    if np.isfinite(goal.residual):
        residual = np.clip(guarantee(p, bounds).e, SMALLEST_VALUE, LARGEST_VALUE)
        excess = excess + np.maximum(np.log(residual / goal.residual), 0.0)
    if goal.sample_time > 0.0:
        excess = excess + np.maximum(np.log(goal.sample_time / practice(p, bounds).sample_time_origin), 0.0)
    return excess


def infeasibility_message(bounds: Bounds, nearest_free: Free, goal: DesignGoal) -> str:
    """The message that no design meets the goal, with the guarantee and the sampling period of the nearest design.

    Args:
        bounds: The bounds.
        nearest_free: Free parameters of the nearest design.
        goal: The goal.
    """
    p = synthesise(bounds, nearest_free)
    e = float(guarantee(p, bounds).e)
    period = float(practice(p, bounds).sample_time_origin)
    targets = []
    if np.isfinite(goal.residual):
        targets.append(f"residual <= {goal.residual:g} m")
    if goal.sample_time > 0.0:
        targets.append(f"sample_time >= {goal.sample_time:g} s")
    return (
        f"no design in the ranges has {' and '.join(targets)}; the nearest guarantees |e| <= {e:.4g} m at a sampling "
        f"period of {period:.4g} s (phi_b = {p.phi_b:.4g}, kappa_c = {p.kappa_c:.4g})"
    )
