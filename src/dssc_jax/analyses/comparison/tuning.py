"""Tune controllers on an equal budget: the same number of candidates, separate tuning draws and one objective."""

import copy
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import qmc

from dssc_jax.analyses.defaults import CANDIDATES, MOST_CANDIDATES, TUNING_DRAWS
from dssc_jax.closed_loop.requirements import worst_slack
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import nominal
from dssc_jax.core.signals import Outcome
from dssc_jax.core.toml import TomlTable
from dssc_jax.engine.batching import BLOCK
from dssc_jax.engine.evaluation import Evaluator
from dssc_jax.study import Study
from dssc_jax.study.laws import is_number
from dssc_jax.study.numbers import Number
from dssc_jax.study.tables import set_dotted

FACTOR = 10.0  # ranges reach from a tenth to ten times the study's own gain
RUNOFF = 1000  # further draws on which the best candidate has to be better than the given gains
LOW = 5.0  # per cent: quantile of the worst slack that decides ties; a higher one would not see the failures to come


@dataclass(frozen=True)
class Tuning:
    """The budget that every controller gets.

    Args:
        candidates: Number of gains tried, including the given ones.
        draws: Draws on which each candidate is tried; the final comparison uses other draws.
        seed: Seed of these draws.
    """

    candidates: int
    draws: int
    seed: int

    @classmethod
    def of(cls, study: Study, candidates: int = CANDIDATES, draws: int = TUNING_DRAWS) -> "Tuning":
        """A budget whose draws differ from the study's.

        Raises:
            ConfigError: a count is out of range.
        """
        for name, count in (("candidates", candidates), ("tuning draws", draws)):
            if not 1 <= count <= MOST_CANDIDATES:
                raise ConfigError(name, f"must be in 1 .. {MOST_CANDIDATES}, got {count}")
        return cls(candidates, draws, (study.config.seed + 1) % 2**32)

    @property
    def text(self) -> str:
        """The budget in words."""
        return (
            f"{self.candidates} candidates (the given gains, then scrambled Sobol points in the logarithm) on "
            f"{self.draws} draws of seed {self.seed}; fewest failures, then the largest {LOW:g} % quantile of "
            f"the worst slack; the given gains stay unless the best candidate is better on {RUNOFF} further draws, too"
        )


