"""The comparison itself: every controller on the same draws and noise, and what one may say of each pair."""

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import xarray as xr

from dssc_jax.analyses.comparison.rivals import Table, controller_table
from dssc_jax.analyses.comparison.tuning import Tuning, tuned, with_gains
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Outcome, ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.results.analysis_folder import read, save
from dssc_jax.results.result import headline_measure
from dssc_jax.runs import run as running
from dssc_jax.statistics import CONFIDENCE, clopper_pearson, compare_failures, compare_metrics
from dssc_jax.statistics.order import upper_quantiles
from dssc_jax.study import Study


@dataclass
class Contest:
    """Controllers on the same draws.

    Args:
        tables: ``[controller]`` of each.
        dataset: Dimensions ``controller`` and ``draw``: ``failed``, ``outcome``, and every metric that all have.
    """

    tables: dict[str, Table]
    dataset: xr.Dataset

    @classmethod
    def of(cls, study: Study, tables: dict[str, Table], progress: Callable[[], None]) -> "Contest":
        """Run every controller."""
        found = []
        for name, table in tables.items():
            found.append(running.run(with_controller(study, name, table)).dataset)
            progress()
        drawn = [name for name in found[0] if all("law" in other.get(name, other["outcome"]).attrs for other in found)]
        shared = [name for name in found[0] if name not in drawn and all(name in other for other in found)]
        axis = xr.DataArray(list(tables), dims="controller", name="controller")
        parts: list[xr.Dataset] = [other[shared] for other in found]
        dataset = xr.concat(parts, dim=axis, join="exact").assign(found[0][drawn])
        dataset["failed"] = (dataset["outcome"] != Outcome.OK).assign_attrs(long_name="the draw failed")
        return cls(tables, dataset)

    @property
    def content(self) -> dict[str, Any]:
        """What the dataset alone does not tell, for JSON."""
        return {"tables": self.tables, "variables": [str(name) for name in self.dataset]}

    @classmethod
    def stored(cls, content: dict[str, Any], dataset: xr.Dataset) -> "Contest":
        """A contest from :attr:`content` and its controllers' part of the dataset."""
        named = dataset.assign_coords(controller=list(content["tables"]))
        return cls(content["tables"], named[content["variables"]])

    @property
    def metrics(self) -> list[str]:
        """Metrics of all controllers: what is no margin, no outcome and no drawn number."""
        skipped = ("slack_", "outcome", "failed")
        variables = [str(name) for name in self.dataset if "law" not in self.dataset[name].attrs]
        return [name for name in variables if not name.startswith(skipped)]

    def pairs(self, confidence: float = CONFIDENCE) -> list[dict[str, Any]]:
        """Every pair a, b: failure probability of a minus that of b, and the median of each metric's difference."""
        found = []
        for a, b in itertools.combinations(self.tables, 2):
            left, right = (self.dataset.sel(controller=name) for name in (a, b))
            failures = compare_failures(left["failed"].values, right["failed"].values, confidence)
            metrics = {}
            for name in self.metrics:
                difference = compare_metrics(left[name].values, right[name].values, confidence=confidence)
                metrics[name] = {"difference": difference.difference, "interval": list(difference.interval)}
            found.append({"a": a, "b": b, **failures._asdict(), "metrics": metrics})
        return found

    def summary(self, confidence: float = CONFIDENCE) -> dict[str, Any]:
        """The controllers one by one, and in pairs."""
        controllers = {}
        for name, table in self.tables.items():
            own = self.dataset.sel(controller=name)
            failures, draws = int(own["failed"].sum()), own.sizes["draw"]
            middle = {metric: upper_quantiles(own[metric].values, [0.5])[0] for metric in self.metrics}
            controllers[name] = {
                "controller": table,
                "failures": failures,
                "probability": failures / draws,
                "interval": clopper_pearson(failures, draws, confidence).tolist(),
                "median": middle,
            }
        return {"controllers": controllers, "pairs": self.pairs(confidence)}


