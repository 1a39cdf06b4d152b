"""Tune controllers on an equal budget: the same number of candidate gains, separate tuning draws and one objective."""

import copy
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

from dssc_jax.analyses.defaults import CANDIDATES, MOST_CANDIDATES, TUNING_DRAWS
from dssc_jax.closed_loop.metrics.requirements import worst_slack
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import nominal
from dssc_jax.core.signals import Outcome
from dssc_jax.core.toml import TomlTable
from dssc_jax.engine.batching import BLOCK
from dssc_jax.engine.evaluation import Evaluator
from dssc_jax.study import Study
from dssc_jax.study.laws import is_range
from dssc_jax.study.numbers import Number
from dssc_jax.study.tables import set_dotted

FACTOR = 10.0  # a range reaches from a tenth to ten times the study's own gain
GIVEN = 0  # index of the candidate with the given gains
RUNOFF = 1000  # further draws on which the best candidate has to be better than the given gains
LOW = 5.0  # per cent: quantile of the worst slack that decides ties; a higher one would not see the failures to come


@dataclass(frozen=True)
class Tuning:
    """The budget of a tuning, the same for every controller of a comparison.

    Args:
        candidates: Number of sets of gains that are tried, including the given one.
        draws: Draws on which each candidate is tried; the final comparison uses other draws.
        seed: Seed of these draws.
    """

    candidates: int
    draws: int
    seed: int

    @classmethod
    def of(cls, study: Study, candidates: int = CANDIDATES, draws: int = TUNING_DRAWS) -> "Tuning":
        """Create a budget whose draws differ from the study's.

        Args:
            study: The study, for its seed.
            candidates: Number of sets of gains that are tried.
            draws: Draws on which each candidate is tried.

        Raises:
            ConfigError: A count is out of range.
        """
        for name, count in (("candidates", candidates), ("tuning draws", draws)):
            if not 1 <= count <= MOST_CANDIDATES:
                raise ConfigError(name, f"must be in 1 .. {MOST_CANDIDATES}, got {count}")
        other_seed = (study.config.seed + 1) % 2**32
        return cls(candidates, draws, other_seed)

    @property
    def text(self) -> str:
        """The budget in words."""
        return (
            f"{self.candidates} candidates (the given gains, then scrambled Sobol points in the logarithm) on "
            f"{self.draws} draws of seed {self.seed}; fewest failures, then the largest {LOW:g} % quantile of "
            f"the worst slack; the given gains stay unless the best candidate is better on {RUNOFF} further draws, too"
        )


