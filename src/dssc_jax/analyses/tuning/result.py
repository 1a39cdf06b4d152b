"""The result of a tuning."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self, get_type_hints

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.tuning.certified import PREFIX
from dssc_jax.analyses.tuning.gradients import GradientAgreement
from dssc_jax.analyses.tuning.plan import OBJECTIVE, PROVED_ERROR, Plan, seed_of
from dssc_jax.analyses.tuning.verdict import Verdict
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.design import Free
from dssc_jax.engine.batching import Arrays
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import Stored
from dssc_jax.results.manifest import write_json
from dssc_jax.study import Study
from dssc_jax.study.schema import TuneTable
from dssc_jax.study.tables import changed

LOOKED = {
    "step": "step of the search",
    "objective": "objective on the training draws",
    "violation": "largest violation of a limit on the training draws, relative",
    "validation": "objective on the validation draws",
    "validation_violation": "largest violation of a limit on the validation draws, relative",
}
"""Recorded at each evaluation on validation draws besides the tuned numbers."""
COST = "cost_"
PROOF_FILE = "proof.json"
"""The result's certificate in its folder; ``dssc-jax prove`` verifies it."""


@dataclass(eq=False)
class Tuned(Analysis):
    """The result of a tuning.

    The dataset has the history along ``look``: step, objective and violation on training and validation draws, and the
    tuned numbers. Along ``draw`` it has the cost of every fresh draw, ``cost_start`` and ``cost_tuned``.

    Args:
        start: The tuned numbers at the start of the search, by name.
        values: The tuned numbers found.
        numbers: The loop's numbers that follow from them.
        gradients: The comparison of derivatives with differences; None if there was none.
        verdict: The evaluation on fresh draws.
        facts: Facts of the search: method, why it ended, steps shortened, iterates certified, counterexamples, seconds.
        certificate: Content of the result's certificate file; None if no proof is required.
    """

    kind = "tune"
    title = "Tuned gains"
    table = ("look",)

    start: dict[str, float]
    values: dict[str, float]
    numbers: dict[str, float]
    gradients: GradientAgreement | None
    verdict: Verdict
    facts: dict[str, Any]
    certificate: dict[str, Any] | None = None

    @property
    def tuned_study(self) -> Study:
        """The study with the tuned numbers."""
        return self.study.override(self.numbers)

    @property
    def plan(self) -> Plan:
        """The settings of the tuning, read from the study."""
        return Plan.of(self.study)

    @property
    def history(self) -> list[dict[str, Any]]:
        """A row for each evaluation on validation draws."""
        columns = {str(name): one.values.tolist() for name, one in self.dataset.items() if one.dims == ("look",)}
        return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]

    @property
    def proved_loop(self) -> dict[str, Any]:
        """The loop that the certificate has to be of, as a certificate's file describes it."""
        from dssc_jax.proofs.coverage import problem_of
        from dssc_jax.proofs.reach import problem_at

        aimed = self.facts.get("aimed")
        if aimed is None or aimed["over"] is None:
            problem = problem_of(self.tuned_study)
        else:
            problem = problem_at(self.tuned_study, aimed["over"], aimed["result"])
        return json.loads(json.dumps(problem.to_dict()))

    @property
    def costs(self) -> Arrays:
        """Cost of every fresh draw, ``start`` and ``tuned``."""
        return {name: self.dataset[COST + name].values for name in ("start", "tuned")}

    @property
    def met(self) -> bool:
        """Whether limits and requirements hold on the validation draws, and the last search found no failure."""
        hunts = self.facts["counterexamples"]
        return self.facts["feasible"] and not (hunts and hunts[-1]["slack"] < 0.0)

    @property
    def headline(self) -> str:
        """The objective before and after, on fresh draws."""
        before, after = self.verdict.objective
        text = f"objective {before:.4g} to {after:.4g} on {self.verdict.draws:,} fresh draws"
        if (aimed := self.facts.get("aimed")) is None:
            return text
        return f"{aim_quantity(self.study).meaning}: {aimed['start']:.4g} to {aimed['result']:.4g}; {text}"

    def figure(self) -> Figure:
        """Plot the search and the fresh draws' costs: :func:`dssc_jax.plotting.tuning`."""
        return plotting.tuning(self)

    def content(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        table = tuned_table(self.study)
        return {
            "objective": {"costs": table.objective, "aggregate": table.aggregate, "level": table.level},
            "start": self.start,
            "tuned": self.values,
            "controller": changed(self.study.table, self.numbers, self.study.source)["controller"],
            "verdict": self.verdict.to_dict(),
            "gradients": self.gradients and {**self.gradients._asdict(), "text": self.gradients.text},
            "draws": {"train": table.draws, "validation": table.validation, "seed": seed_of(self.study, table)},
            **self.facts,
        }

    def settings(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        return {
            **{name: getattr(self, name) for name in ("start", "values", "numbers", "facts")},
            "gradients": self.gradients and self.gradients._asdict(),
            "verdict": self.verdict._asdict(),
        }

    def save(self, folder: str | Path) -> Path:
        """See :class:`Analysis`; with the certificate as a file of its own, if there is one."""
        path = super().save(folder)
        if self.certificate is not None:
            write_json(path / PROOF_FILE, self.certificate)
        return path

    @classmethod
    def load(cls, folder: str | Path, trust_code: bool = False) -> Self:
        """See :class:`Analysis`; the certificate is what the folder claims until it is verified."""
        tuned = super().load(folder, trust_code)
        path = Path(folder) / PROOF_FILE
        if path.exists():
            try:
                tuned.certificate = json.loads(files.read_text(path))
            except (OSError, ValueError) as error:
                raise ConfigError(str(path), f"is damaged: {error!r}; run the tuning again") from None
        return tuned

    @classmethod
    def restored(cls, stored: Stored) -> Self:
        """See :class:`Analysis`."""
        settings = dict(stored.settings)
        gradients, verdict = settings.pop("gradients"), settings.pop("verdict")
        agreement = None if gradients is None else GradientAgreement(**gradients)
        own = Verdict(**{name: as_tuples(value) for name, value in verdict.items()})
        return cls(stored.study, stored.dataset, **settings, gradients=agreement, verdict=own)


def dataset_of(study: Study, history: Sequence[Mapping[str, Any]], costs: Mapping[str, np.ndarray]) -> xr.Dataset:
    """Store history and costs in a dataset: see :class:`Tuned`."""
    meanings = {name: Quantity("1", text) for name, text in LOOKED.items()} | study.quantities
    if (aim := tuned_table(study).aim) != OBJECTIVE:
        meanings[aim] = aim_quantity(study)
    for name, hint in get_type_hints(Free, include_extras=True).items():
        meanings[PREFIX + name] = hint.__metadata__[0]
    columns = {name: ("look", np.array([row[name] for row in history]), meanings[name]) for name in history[0]}
    for name, values in costs.items():
        columns[COST + name] = ("draw", values, Quantity("1", f"cost of a draw, {name}"))
    described = {
        name: (dimension, values, {"units": about.unit, "long_name": about.meaning})
        for name, (dimension, values, about) in columns.items()
    }
    return xr.Dataset(described, attrs={"title": study.name})


def aim_quantity(study: Study) -> Quantity:
    """Unit and meaning of the proved number that is optimised."""
    table = tuned_table(study)
    if table.aim == PROVED_ERROR:
        return Quantity(study.units[0].output, "proved bound of |e| once settled")
    name = next(iter(table.over))
    unit = study.quantities[name].unit if name in study.quantities else "1"
    return Quantity(unit, f"last proved {name}")


def tuned_table(study: Study) -> TuneTable:
    """The study's ``[tune]``."""
    table = study.config.tune
    assert table is not None
    return table


def as_tuples(value: Any) -> Any:
    """Convert the lists of JSON back to tuples."""
    if isinstance(value, list):
        return tuple(map(as_tuples, value))
    return {name: as_tuples(one) for name, one in value.items()} if isinstance(value, dict) else value