@dataclass
class Comparison:
    """Controllers compared with the gains that correspond, and with gains tuned on equal budgets.

    Args:
        study: The study.
        given: With the gains that stand in the study, or follow from it.
        tuned: With the best gains found within the budget; None: nothing was tuned.
        budget: That budget.
        seconds: What it took.
    """

    study: Study
    given: Contest
    tuned: Contest | None = None
    budget: Tuning | None = None
    seconds: float = field(default=0.0)

    def summary(self, confidence: float = CONFIDENCE) -> dict[str, Any]:
        """The comparison in plain numbers, for JSON; ``tuned`` is like the whole, or None."""
        tuned = None
        if self.tuned is not None and self.budget is not None:
            tuned = {"budget": self.budget.text, **self.tuned.summary(confidence)}
        return {
            "study": self.study.name,
            "draws": self.study.config.draws,
            "confidence": confidence,
            "requirements": [requirement.text for requirement in self.study.requirements],
            "headline": headline_measure(self.study).name,
            **self.given.summary(confidence),
            "tuned": tuned,
            "seconds": self.seconds,
        }

    @property
    def dataset(self) -> xr.Dataset:
        """Every draw of every controller; those with tuned gains are called NAME_tuned."""
        if self.tuned is None:
            return self.given.dataset
        names = [f"{name}_tuned" for name in self.tuned.tables]
        parts = [self.given.dataset, self.tuned.dataset.assign_coords(controller=names)]
        return xr.concat(
            parts, dim="controller", data_vars="minimal", coords="minimal", compat="override", join="outer"
        )

    def save(self, folder: str | Path) -> Path:
        """Write dataset and summary into a folder.

        Raises:
            ConfigError: the folder holds something else.
        """
        names = [str(name) for name in self.dataset["controller"].values]
        codes = (
            "controller",
            list(range(len(names))),
            {"flag_meanings": " ".join(names)},
        )  # Zarr's strings are unstable
        how = {
            "given": self.given.content,
            "tuned": self.tuned.content if self.tuned else None,
            "budget": asdict(self.budget) if self.budget else None,
            "seconds": self.seconds,
        }
        coded = self.dataset.assign_coords(controller=codes)
        return save(Path(folder), "compare", self.study, coded, self.summary(), how)

    @classmethod
    def load(cls, folder: str | Path, trust_code: bool = False) -> "Comparison":
        """Read what :meth:`save`, or the command ``compare``, wrote.

        Args:
            folder: The folder.
            trust_code: Import the models that its study names as ``module:object``.

        Raises:
            ConfigError: it is no comparison, or it is damaged.
        """
        study, dataset, how = read(Path(folder), "compare", trust_code)
        try:
            count = len(how["given"]["tables"])
            given = Contest.stored(how["given"], dataset.isel(controller=slice(count)))
            better = how["tuned"] and Contest.stored(how["tuned"], dataset.isel(controller=slice(count, None)))
            budget = how["budget"] and Tuning(**how["budget"])
            return cls(study, given, better, budget, how["seconds"])
        except (KeyError, TypeError, ValueError) as error:
            raise ConfigError(str(folder), f"compare.json is damaged, or of another version: {error!r}") from error


def with_controller(study: Study, name: str, table: Table) -> Study:
    """The study under another controller.

    Raises:
        ConfigError: it does not fit the study.
    """
    try:
        return study.override({"controller": table, "sweep": {}})
    except ConfigError as error:
        raise ConfigError(f"compare.{name}", str(error)) from None


def require_names(controllers: Sequence[str]) -> list[str]:
    """Require two controllers or more.

    Raises:
        ConfigError: there are fewer, or one is named twice.
    """
    names = list(controllers)
    if len(set(names)) < max(2, len(names)):
        raise ConfigError("controllers", f"needs two different names or more, got {', '.join(names) or 'none'}")
    return names


def compare(
    study: Study,
    controllers: Sequence[str],
    *,
    candidates: int = 0,
    tuning_draws: int = 64,
    progress: ProgressCallback | None = None,
) -> Comparison:
    """Controllers on common draws and common noise.

    Args:
        study: The study; its own sweep is left aside. Gains: see :func:`controller_table`.
        controllers: At least two names.
        candidates: Also tune every controller, each with so many candidates, and let fresh draws decide; 0: do not.
        tuning_draws: Draws on which a candidate is tried.
        progress: Told of the steps done.

    Raises:
        ConfigError: a name is unknown or given twice, or a controller does not fit.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/mu_robustness.toml").override({"draws": 16, "loop.duration": 45.0})
        >>> found = dj.compare(study, ["dssc", "sta"])
        >>> [(pair["a"], pair["b"]) for pair in found.summary()["pairs"]]
        [('dssc', 'sta')]
    """
    began = time.perf_counter()
    names = require_names(controllers)
    require_independent(study, "a comparison")
    tables = {name: controller_table(study, name) for name in names}
    studies = {name: with_controller(study, name, table) for name, table in tables.items()}
    steps = itertools.count(1)
    total = len(names) * (3 if candidates else 1)

    def step() -> None:
        done = next(steps)
        if progress:
            progress(done, total)

    budget = Tuning.of(study, candidates, tuning_draws) if candidates else None
    if budget and len(study.loop.channels) > 1:
        raise ConfigError("candidates", "a plant of several channels is not tuned here; give the gains, and 0")
    given = Contest.of(study, tables, step)
    if budget is None:
        return Comparison(study, given, seconds=time.perf_counter() - began)
    better = {}
    for name, of in studies.items():
        try:
            better[name] = with_gains(
                tables[name], tuned(of, budget, study.config.compare.get(name, {}).get("tune", {}))
            )
        except ConfigError as error:
            raise error.within_path(f"compare.{name}") from None
        step()
    return Comparison(study, given, Contest.of(study, better, step), budget, time.perf_counter() - began)
