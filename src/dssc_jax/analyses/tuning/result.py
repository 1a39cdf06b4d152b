"""A finished tuning."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from dssc_jax.analyses.tuning.gradients import Agreement
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.verdict import Verdict
from dssc_jax.results.analysis_folder import save
from dssc_jax.study import Study


@dataclass
class Tuned:
    """What a tuning found.

    Args:
        plan: What was asked for.
        study: The study with the tuned numbers in it.
        start: The tuned numbers where the search began, by name.
        values: The tuned numbers found.
        history: A row for each look on the way, see :class:`dssc_jax.analyses.tuning.search.Search`.
        gradients: How derivatives compared with differences; None: it was not asked.
        verdict: What fresh draws say.
        costs: Cost of every fresh draw, ``start`` and ``tuned``.
        facts: How the search went: method, why it ended, steps shortened, iterates certified, counterexamples, seconds.
    """

    plan: Plan
    study: Study
    start: dict[str, float]
    values: dict[str, float]
    history: list[dict[str, Any]]
    gradients: Agreement | None
    verdict: Verdict
    costs: dict[str, np.ndarray]
    facts: dict[str, Any] = field(default_factory=dict)

    @property
    def met(self) -> bool:
        """Whether limits and requirements hold on the validation draws, and the last hunt found no failure."""
        hunts = self.facts["counterexamples"]
        return self.facts["feasible"] and not (hunts and hunts[-1]["slack"] < 0.0)

    def summary(self) -> dict[str, Any]:
        """The tuning in plain numbers, for JSON; NaN and infinity still to be replaced."""
        table = self.plan.table
        return {
            "study": self.study.name,
            "objective": {"costs": table.objective, "aggregate": table.aggregate, "level": table.level},
            "start": self.start,
            "tuned": self.values,
            "controller": self.study.config.controller,
            "verdict": self.verdict.to_dict(),
            "gradients": self.gradients and {**self.gradients._asdict(), "text": self.gradients.text},
            "draws": {"train": table.draws, "validation": table.validation, "seed": self.plan.seed},
            **self.facts,
        }

    @property
    def dataset(self) -> xr.Dataset:
        """The history along ``look``, and the costs of the fresh draws along ``draw``."""
        columns = {name: ("look", [row[name] for row in self.history]) for name in self.history[0]}
        costs = {f"cost_{name}": ("draw", values) for name, values in self.costs.items()}
        return xr.Dataset({**columns, **costs}, attrs={"title": self.study.name})

    def save(self, folder: str | Path) -> Path:
        """Write dataset and summary into a folder.

        Raises:
            ConfigError: the folder holds something else.
        """
        return save(Path(folder), "tune", self.study, self.dataset, self.summary())
