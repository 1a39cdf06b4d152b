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

    Without a request these are the controller's usual gains (``tunable``), each from a tenth to ten times its value.
    Gains that follow from parameters, have a law or are not positive are left out.

    Args:
        study: The study with the controller.
        requested: ``[compare.NAME.tune]``: ranges by the gains' names within the controller.

    Returns:
        Lowest and highest value of each gain; empty if none can be tuned.

    Raises:
        ConfigError: A range is not valid.
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
    """Names of the gains that the study's controller declares as usually tuned, within ``[controller]``."""
    controller = study.loop.controller[0]  # a plant of several channels is not tuned
    return controller.tunable_gains(study.template.controller[0])


def untuned_reason(study: Study, controller: str) -> str:
    """Why :func:`gain_ranges` finds no gain to tune, in words, with other numbers that a range can be stated for.

    Args:
        study: The study with the controller.
        controller: Name of the controller in the comparison.
    """
    numbers = {}  # of the controller that may have laws, by their names within [controller]
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
    """Why a number has no range from a tenth to ten times its value, in words; empty if it has one."""
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
    """The median of each named number that follows from an expression.

    As an override it replaces the expression, so that a search can vary the number itself.
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
    """The score of each candidate: its number of failed draws, then minus a low quantile of its worst slack.

    Scores are compared as tuples: fewer failures are better, and among equals a larger slack.

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
    """What a tuning maximises in each lane: the worst slack; without requirements, minus the first metric.

    A draw without the metric has minus infinity.
    """
    if study.requirements or not study.measures:
        return worst_slack(study.requirements, results)
    values = results[study.measures[0].name]
    return np.where(np.isnan(values), -np.inf, -values)


def candidate_points(
    study: Study, extents: Mapping[str, tuple[float, float]], count: int, seed: int
) -> dict[str, np.ndarray]:
    """Candidates for the values of some numbers, shape (count,) each.

    The first candidate has the study's own values, where it has them. The others are scrambled Sobol points that are
    even in the logarithm.

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
    """The ``[controller]`` table with other gains.

    Args:
        table: The table, which stays as it is.
        gains: The gains by their dotted names in the study, from ``controller.`` on.
    """
    holder = {"controller": copy.deepcopy(table)}
    for name, value in gains.items():
        set_dotted(holder, name, value)
    return holder["controller"]
