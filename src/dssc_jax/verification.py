"""Is a stored result what this program computes? A random handful of lanes, computed again and compared."""

import secrets
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from dssc_jax.dataset import variables
from dssc_jax.engine import Engine, computing
from dssc_jax.errors import ConfigError
from dssc_jax.manifest import machinery_differences
from dssc_jax.results import Result
from dssc_jax.sampling import draw

LANES, MOST_LANES = 16, 16384
ROUNDING = {64: 1e-9, 32: 2e-3}
"""Largest relative deviation by precision that another machine or compiler explains: multiply-adds contract otherwise,
and a loop without chatter keeps that small. A chattering loop amplifies it and is told as differing."""


@dataclass(frozen=True)
class Verification:
    """What computing a handful of lanes again has shown.

    Args:
        lanes: How many.
        seed: Which: the same seed picks the same ones.
        identical: How many of them agree in every bit of every variable.
        deviation: Largest deviation of a value, relative to it or to its variable's median magnitude, whichever is
            larger; infinite where an outcome differs.
        worst: Where that is: variable, draw, swept values, stored and computed value; None where all agree.
        verified: Whether the deviation is rounding.
        otherwise: How this machinery differs from the one that computed the result.
    """

    lanes: int
    seed: int
    identical: int
    deviation: float
    worst: dict[str, Any] | None
    verified: bool
    otherwise: list[str]

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def verify(result: Result, draws: int = LANES, seed: int | None = None) -> Verification:
    """Compute random lanes of a result again and compare them with what is stored.

    Args:
        result: A loaded result.
        draws: How many lanes, i.e. draws at random sweep points; all of them where the result has fewer.
        seed: Picks the lanes; None: anew each time.

    Raises:
        ConfigError: draws or seed is out of range.
    """
    if not 1 <= draws <= MOST_LANES:
        raise ConfigError("draws", f"must be in 1 .. {MOST_LANES}, got {draws}")
    if seed is not None and seed < 0:
        raise ConfigError("seed", f"must be >= 0, got {seed}")
    seed = secrets.randbelow(2**32) if seed is None else seed
    shape = result.dataset["outcome"].shape
    total = int(np.prod(shape))
    count = min(draws, total)
    picked = np.sort(np.random.default_rng(seed).choice(total, count, replace=False))
    index = np.unravel_index(picked, shape)
    stored = {
        name: result.dataset[name].values[index[-1:] if variable.dims == ("draw",) else index]
        for name, variable in variables(result.study).items()
    }
    return compare(result, index, stored, computed_again(result, index), seed)


def computed_again(result: Result, index: tuple[np.ndarray, ...]) -> dict[str, np.ndarray]:
    """Every variable of some lanes, as a batch computes them."""
    study, draws = result.study, index[-1]
    values = draw(study, draws)
    axes = {name: np.asarray(axis)[i] for (name, axis), i in zip(study.axes.items(), index, strict=False)}
    return {**values, **Engine(study, len(draws))({**axes, **values}, draws)()}


def compare(
    result: Result,
    index: tuple[np.ndarray, ...],
    stored: dict[str, np.ndarray],
    computed: dict[str, np.ndarray],
    seed: int,
) -> Verification:
    """Bit by bit, and by size where bits differ."""
    same = np.ones(len(index[-1]), dtype=bool)
    deviation, worst = 0.0, None
    for name, there in stored.items():
        here = computed[name].astype(there.dtype)
        same &= bits(there) == bits(here)
        gaps = deviations(there, here) if name != "outcome" else np.where(there == here, 0.0, np.inf)
        largest = int(np.argmax(gaps))
        if gaps[largest] > deviation:
            point = {
                axis: values[i[largest]] for (axis, values), i in zip(result.study.axes.items(), index, strict=False)
            }
            deviation = float(gaps[largest])
            worst = {"variable": name, "draw": int(index[-1][largest]), **point}
            worst |= {"stored": there[largest].item(), "computed": here[largest].item()}
    return Verification(
        lanes=len(same),
        seed=seed,
        identical=int(np.count_nonzero(same)),
        deviation=deviation,
        worst=worst,
        verified=deviation <= ROUNDING[result.study.config.loop.precision],
        otherwise=machinery_differences(result.manifest, computing()),
    )


def bits(values: np.ndarray) -> np.ndarray:
    """The values as whole numbers; NaN is one value, whatever its bits."""
    whole = np.ascontiguousarray(values).view(f"i{values.dtype.itemsize}")
    return np.where(values == values, whole, -1)


def deviations(stored: np.ndarray, computed: np.ndarray) -> np.ndarray:
    """|difference| relative to the stored value or to the median magnitude; 0 for equal NaN and infinities."""
    equal = (stored == computed) | (np.isnan(stored) & np.isnan(computed))
    finite = np.abs(stored[np.isfinite(stored)])
    typical = max(float(np.median(finite)) if finite.size else 0.0, np.finfo(float).tiny)
    with np.errstate(invalid="ignore", over="ignore"):
        gaps = np.abs(stored - computed) / np.maximum(np.abs(stored), typical)
    return np.where(equal, 0.0, np.where(np.isfinite(stored) & np.isfinite(computed), gaps, np.inf))