def ranges(study: Study, requested: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """The tuned numbers of the study's controller, by dotted name, and their ranges.

    Args:
        study: The study with this controller.
        requested: ``[compare.NAME.tune]``: ranges by the gains' names within the controller. The remaining ones of the
            controller's usual gains (``tunable``) range from a tenth to ten times their value; those that follow from
            parameters keep to them. Empty if no gain of the controller can be tuned.

    Raises:
        ConfigError: a range is not valid.
    """
    extents = {}
    for name, extent in requested.items():
        numbers = isinstance(extent, list) and len(extent) == 2 and all(is_number(value) for value in extent)
        if not numbers or not 0.0 < extent[0] < extent[1]:
            raise ConfigError(f"tune.{name}", f"must be [lo, hi] with 0 < lo < hi, got {extent!r}")
        extents[f"controller.{name}"] = (float(extent[0]), float(extent[1]))
    if extents:
        return extents
    names = study.loop.controller[0].tunable_gains(study.template.controller[0])
    leaves = {name: number.value for name, number in study.numbers.items() if number.expression is None}
    values = {f"controller.{name}": leaves.get(f"controller.{name}") for name in names}
    return {
        name: (value / FACTOR, value * FACTOR)
        for name, value in values.items()
        if isinstance(value, float) and value > 0
    }


def untuned_reason(study: Study, controller: str) -> str:
    """The reason why :func:`ranges` finds no gain of the study's controller, with the numbers that may be named.

    Args:
        study: The study with this controller.
        controller: Its name in the comparison.
    """
    names = study.loop.controller[0].tunable_gains(study.template.controller[0])
    numbers = {}
    for number in study.numbers.values():
        section, _, name = number.name.partition(".")
        if section == "controller" and number.quantity.law:
            numbers[name] = number
    causes = [f"{name} {untuned_cause(numbers.get(name))}" for name in names]
    reason = f"of its usual gains {', '.join(causes)}" if causes else "it declares no usual gains"
    candidates = []
    for name, number in numbers.items():
        is_given = name.partition(".")[0] in study.config.controller
        if name not in names and is_given and untuned_cause(number) == "":
            candidates.append(name)
    return f"{reason}; [compare.{controller}.tune] may name others: {', '.join(candidates)}" if candidates else reason


def untuned_cause(number: Number | None) -> str:
    """Why a number has no range from a tenth to ten times its value, in words; empty if it has one."""
    if number is None:
        return "is not given"
    if number.expression is not None:
        return "follows from parameters"
    if not isinstance(number.value, float):
        return "has a law"
    return "" if number.value > 0.0 else f"= {number.value:g} is not positive"


def tuned(study: Study, budget: Tuning, extents: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Find the best gains within a budget, by dotted name.

    Args:
        study: The study with the controller to tune.
        budget: Candidates and draws.
        extents: What :func:`ranges` gives. Without any, the given gains stay.

    Raises:
        ConfigError: a range is not admissible.
    """
    if not extents:
        return {}
    medians = derived_medians(study, extents)
    trial = study.without_sweep().override({"seed": budget.seed, "draws": budget.draws + RUNOFF, **medians})
    candidates = candidate_points(trial, extents, budget.candidates, budget.seed)
    evaluator = Evaluator(trial, extents, min(budget.draws * budget.candidates, max(BLOCK, budget.draws)))
    all_scores = scores(evaluator, candidates, np.arange(budget.draws))
    best = min(range(len(all_scores)), key=all_scores.__getitem__)
    pair = {name: column[[0, best]] for name, column in candidates.items()}
    given_score, best_score = scores(evaluator, pair, np.arange(budget.draws, budget.draws + RUNOFF))
    winner = int(best_score < given_score)
    return {name: float(column[winner]) for name, column in pair.items()}


def derived_medians(study: Study, names: Iterable[str]) -> dict[str, float]:
    """The medians of those of the named numbers that an expression gives.

    As overrides they replace the expression, so that a search can vary the number itself.
    """
    numbers = {name: study.numbers[name] for name in names if name in study.numbers}
    return {name: nominal(number.value) for name, number in numbers.items() if number.expression is not None}


def scores(evaluator: Evaluator, candidates: Mapping[str, np.ndarray], draws: np.ndarray) -> list[tuple[int, float]]:
    """Each candidate's failures on successive draws, and minus the low quantile of its worst slack.

    The smaller score is the better one.
    """
    laws = evaluator.values_of_draws(slice(int(draws[0]), int(draws[-1]) + 1))
    number = len(next(iter(candidates.values())))
    per_batch, result = max(1, evaluator.lanes // len(draws)), []
    for begin in range(0, number, per_batch):
        part = {name: column[begin : begin + per_batch] for name, column in candidates.items()}
        count = len(next(iter(part.values())))
        lanes = {name: np.tile(column, count) for name, column in laws.items()}
        lanes |= {name: np.repeat(column, len(draws)) for name, column in part.items()}
        results = evaluator(np.tile(draws, count), lanes)
        result_table = {name: array.reshape(count, len(draws)) for name, array in results.items()}
        failures = np.count_nonzero(result_table["outcome"] != Outcome.OK, axis=-1)
        low = np.quantile(merit(evaluator.swept, result_table), 0.01 * LOW, axis=-1, method="inverted_cdf")
        result += list(zip(failures.tolist(), (-low).tolist(), strict=True))
    return result


def merit(study: Study, results: Mapping[str, np.ndarray]) -> np.ndarray:
    """The worst slack of each lane; without requirements, the first metric with its sign changed."""
    if study.requirements or not study.measures:
        return worst_slack(study.requirements, results)
    values = results[study.measures[0].name]
    return np.where(np.isnan(values), -np.inf, -values)


def candidate_points(
    study: Study, extents: Mapping[str, tuple[float, float]], count: int, seed: int
) -> dict[str, np.ndarray]:
    """The candidates, shape (count,) for each number: the study's own values first, the others spread evenly
    in the logarithm.
    """
    sobol = qmc.Sobol(len(extents), rng=np.random.default_rng(seed))
    unit = sobol.random(max(1, 1 << (count - 1).bit_length()))[:count]
    low, high = np.array(list(extents.values())).T[:, :, None]
    columns = np.exp(np.log(low) + unit.T * np.log(high / low))
    leaves = study.leaves()
    for column, name in zip(columns, extents, strict=True):
        gain = leaves.get(name)
        if isinstance(gain, float):
            column[0] = gain
    return dict(zip(extents, np.clip(columns, low, high), strict=True))


def with_gains(table: TomlTable, gains: Mapping[str, float]) -> TomlTable:
    """A controller's table with the tuned gains."""
    holder = {"controller": copy.deepcopy(table)}
    for name, value in gains.items():
        set_dotted(holder, name, value)
    return holder["controller"]
