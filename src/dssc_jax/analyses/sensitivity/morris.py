"""Morris screening of every metric and of failure: which of many numbers matter at all, by few simulations.

A trajectory moves the factors one after the other, in random order, each by half of the probability of its law. The
change of the output in such a move is an elementary effect of the factor. The mean mu* of the effects' absolute values
says how much a factor matters. The spread sigma of the signed effects says how much this depends on the other factors
or on where the factor is. In-loop noise is one more factor: its move is another draw index.

Reference:
    M. D. Morris, Technometrics 33 (1991) 161-174; F. Campolongo, J. Cariboni, A. Saltelli, Environmental Modelling &
    Software 22 (2007) 1509-1518, on mu*.
"""

import math

import numpy as np
from scipy import special

from dssc_jax.analyses.sensitivity.outputs import RowDesign, RowSample, require_uncorrelated
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import stream
from dssc_jax.engine.sampling import generator
from dssc_jax.statistics import clopper_pearson
from dssc_jax.study import Study

GRID_LEVELS = 4  # levels of a factor: the middles of the four quarters of its probability, from 0 to 1
FEWEST = 10  # trajectories, for intervals of some use


def trajectories(count: int, factors: int, seeds: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Random trajectories through the grid of levels; each moves the factors one after the other.

    Args:
        count: Number of trajectories.
        factors: Number of factors.
        seeds: Seeds of the random generator.

    Returns:
        The levels of all factors after 0, 1, ... moves, in (0, 1), shape (factors + 1, count, factors), and the order
        in which the factors move, as indices of factors, shape (count, factors).
    """
    rng = generator(*seeds)
    order = rng.permuted(np.tile(np.arange(factors), (count, 1)), axis=1)
    start = rng.integers(GRID_LEVELS, size=(count, factors))
    end = (start + GRID_LEVELS // 2) % GRID_LEVELS
    place_in_order = np.argsort(order, axis=1)
    has_moved = place_in_order < np.arange(factors + 1)[:, None, None]  # (moves made, trajectories, factors)
    return (np.where(has_moved, end, start) + 0.5) / GRID_LEVELS, order


def elementary_effects(values: np.ndarray, levels: np.ndarray, order: np.ndarray) -> np.ndarray:
    """The change of an output when each factor moves up by half of its probability, shape (factors, trajectories).

    If the factor moved down in a trajectory, the sign of the change is reversed.

    Args:
        values: Output at each point of each trajectory, shape (factors + 1, trajectories).
        levels: Levels of the factors there, shape (factors + 1, trajectories, factors).
        order: The order in which the factors move, shape (trajectories, factors).
    """
    changes = np.empty_like(values[1:])  # by factor
    np.put_along_axis(changes, order.T, np.diff(values, axis=0), axis=0)
    direction = np.sign(levels[-1] - levels[0]).T  # 1: the factor moved up; -1: down
    return changes * direction


def screening(effects: np.ndarray, confidence: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean size mu* and spread sigma of each factor's elementary effects, with intervals over the trajectories.

    The intervals are Student's t. For sigma the standard error comes from the jackknife, the scatter of sigma when one
    trajectory at a time is left out. If all effects are -1, 0 or 1, the output is an indicator, such as failure. Its
    mu* is then a proportion with an exact interval (Clopper-Pearson), whose upper end bounds sigma^2, too.

    Args:
        effects: Elementary effects, shape (factors, trajectories).
        confidence: Confidence of the intervals.

    Returns:
        Estimate, lower and upper end of mu*, shape (factors, 3), and of sigma, shape (factors, 3).
    """
    count = effects.shape[1]
    reach = special.stdtrit(count - 1, 0.5 * (1.0 + confidence)) / math.sqrt(count)  # in standard deviations
    sizes = np.abs(effects)
    spread = effects.std(1, ddof=1)
    squares = (effects - effects.mean(1, keepdims=True)) ** 2
    variances_without_one = ((count - 1) * spread[:, None] ** 2 - squares * count / (count - 1)) / (count - 2)
    jackknife_values = (count - 1) * np.sqrt(np.maximum(variances_without_one, 0.0))  # up to sign and a constant
    size_table = interval_table(sizes.mean(1), reach * sizes.std(1, ddof=1))
    spread_table = interval_table(spread, reach * jackknife_values.std(1, ddof=1))
    is_indicator = np.all(np.isin(sizes, (0.0, 1.0)))
    if is_indicator:
        size_table[:, 1:] = clopper_pearson(np.count_nonzero(sizes, axis=1), count, confidence)
        spread_table[:, 2] = np.sqrt(size_table[:, 2])
    return size_table, spread_table


def interval_table(estimate: np.ndarray, half: np.ndarray) -> np.ndarray:
    """Estimates of nonnegative numbers with the ends of symmetric intervals, shape (factors, 3).

    The columns are estimate, lower end (at least 0) and upper end.

    Args:
        estimate: The estimates, shape (factors,).
        half: Half length of each interval, shape (factors,).
    """
    return np.stack([estimate, np.maximum(estimate - half, 0.0), estimate + half], axis=1)


def trajectory_count(study: Study, noisy: bool = False) -> int:
    """The number of trajectories that the study's draws allow; each takes one simulation more than there are factors.

    Args:
        study: The study; its number of draws is the largest number of simulations.
        noisy: Whether in-loop noise is a factor.

    Raises:
        ConfigError: Inputs are correlated, or there are too few draws.
    """
    require_uncorrelated(study, claim="the moves of Morris screening are those of")
    factors = len(study.laws) + int(noisy)
    count = study.config.draws // (factors + 1)
    if count < FEWEST:
        rule = f"Morris screening of {factors} factors needs draws >= {FEWEST * (factors + 1)}"
        raise ConfigError(study.source, f"{rule}, got {study.config.draws}")
    return count


def morris_design(study: Study, noisy: bool, confidence: float) -> RowDesign:
    """The design of a screening: as many trajectories as the study's number of draws allows.

    Args:
        study: The study; its number of draws is the largest number of simulations.
        noisy: Whether in-loop noise is a factor.
        confidence: Confidence of the intervals.

    Raises:
        ConfigError: Inputs are correlated, or there are too few draws.
    """
    count = trajectory_count(study, noisy)
    laws = len(study.laws)
    factors = laws + int(noisy)
    levels, order = trajectories(count, factors, (study.config.seed, stream("morris")))
    indices = np.tile(np.arange(count), (factors + 1, 1))
    if noisy:  # its factor has the index laws, and moves by another draw index
        has_moved = levels[..., laws] != levels[0, :, laws]
        indices = np.where(has_moved, indices + count, indices)
    return RowDesign(
        count,
        samples=[RowSample(levels[move, :, :laws], indices[move]) for move in range(factors + 1)],
        refusal=lambda values: "does not vary" if np.ptp(values) == 0.0 else None,
        quantities=lambda values: screening(elementary_effects(values, levels, order), confidence),
    )
