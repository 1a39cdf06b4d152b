"""The result of a tuning."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Self, get_type_hints

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.falsification.answer import PointAnswer
from dssc_jax.analyses.tuning.derivative_free import ProvedComparison
from dssc_jax.analyses.tuning.gradients import GradientAgreement
from dssc_jax.analyses.tuning.objective import MissedBound, Verdict
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.rules import OBJECTIVE, PROVED_ERROR, seed_of
from dssc_jax.analyses.tuning.search_variables import FREE_PREFIX
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.quantities import Quantity, unit_and_meaning
from dssc_jax.design import Free
from dssc_jax.engine.sampling import Arrays
from dssc_jax.proofs.claims import claim_of_study
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.fields import MERGED, STORED_APART
from dssc_jax.results.manifest import write_json
from dssc_jax.results.summary import rows_of_columns
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.study import Study
from dssc_jax.study.schema import TuneTable
from dssc_jax.study.tables import with_changes

HISTORY = {
    "step": "step of the search",
    "objective": "objective on the training draws",
    "violation": "largest violation of a limit on the training draws, relative",
    "validation": "objective on the validation draws",
    "validation_violation": "largest violation of a limit on the validation draws, relative",
}
"""Columns of the history besides the tuned numbers, with their meanings."""
COST = "cost_"
"""Prefix of the variables with the costs of the fresh draws."""
PROOF_FILE = "proof.json"
"""The file with the result's certificate; ``dssc-jax prove`` verifies it."""


@dataclass(frozen=True)
class Counterexample:
    """The worst draw that a search found against a tuned loop, after one round of a robust tuning.

    In JSON the fields of ``worst`` are merged into this object.
    """

    worst: PointAnswer = field(metadata={MERGED: True})
    simulations: Annotated[int, Quantity("1", "simulations spent")]


@dataclass(frozen=True)
class SearchFacts:
    """Facts about the search for the tuned numbers: its method, how it ended, and what its result meets and misses.

    ``missed`` has the bounds that the result misses, ``aimed`` the proved number if it was optimised, and
    ``counterexamples`` the worst draw after each round.
    """

    method: Annotated[str, Quantity("", "method of the search")]
    stopped: Annotated[str, Quantity("", "why it ended")]
    feasible: Annotated[bool, Quantity("", "whether every limit holds on the validation draws")]
    violation: Annotated[float, Quantity("1", "largest violation of a limit on the validation draws, relative")]
    missed: tuple[MissedBound, ...]
    shortened: Annotated[int, Quantity("1", "halvings of steps that led to points that are not allowed")]
    certified_points: Annotated[int | None, Quantity("1", "points certified by Theorem 1; None if not asked")]
    proved_points: Annotated[int | None, Quantity("1", "points that are proved; None if not asked")]
    proof: Annotated[str | None, Quantity("", "what is proved of the result; None if not asked")]
    aimed: ProvedComparison | None
    counterexamples: tuple[Counterexample, ...]
    seconds: Annotated[float, Quantity("s", "computing time")]


@dataclass(frozen=True)
class ObjectiveAnswer:
    """The objective, as the study's ``[tune]`` states it."""

    costs: Annotated[dict[str, float], Quantity("1/that of the metric", "weight of each metric")]
    aggregate: Annotated[str, Quantity("", "aggregate over the draws")]
    level: Annotated[float, Quantity("1", "level of the aggregate")]


@dataclass(frozen=True)
class VerdictAnswer:
    """The comparison of result and start on fresh draws, with its confidence.

    In JSON the fields of ``verdict`` are merged into this object.
    """

    verdict: Verdict = field(metadata={MERGED: True})
    within_limits: Annotated[bool, Quantity("", "whether every limit holds on these draws")]
    confidence: Annotated[float, Quantity("1", "confidence of each interval")]


@dataclass(frozen=True)
class GradientAnswer:
    """The comparison of derivatives with differences, with its result in words.

    In JSON the fields of ``agreement`` are merged into this object.
    """

    agreement: GradientAgreement = field(metadata={MERGED: True})
    text: Annotated[str, Quantity("", "the result in one line")]


