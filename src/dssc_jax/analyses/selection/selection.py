"""``select``: the candidates among many values of a study's numbers that fail least often."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.comparison.tuning import candidate_points, derived_medians, gain_ranges
from dssc_jax.analyses.conditions import criterion_of
from dssc_jax.analyses.defaults import INDIFFERENCE, KEPT, MOST_CANDIDATES, MOST_RACED, RACED
from dssc_jax.analyses.selection.race import RaceResult, race
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, unit_and_meaning
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import BLOCK
from dssc_jax.engine.evaluation import Evaluator, require_independent
from dssc_jax.results.analysis import Analysis
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.study import Study, takes_file


@dataclass(frozen=True)
class Chosen:
    """A chosen candidate: its values, and on how many of its draws it failed."""

    values: Annotated[dict[str, float], Quantity("those of the numbers", "its numbers' values, by dotted name")]
    draws: Annotated[int, Quantity("1", "draws on which it was simulated")]
    failures: Annotated[int, Quantity("1", "how many of them failed")]


@dataclass(frozen=True)
class SelectionAnswer:
    """The answer of a selection: the candidates that fail least often, what is claimed of them, and the cost."""

    requirements: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    ranges: Annotated[dict[str, tuple[float, float]], Quantity("those of the numbers", "where candidates lie")]
    candidates: Annotated[int, Quantity("1", "number of candidates")]
    chosen: list[Chosen]
    within: Annotated[float, Quantity("1", "a chosen candidate fails at most this much more often than any not chosen")]
    wanted_within: Annotated[float, Quantity("1", "the difference that was asked for")]
    confidence: Annotated[float, Quantity("1", "confidence of this statement on all candidates together")]
    left: Annotated[int, Quantity("1", "candidates that had not left the race at its end")]
    simulations: Annotated[int, Quantity("1", "number of simulations")]
    equal_simulations: Annotated[int, Quantity("1", "simulations if all candidates had as many draws as the chosen")]
    seconds: Annotated[float, Quantity("s", "computing time")]


@dataclass(eq=False)
class Selection(Analysis):
    """The candidates among many that fail least often.

    The dataset has along ``candidate`` the value of each number by its dotted name, the number of ``draws`` and of
    ``failures``, and ``place``: 0 for the best candidate, -1 for a candidate that was not chosen.

    Args:
        ranges: Where the candidates lie, by dotted name of the number.
        within: Largest difference of failure probabilities that is proved: a chosen candidate fails at most this much
            more often than any that was not chosen.
        wanted_within: The difference that was asked for; ``within`` is larger if the simulations did not suffice.
        left: Number of candidates that were still in the race at its end.
        simulations: Number of simulations.
        seconds: Computing time [s].
    """

    kind = "select"
    title = "The best of many candidates"
    table = ("candidate",)

    ranges: dict[str, tuple[float, float]]
    within: float
    wanted_within: float
    left: int
    simulations: int
    seconds: float

    @property
    def chosen(self) -> np.ndarray:
        """Index of each chosen candidate, the best first."""
        place = self.dataset["place"].values  # -1: not chosen
        unchosen = np.count_nonzero(place < 0)  # these come first when sorted
        return np.argsort(place, kind="stable")[unchosen:]

    @property
    def headline(self) -> str:
        """How many candidates were chosen, and what is claimed of them, in one line."""
        return (
            f"the best {len(self.chosen)} of {self.dataset.sizes['candidate']} candidates: each fails at most "
            f"{self.within:.3g} more often than any not chosen"
        )

    def figure(self) -> Figure:
        """Plot the candidates' values and shares of failed draws, and the distribution of their numbers of draws."""
        return plotting.selection(self)

    @property
    def answer(self) -> SelectionAnswer:
        """The chosen candidates, what is claimed of them, and the cost, as ``summary.json`` has them."""
        columns = {str(name): array.values for name, array in self.dataset.items()}
        draws = columns["draws"]
        chosen = []
        for candidate in self.chosen:
            values = {name: float(columns[name][candidate]) for name in self.ranges}
            chosen.append(
                Chosen(values, draws=int(draws[candidate]), failures=int(columns["failures"][candidate])),
            )
        return SelectionAnswer(
            requirements=criterion_of(self.study),
            ranges=self.ranges,
            candidates=len(draws),
            chosen=chosen,
            within=self.within,
            wanted_within=self.wanted_within,
            confidence=CONFIDENCE,
            left=self.left,
            simulations=self.simulations,
            equal_simulations=len(draws) * int(draws.max()),
            seconds=self.seconds,
        )


