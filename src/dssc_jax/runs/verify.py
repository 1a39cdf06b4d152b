"""Verification of a stored result by recomputing random lanes with the plain program."""

import secrets
from dataclasses import asdict, dataclass

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.engine.batching import Lanes, computing
from dssc_jax.engine.reference import Agreement, agreement, deviations, recompute, stored_lanes
from dssc_jax.engine.sampling import Arrays
from dssc_jax.results.manifest import machinery_differences
from dssc_jax.results.result import Result
from dssc_jax.statistics.order import typical_size
from dssc_jax.study.code import code_digests

LANES = 16  # recomputed unless the caller states another number
MOST_LANES = 16384  # that may be recomputed


@dataclass(frozen=True)
class SinglePrecision:
    """The effect of float32 on a result, from a comparison of lanes with the same lanes and noise in float64.

    Args:
        outcomes: Number of lanes whose outcome differs.
        median: Median over the lanes of the largest relative deviation in a lane.
        largest: Maximum of the relative deviations; infinite if a lane ends early in one precision only.
    """

    outcomes: int
    median: float
    largest: float


@dataclass(frozen=True)
class Verification:
    """The result of recomputing random lanes.

    Args:
        lanes: Number of lanes.
        seed: Seed that selected the lanes.
        deviation: Largest deviation of a value, relative to the value or to the typical size of its variable, whichever
            is larger; infinite if an outcome differs. Lanes that amplify rounding too much are left out, unless all
            lanes do.
        worst: Place of the largest deviation: variable, draw, swept values, stored and computed value; None if all
            values are equal.
        verdict: ``agrees``; ``differs`` if rounding does not explain a deviation; ``undecided`` if every lane amplifies
            rounding so much that none is evidence.
        undecided: Number of lanes that are no evidence, because they amplify rounding too much.
        otherwise: Differences in versions, device, compiler settings and code between this process and the run.
        single_precision: The effect of float32 on a result in float32; None for a result in float64.
    """

    lanes: int
    seed: int
    deviation: float
    worst: JsonObject | None
    verdict: str
    undecided: int
    otherwise: list[str]
    single_precision: SinglePrecision | None = None

    @property
    def verified(self) -> bool:
        """Whether the stored lanes agree with the study."""
        return self.verdict == "agrees"

    def to_dict(self) -> JsonObject:
        """The verification in the types of JSON."""
        return asdict(self) | {"verified": self.verified}


def verify(result: Result, draws: int = LANES, seed: int | None = None) -> Verification:
    """Recompute random lanes of a result, and compare them with the stored values.

    The plain program recomputes the lanes; it is independent of the program that produced the result.

    Args:
        result: A loaded result.
        draws: Number of lanes to recompute, each a draw at a point of the sweep; all lanes if the result has fewer.
        seed: Seed that selects the lanes; None: a new random seed.

    Raises:
        ConfigError: ``draws`` or ``seed`` is out of range.
    """
    if not 1 <= draws <= MOST_LANES:
        raise ConfigError("draws", f"must be in 1 .. {MOST_LANES}, got {draws}")
    if seed is not None and seed < 0:
        raise ConfigError("seed", f"must be >= 0, got {seed}")
    seed = secrets.randbelow(2**32) if seed is None else seed
    shape = result.dataset["outcome"].shape
    total = int(np.prod(shape))
    lane_numbers = np.sort(np.random.default_rng(seed).choice(total, min(draws, total), replace=False))
    lanes = np.unravel_index(lane_numbers, shape)
    plain_results = recompute(result.study, lanes)
    comparison = agreement(result.study, result.dataset, lanes, plain_results)
    is_compared = comparison.decided if comparison.decided.any() else np.ones_like(comparison.decided)
    compared_deviations = np.where(is_compared, comparison.deviation, -1.0)  # -1: below all deviations
    largest = int(np.argmax(compared_deviations))  # number of the lane
    worst = None
    if comparison.deviation[largest] > 0.0:
        worst = worst_lane(result, lanes, plain_results, comparison, largest)
    is_single = result.study.config.loop.precision == 32
    return Verification(
        lanes=len(lane_numbers),
        seed=seed,
        deviation=float(comparison.deviation[largest]),
        worst=worst,
        verdict=comparison.verdict,
        undecided=int(np.count_nonzero(~comparison.decided)),
        otherwise=machinery_differences(result.manifest, computing() | {"code": code_digests(result.study.table)}),
        single_precision=single_precision(result, lanes, plain_results) if is_single else None,
    )


def worst_lane(result: Result, lanes: Lanes, plain_results: Arrays, comparison: Agreement, at: int) -> JsonObject:
    """The value of a lane that deviates most, as stored and as computed, with its place; in the types of JSON.

    Args:
        result: The result.
        lanes: The recomputed lanes.
        plain_results: Variables of the recomputed lanes, by the plain program.
        comparison: The comparison with the stored values.
        at: Number of the lane among the recomputed ones.
    """
    name = str(comparison.variable[at])
    *indices_by_axis, draws = lanes
    point = {}
    for (axis, values), indices in zip(result.study.axes.items(), indices_by_axis, strict=True):
        point[axis] = values[indices[at]]
    stored_values = stored_lanes(result.dataset, [name], lanes)[name]
    both_values = {"stored": stored_values[at].item(), "computed": plain_results[name][at].item()}
    return {"variable": name, "draw": int(draws[at]), **point, **both_values}


def single_precision(result: Result, lanes: Lanes, plain_results: Arrays) -> SinglePrecision:
    """Measure the effect of float32 on a result, by comparing lanes with the same lanes in float64.

    Args:
        result: The result in float32.
        lanes: The lanes to compare.
        plain_results: Variables of the lanes in float32, by the plain program.
    """
    study = result.study.override({"loop.precision": 64})
    exact = recompute(study, lanes)
    sizes = {name: typical_size(result.dataset[name].values) for name in exact}
    single = {name: plain_results[name].astype(column.dtype) for name, column in exact.items()}
    deviations_by_name = deviations(study, sizes, exact, single)
    del deviations_by_name["outcome"]  # counted by itself
    largest = np.max(list(deviations_by_name.values()), axis=0)  # of each lane
    different_outcomes = int(np.count_nonzero(exact["outcome"] != plain_results["outcome"]))
    return SinglePrecision(different_outcomes, float(np.median(largest)), float(largest.max()))