@dataclass(frozen=True)
class TuningDraws:
    """The numbers of draws that the search used, and the seed of these draws."""

    train: Annotated[int, Quantity("1", "training draws")]
    validation: Annotated[int, Quantity("1", "validation draws")]
    seed: Annotated[int, Quantity("1", "seed of both")]


@dataclass(frozen=True)
class TunedAnswer:
    """The tuned numbers, their comparison with the start on fresh draws, and how they were found.

    ``gradients`` is None if the method needs no derivatives. In JSON the fields of ``search`` are merged into this
    object.
    """

    objective: ObjectiveAnswer
    start: Annotated[dict[str, float], Quantity("that of the number", "tuned numbers at the start")]
    tuned: Annotated[dict[str, float], Quantity("that of the number", "tuned numbers found")]
    controller: Annotated[JsonObject, Quantity("", "the tuned controller's table")]
    verdict: VerdictAnswer
    gradients: GradientAnswer | None
    draws: TuningDraws
    search: SearchFacts = field(metadata={MERGED: True})


@dataclass(eq=False)
class Tuned(Analysis):
    """The result of a tuning.

    The dataset has along ``look``, each evaluation on the validation draws, the step, objective and violation on
    training and validation draws, and the tuned numbers. Along ``draw`` it has the cost of every fresh draw,
    ``cost_start`` and ``cost_tuned``.

    Args:
        start: The tuned numbers at the start of the search, by name.
        values: The tuned numbers found.
        numbers: The loop's numbers that follow from the tuned ones, by dotted name.
        gradients: The comparison of derivatives with differences; None if there was none.
        verdict: The comparison of result and start on fresh draws.
        facts: How the search went.
    """

    kind = "tune"
    title = "Tuned gains"
    table = ("look",)

    start: dict[str, float]
    values: dict[str, float]
    numbers: dict[str, float]
    gradients: GradientAgreement | None
    verdict: Verdict
    facts: SearchFacts
    certificate: JsonObject | None = field(default=None, init=False, repr=False, metadata={STORED_APART: True})
    """Content of the result's certificate file; None if no proof is required."""

    @property
    def tuned_study(self) -> Study:
        """The study with the tuned numbers in place of its own."""
        return self.study.override(self.numbers)

    @property
    def plan(self) -> Plan:
        """The settings of the tuning, read from the study."""
        return Plan.of(self.study)

    @property
    def history(self) -> list[dict[str, Any]]:
        """The history of the search: a row for each evaluation on validation draws, values by column."""
        columns = {}
        for name, variable in self.dataset.items():
            if variable.dims == ("look",):
                columns[str(name)] = variable.values.tolist()
        return rows_of_columns(columns)

    @property
    def proved_loop(self) -> dict[str, Any]:
        """The loop that the result's certificate has to prove, in the form of a certificate's file.

        If the last value of a number at which the loop is proved was optimised, this is the loop with that value.
        """
        from dssc_jax.proofs.coverage import problem_of
        from dssc_jax.proofs.reach import problem_at

        aimed = self.facts.aimed
        if aimed is None or aimed.over is None:
            problem = problem_of(self.tuned_study)
        else:
            problem = problem_at(self.tuned_study, aimed.over, aimed.result)
        return json.loads(json.dumps(problem.to_dict()))  # tuples become lists, as in a file

    @property
    def costs(self) -> Arrays:
        """Cost of every fresh draw, shape (draws,), for ``start`` and ``tuned``."""
        return {name: self.dataset[COST + name].values for name in ("start", "tuned")}

    @property
    def met(self) -> bool:
        """Whether limits and requirements hold on the validation draws, and the last worst draw does not fail."""
        counterexamples = self.facts.counterexamples
        fails_worst_draw = bool(counterexamples) and counterexamples[-1].worst.slack < 0.0
        return self.facts.feasible and not fails_worst_draw

    @property
    def headline(self) -> str:
        """The objective before and after on fresh draws, and the proved number if it was optimised, in one line."""
        start, result = self.verdict.objective
        text = f"objective {start:.4g} to {result:.4g} on {self.verdict.draws:,} fresh draws"
        aimed = self.facts.aimed
        if aimed is None:
            return text
        return f"{aim_quantity(self.study).meaning}: {aimed.start:.4g} to {aimed.result:.4g}; {text}"

    def figure(self) -> Figure:
        """Plot objective and violation along the search, and the fresh draws' costs."""
        return plotting.tuning(self)

    @property
    def answer(self) -> TunedAnswer:
        """The tuned numbers, and their comparison with the start on fresh draws, as ``summary.json`` has them."""
        table = tuned_table(self.study)
        gradients = None if self.gradients is None else GradientAnswer(self.gradients, self.gradients.text)
        return TunedAnswer(
            objective=ObjectiveAnswer(table.objective, table.aggregate, table.level),
            start=self.start,
            tuned=self.values,
            controller=with_changes(self.study.table, self.numbers, self.study.source)["controller"],
            verdict=VerdictAnswer(self.verdict, self.verdict.within, CONFIDENCE),
            gradients=gradients,
            draws=TuningDraws(table.draws, table.validation, seed_of(self.study, table)),
            search=self.facts,
        )

    def save(self, folder: str | Path) -> Path:
        """Save the analysis in a folder, and the certificate in a separate file, if there is one."""
        path = super().save(folder)
        if self.certificate is not None:
            write_json(path / PROOF_FILE, self.certificate)
        return path

    @classmethod
    def load(cls, folder: str | Path, trust_code: bool = False) -> Self:
        """Load an analysis from a folder. Its certificate is not verified; see :meth:`Analysis.load`."""
        tuned = super().load(folder, trust_code)
        path = Path(folder) / PROOF_FILE
        if path.exists():
            try:
                tuned.certificate = json.loads(files.read_text(path))
            except (OSError, ValueError) as error:
                raise ConfigError(str(path), f"is damaged: {error!r}; run the tuning again") from None
        return tuned