@takes_file
def select(
    study: Study,
    *,
    over: Mapping[str, tuple[float, float]] | None = None,
    candidates: int = RACED,
    keep: int = KEPT,
    within: float = INDIFFERENCE,
    most: int = MOST_RACED,
    progress: ProgressCallback | None = None,
) -> Selection:
    """Find the candidates that fail least often among many values of some numbers, with 95 % confidence.

    All candidates are simulated on the same independent draws. A candidate leaves early if it is proved not to be among
    the best. A run of the study has other draws, on which the choice can be judged.

    Args:
        study: The study, or its file; its sweep and its number of draws are ignored.
        over: The range of each number, by dotted name, with 0 < low < high; the number's law is replaced. Candidates
            are the study's values, where it has them, and points spread evenly in the logarithm. Without any, the
            tunable gains of the controller range from a tenth to ten times their value.
        candidates: Number of candidates.
        keep: Number of candidates to choose.
        within: Difference of failure probabilities that does not matter.
        most: Largest number of simulations; if they do not suffice, the answer has the difference that they prove.
        progress: Called with the simulations done, and with the number that will be done at the next look; further
            looks may follow.

    Raises:
        ConfigError: A number or range is not admissible, nothing can be chosen, or draws are not independent.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/motor.toml").override({"loop.sample_time": 0.01})
        >>> found = dj.select(study, over={"controller.k_p": (20.0, 400.0)}, candidates=16, keep=3, within=0.2)
        >>> len(found.answer.chosen)
        3
    """
    began = time.perf_counter()
    require_independent(study, "a race of candidates")
    if not 0.0 < within < 1.0 or most < 1:
        raise ConfigError("select", f"needs `within` in (0, 1) and `most` >= 1, got {within:g} and {most}")
    if not 1 <= keep < candidates <= MOST_CANDIDATES:
        rule = f"needs 1 <= `keep` < `candidates` <= {MOST_CANDIDATES}"
        raise ConfigError("select", f"{rule}, got {keep} and {candidates}")
    study = study.without_sweep()
    extents = selection_ranges(study, over)
    seed = (study.config.seed + 1) % 2**32  # other draws than a run of the study
    trial = study.override({"seed": seed, **derived_medians(study, extents)})
    points = candidate_points(trial, extents, candidates, seed)
    simulate_candidates = CandidateSimulator(Evaluator(trial, extents, BLOCK), points, progress)
    result = race(simulate_candidates, candidates, keep, within, most)
    return Selection(
        study=study,
        dataset=selection_dataset(study, points, result),
        ranges=extents,
        within=result.within,
        wanted_within=within,
        left=result.remaining,
        simulations=result.simulations,
        seconds=time.perf_counter() - began,
    )


@dataclass
class CandidateSimulator:
    """Simulates candidates on common draws: a :data:`~dssc_jax.analyses.selection.race.Failing` function.

    Args:
        evaluator: The compiled study.
        points: Value of each number of the candidates, by dotted name, shape (candidates,) each.
        progress: Called with the simulations done, and with the number that will be done at the next look.
        done: Number of simulations so far.
    """

    evaluator: Evaluator
    points: Mapping[str, np.ndarray]
    progress: ProgressCallback | None
    done: int = 0

    def __call__(self, candidates: np.ndarray, draws: slice) -> np.ndarray:
        """Simulate candidates in batches, and return whether each fails on each draw, shape (candidates, draws).

        Args:
            candidates: Indices of the candidates, shape (candidates,).
            draws: The draws, from the first index to the index after the last.
        """
        drawn_numbers = self.evaluator.values_of_draws(draws)
        count = draws.stop - draws.start
        goal = self.done + len(candidates) * count
        self.report(goal)
        per_batch = max(1, BLOCK // count)
        rows = []
        for begin in range(0, len(candidates), per_batch):
            batch = candidates[begin : begin + per_batch]
            values = {name: np.tile(column, len(batch)) for name, column in drawn_numbers.items()}
            for name, column in self.points.items():
                values[name] = np.repeat(column[batch], count)
            indices = np.tile(np.arange(draws.start, draws.stop), len(batch))
            rows.append(self.evaluator.fails(indices, values).reshape(len(batch), count))
            self.done += len(batch) * count
            self.report(goal)
        return np.concatenate(rows)

    def report(self, goal: int) -> None:
        """Report the simulations done, and ``goal``, the number that will be done at the next look."""
        if self.progress:
            self.progress(self.done, goal)


def selection_ranges(study: Study, over: Mapping[str, tuple[float, float]] | None) -> dict[str, tuple[float, float]]:
    """The range of each number over which candidates are spread, by dotted name: (lowest, highest) value.

    Args:
        study: The study.
        over: The ranges that were asked for; None: the tunable gains of the controller, each from a tenth to ten times
            its value.

    Raises:
        ConfigError: A range is not admissible; or without ``over``, no gain can be tuned or the plant has several
            channels.
    """
    if over is None:
        extents = gain_ranges(study, {}) if len(study.loop.controller) == 1 else {}
        if not extents:
            rule = "finds no gains of the controller that can be tuned; state numbers and their ranges with `over`"
            raise ConfigError("select", rule)
        return extents
    for name, (low, high) in over.items():
        if not 0.0 < low < high < np.inf:
            raise ConfigError(name, f"needs a range with 0 < LO < HI, got {low:g} and {high:g}")
    return dict(over)


def selection_dataset(study: Study, points: Mapping[str, np.ndarray], result: RaceResult) -> xr.Dataset:
    """The dataset of :class:`Selection`: values, draws, failures and place of each candidate.

    Args:
        study: The study.
        points: Value of each number of the candidates, by dotted name, shape (candidates,) each.
        result: The result of the race.
    """
    place = np.full(len(result.draws), -1)
    place[result.chosen] = np.arange(len(result.chosen))
    columns = {}
    for name, column in points.items():
        quantity = study.quantities[name]
        columns[name] = ("candidate", column, unit_and_meaning(quantity.unit, quantity.meaning))
    place_meaning = "place among the chosen, 0: the best, -1: none"
    columns["draws"] = ("candidate", result.draws, unit_and_meaning("1", "number of draws"))
    columns["failures"] = ("candidate", result.failures, unit_and_meaning("1", "draws that failed"))
    columns["place"] = ("candidate", place, unit_and_meaning("1", place_meaning))
    return xr.Dataset(columns, attrs={"title": study.name})