def gain_ranges(study: Study, requested: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """The range of each gain to tune, by dotted name.

    If no range is requested, the gains are those that the controller declares as ``tunable``, each from a tenth to ten
    times its value. Gains that follow from parameters, have a law or are not positive are left out.

    Args:
        study: The study with the controller.
        requested: The table ``[compare.NAME.tune]``: a range (low, high) for the name of each gain within the
            controller; empty: no request.

    Returns:
        Lowest and highest value of each gain; empty if none can be tuned.

    Raises:
        ConfigError: A requested range does not satisfy 0 < low < high.
    """
    extents = {}
    for name, extent in requested.items():
        if not is_range(extent) or not 0.0 < extent[0] < extent[1]:
            raise ConfigError(f"tune.{name}", f"must be [lo, hi] with 0 < lo < hi, got {extent!r}")
        extents[f"controller.{name}"] = (float(extent[0]), float(extent[1]))
    if extents:
        return extents
    for name in usual_gains(study):
        number = study.numbers.get(f"controller.{name}")
        if number is not None and untuned_cause(number) == "":
            value = nominal(number.value)
            extents[f"controller.{name}"] = (value / FACTOR, value * FACTOR)
    return extents


def usual_gains(study: Study) -> Sequence[str]:
    """Names within ``[controller]`` of the gains that the study's controller declares as usually tuned."""
    controller = study.loop.controller[0]  # a plant of several channels is not tuned
    return controller.tunable_gains(study.template.controller[0])


def untuned_reason(study: Study, controller: str) -> str:
    """Explain in words why :func:`gain_ranges` finds no gain to tune, and name numbers that could be tuned instead.

    Args:
        study: The study with the controller.
        controller: Name of the controller in the comparison.
    """
    numbers = {}  # the controller's numbers that may have a law, by their names within [controller]
    for number in study.numbers.values():
        section, _, name = number.name.partition(".")
        if section == "controller" and number.quantity.law:
            numbers[name] = number
    names = usual_gains(study)
    causes = [f"{name} {untuned_cause(numbers.get(name))}" for name in names]
    reason = f"of its usual gains {', '.join(causes)}" if causes else "it declares no usual gains"
    further_names = []
    for name, number in numbers.items():
        key, _, _ = name.partition(".")
        is_given = key in study.config.controller
        if name not in names and is_given and untuned_cause(number) == "":
            further_names.append(name)
    if not further_names:
        return reason
    return f"{reason}; [compare.{controller}.tune] may name others: {', '.join(further_names)}"


def untuned_cause(number: Number | None) -> str:
    """Explain in words why a number gets no range from a tenth to ten times its value; empty if it gets one.

    None stands for a gain that the controller declares, but the study does not give.
    """
    if number is None:
        return "is not given"
    if number.expression is not None:
        return "follows from parameters"
    if not isinstance(number.value, float):
        return "has a law"
    return "" if number.value > 0.0 else f"= {number.value:g} is not positive"


def best_gains(study: Study, budget: Tuning, extents: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Find the best values of a controller's gains among random candidates, by dotted name.

    The best candidate replaces the given gains only if it is better on :data:`RUNOFF` further draws, too.

    Args:
        study: The study with the controller to tune.
        budget: Number of candidates and draws.
        extents: Range of each gain. Without any, the given gains stay.

    Raises:
        ConfigError: A range is not admissible.
    """
    if not extents:
        return {}
    medians = derived_medians(study, extents)
    trial = study.without_sweep().override({"seed": budget.seed, "draws": budget.draws + RUNOFF, **medians})
    candidates = candidate_points(trial, extents, budget.candidates, budget.seed)
    most_lanes = min(budget.draws * budget.candidates, max(BLOCK, budget.draws))
    evaluator = Evaluator(trial, extents, most_lanes)
    scores = candidate_scores(evaluator, candidates, np.arange(budget.draws))
    best = scores.index(min(scores))
    finalists = {name: column[[GIVEN, best]] for name, column in candidates.items()}
    runoff_draws = np.arange(budget.draws, budget.draws + RUNOFF)
    given_score, best_score = candidate_scores(evaluator, finalists, runoff_draws)
    winner = best if best_score < given_score else GIVEN
    return {name: float(column[winner]) for name, column in candidates.items()}


def derived_medians(study: Study, names: Iterable[str]) -> dict[str, float]:
    """The median of each named number that follows from an expression, by dotted name.

    As an override of the study, the median replaces the expression, so that a search can vary the number directly.
    """
    medians = {}
    for name in names:
        number = study.numbers.get(name)
        if number is not None and number.expression is not None:
            medians[name] = nominal(number.value)
    return medians


def candidate_scores(
    evaluator: Evaluator, candidates: Mapping[str, np.ndarray], draws: np.ndarray
) -> list[tuple[int, float]]:
    """The score of each candidate: a pair of its number of failed draws and minus a low quantile of its worst slack.

    The smallest pair is the best: fewer failures decide, and between equal numbers of failures a larger slack.

    Args:
        evaluator: The compiled study.
        candidates: Value of each gain of the candidates, shape (candidates,) each.
        draws: Consecutive indices of the draws on which each candidate is simulated.
    """
    laws = evaluator.values_of_draws(slice(int(draws[0]), int(draws[-1]) + 1))
    total = len(next(iter(candidates.values())))
    per_batch = max(1, evaluator.lanes // len(draws))
    scores = []
    for first in range(0, total, per_batch):
        batch = {name: column[first : first + per_batch] for name, column in candidates.items()}
        count = min(per_batch, total - first)
        lanes = {name: np.tile(column, count) for name, column in laws.items()}
        lanes |= {name: np.repeat(column, len(draws)) for name, column in batch.items()}
        results = evaluator(np.tile(draws, count), lanes)
        by_candidate = {name: array.reshape(count, len(draws)) for name, array in results.items()}
        failures = np.count_nonzero(by_candidate["outcome"] != Outcome.OK, axis=-1)
        slacks = slack_or_metric(evaluator.swept, by_candidate)
        low_slacks = np.quantile(slacks, 0.01 * LOW, axis=-1, method="inverted_cdf")
        scores += list(zip(failures.tolist(), (-low_slacks).tolist(), strict=True))
    return scores


def slack_or_metric(study: Study, results: Mapping[str, np.ndarray]) -> np.ndarray:
    """The quantity that a tuning maximises in each lane: the worst slack of the study's requirements.

    Without requirements it is the first metric if large values of it are good, else minus that metric. A draw that
    lacks the metric gets minus infinity.

    Args:
        study: The study, for its requirements and metrics.
        results: Results of the lanes by name, all of one shape, which is also the shape returned.
    """
    if study.requirements or not study.measures:
        return worst_slack(study.requirements, results)
    measure = study.measures[0]
    values = results[measure.name]
    return np.where(np.isnan(values), -np.inf, values if measure.metric.is_large_good else -values)


def candidate_points(
    study: Study, extents: Mapping[str, tuple[float, float]], count: int, seed: int
) -> dict[str, np.ndarray]:
    """Values of some numbers for each of several candidates, by dotted name, shape (count,) each.

    The first candidate takes the study's own values, clipped to the ranges, except for numbers with a law or an
    expression. All other values are scrambled Sobol points, spread evenly in the logarithm of each range.

    Args:
        study: The study.
        extents: Lowest and highest value of each number.
        count: Number of candidates.
        seed: Seed of the Sobol points.
    """
    sobol = qmc.Sobol(len(extents), rng=np.random.default_rng(seed))
    power_of_two = 1 << (count - 1).bit_length()  # the least power of two >= count: so many Sobol points are even
    points = sobol.random(power_of_two)[:count]
    low, high = np.array(list(extents.values())).T[:, :, None]  # shape (numbers, 1) each
    columns = np.exp(np.log(low) + points.T * np.log(high / low))
    leaves = study.leaves()
    for column, name in zip(columns, extents, strict=True):
        own_value = leaves.get(name)
        if isinstance(own_value, float):
            column[GIVEN] = own_value
    return dict(zip(extents, np.clip(columns, low, high), strict=True))


def with_gains(table: TomlTable, gains: Mapping[str, float]) -> TomlTable:
    """A copy of a ``[controller]`` table with other gains.

    Args:
        table: The table, which is not modified.
        gains: The new gains by their dotted names in the study, which begin with ``controller.``.
    """
    holder = {"controller": copy.deepcopy(table)}
    for name, value in gains.items():
        set_dotted(holder, name, value)
    return holder["controller"]