def tuning_dataset(study: Study, history: Sequence[Mapping[str, Any]], costs: Mapping[str, np.ndarray]) -> xr.Dataset:
    """The dataset of :class:`Tuned`: the history along ``look``, the costs of the fresh draws along ``draw``.

    Args:
        study: The study.
        history: A row for each evaluation on validation draws.
        costs: Cost of every fresh draw for ``start`` and ``tuned``, shape (draws,) each.
    """
    quantities = history_quantities(study)
    variables = {}
    for name in history[0]:
        values = np.array([row[name] for row in history])
        variables[name] = ("look", values, unit_and_meaning(quantities[name].unit, quantities[name].meaning))
    for name, values in costs.items():
        variables[COST + name] = ("draw", values, unit_and_meaning("1", f"cost of a draw, {name}"))
    return xr.Dataset(variables, attrs={"title": study.name})


def history_quantities(study: Study) -> dict[str, Quantity]:
    """Unit and meaning, by name, of all columns that a history may have: of the search, and the tuned numbers."""
    quantities = {name: Quantity("1", text) for name, text in HISTORY.items()} | study.quantities
    aim = tuned_table(study).aim
    if aim != OBJECTIVE:
        quantities[aim] = aim_quantity(study)
    for name, hint in get_type_hints(Free, include_extras=True).items():
        quantities[FREE_PREFIX + name] = hint.__metadata__[0]  # Annotated[float, Quantity(...)]
    return quantities


def aim_quantity(study: Study) -> Quantity:
    """Unit and meaning of the proved number that is optimised."""
    table = tuned_table(study)
    if table.aim == PROVED_ERROR:
        return Quantity(study.units[0].output, f"proved bound of {claim_of_study(study).error} once settled")
    name = next(iter(table.over))  # the rules of [tune] require exactly one
    unit = study.quantities[name].unit if name in study.quantities else "1"
    return Quantity(unit, f"last proved {name}")


def tuned_table(study: Study) -> TuneTable:
    """The table ``[tune]`` of a study that was tuned, which therefore has one."""
    table = study.config.tune
    assert table is not None
    return table
