"""Compare controllers on the same draws and noise, singly and in pairs."""

import itertools
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.comparison.rivals import ControllerTable, controller_table, with_own_controllers
from dssc_jax.analyses.comparison.tuning import Tuning, tuned, with_gains
from dssc_jax.analyses.defaults import TUNING_DRAWS
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Outcome, ProgressCallback
from dssc_jax.engine.evaluation import require_independent
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import Stored
from dssc_jax.results.result import headline_measure
from dssc_jax.runs import run as running
from dssc_jax.statistics import CONFIDENCE, clopper_pearson, compare_failures, compare_metrics
from dssc_jax.statistics.order import upper_quantiles
from dssc_jax.study import Study


@dataclass
class Contest:
    """The results of several controllers on the same draws.

    Args:
        tables: The ``[controller]`` table of each controller.
        dataset: Dimensions ``controller`` and ``draw``: ``failed``, ``outcome``, and every metric common to all.
    """

    tables: dict[str, ControllerTable]
    dataset: xr.Dataset

    @classmethod
    def of(cls, study: Study, tables: dict[str, ControllerTable], progress: Callable[[], None]) -> "Contest":
        """Run every controller."""
        parts: list[xr.Dataset] = []
        for name, table in tables.items():
            parts.append(running.run(with_controller(study, name, table)).dataset)
            progress()
        first = parts[0]
        drawn = [name for name in first if all("law" in other.get(name, other["outcome"]).attrs for other in parts)]
        common = [name for name in first if name not in drawn and all(name in other for other in parts)]
        axis = named_axis(list(tables))
        dataset = xr.concat([other[common] for other in parts], dim=axis, join="exact").assign(first[drawn])
        failed = dataset["outcome"] != Outcome.OK
        dataset["failed"] = (failed.dims, failed.values, {"long_name": "the draw failed"})
        return cls(tables, dataset)

    def settings(self) -> dict[str, Any]:
        """What :meth:`stored` needs besides the dataset, for JSON."""
        return {"tables": self.tables, "variables": [str(name) for name in self.dataset]}

    @classmethod
    def stored(cls, settings: dict[str, Any], dataset: xr.Dataset) -> "Contest":
        """Restore a contest from :meth:`settings` and the controllers' part of the dataset."""
        tables = settings["tables"]
        return cls(tables, dataset.assign_coords(controller=named_axis(list(tables)))[settings["variables"]])

    def metrics(self, study: Study) -> list[str]:
        """The study's metrics that all controllers have."""
        return [measure.name for measure in study.measures if measure.name in self.dataset]

    def pairs(self, study: Study, confidence: float = CONFIDENCE) -> list[dict[str, Any]]:
        """For every pair a, b: failure probability of a minus that of b, and the median of each metric's difference."""
        pairs = []
        for a, b in itertools.combinations(self.tables, 2):
            left, right = (self.dataset.sel(controller=name) for name in (a, b))
            failures = compare_failures(left["failed"].values, right["failed"].values, confidence)
            metrics = {}
            for name in self.metrics(study):
                difference = compare_metrics(left[name].values, right[name].values, confidence=confidence)
                metrics[name] = {"difference": difference.difference, "interval": list(difference.interval)}
            pairs.append({"a": a, "b": b, **failures._asdict(), "metrics": metrics})
        return pairs

    def content(self, study: Study, confidence: float = CONFIDENCE) -> dict[str, Any]:
        """Summarise each controller and each pair."""
        controllers = {}
        for name, table in self.tables.items():
            own = self.dataset.sel(controller=name)
            failures, draws = int(own["failed"].sum()), own.sizes["draw"]
            controllers[name] = {
                "controller": table,
                "failures": failures,
                "probability": failures / draws,
                "interval": clopper_pearson(failures, draws, confidence),
                "median": {one: upper_quantiles(own[one].values, [0.5])[0] for one in self.metrics(study)},
            }
        return {"controllers": controllers, "pairs": self.pairs(study, confidence)}


def named_axis(names: list[str]) -> xr.DataArray:
    """The coordinate of the controllers' names."""
    return xr.DataArray(np.array(names), dims="controller", name="controller", attrs={"long_name": "controller"})


@dataclass(eq=False)
class Comparison(Analysis):
    """A comparison of controllers with corresponding gains, and with gains tuned on equal budgets.

    The dataset has every draw of every controller. Controllers with tuned gains are called NAME_tuned.

    Args:
        given: Results with the gains that the study gives, or that follow from it.
        tuned: Results with the best gains found within the budget; None if nothing was tuned.
        budget: That budget.
        seconds: Computing time.
    """

    kind = "compare"
    title = "Controllers compared"
    table = ("controller", "draw")

    given: Contest
    tuned: Contest | None = None
    budget: Tuning | None = None
    seconds: float = 0.0

    @classmethod
    def of(
        cls,
        study: Study,
        given: Contest,
        tuned: Contest | None = None,
        budget: Tuning | None = None,
        seconds: float = 0.0,
    ) -> Self:
        """Combine one or both contests."""
        if tuned is None:
            return cls(study, given.dataset, given, seconds=seconds)
        names = named_axis([f"{name}_tuned" for name in tuned.tables])
        dataset = xr.concat(
            [given.dataset, tuned.dataset.assign_coords(controller=names)],
            dim="controller", data_vars="minimal", coords="minimal", compat="override", join="outer",
        )  # fmt: skip
        return cls(study, dataset, given, tuned, budget, seconds)

    @property
    def headline(self) -> str:
        """The answer in one line."""
        failures = self.given.dataset["failed"].sum("draw")
        counts = (f"{name} {int(failures.sel(controller=name))}" for name in self.given.tables)
        return f"failures in {self.given.dataset.sizes['draw']:,} draws: {', '.join(counts)}"

    def figure(self) -> Figure:
        """Plot the answer."""
        return plotting.comparison(self)

    def content(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        tuned = None
        if self.tuned is not None and self.budget is not None:
            tuned = {"budget": self.budget.text, **self.tuned.content(self.study)}
        return {
            "draws": self.study.config.draws,
            "confidence": CONFIDENCE,
            "requirements": [requirement.text for requirement in self.study.requirements],
            "headline": headline_measure(self.study).name,
            **self.given.content(self.study),
            "tuned": tuned,
            "seconds": self.seconds,
        }

    def settings(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        return {
            "given": self.given.settings(),
            "tuned": self.tuned.settings() if self.tuned else None,
            "budget": asdict(self.budget) if self.budget else None,
            "seconds": self.seconds,
        }

    @classmethod
    def restored(cls, stored: Stored) -> Self:
        """See :class:`Analysis`."""
        study, dataset, settings = stored
        count = len(settings["given"]["tables"])
        given = Contest.stored(settings["given"], dataset.isel(controller=slice(count)))
        rest = dataset.isel(controller=slice(count, None))
        tuned = Contest.stored(settings["tuned"], rest) if settings["tuned"] else None
        budget = Tuning(**settings["budget"]) if settings["budget"] else None
        return cls.of(study, given, tuned, budget, settings["seconds"])


def with_controller(study: Study, name: str, table: ControllerTable) -> Study:
    """The study with another controller.

    Raises:
        ConfigError: the controller does not fit the study.
    """
    try:
        return study.override({"controller": table, "sweep": {}})
    except ConfigError as error:
        raise ConfigError(f"compare.{name}", str(error)) from None


def require_names(controllers: Sequence[str]) -> list[str]:
    """Require at least two different controllers.

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
    tuning_draws: int = TUNING_DRAWS,
    progress: ProgressCallback | None = None,
) -> Comparison:
    """Compare controllers on common draws and common noise.

    Args:
        study: The study; its own sweep is ignored. Gains: see :func:`controller_table`.
        controllers: At least two names.
        candidates: Number of candidate gains to try for each controller; fresh draws decide. 0: no tuning.
        tuning_draws: Draws on which each candidate is tried.
        progress: Called with the steps done.

    Raises:
        ConfigError: a name is unknown or given twice, or a controller does not fit.

    Example:
        >>> import dssc_jax as dj
        >>> study = dj.Study.load("studies/mu_robustness.toml").override({"draws": 16, "loop.duration": 45.0})
        >>> comparison = dj.compare(study, ["dssc", "sta"])
        >>> [(pair["a"], pair["b"]) for pair in comparison.summary()["pairs"]]
        [('dssc', 'sta')]
    """
    began = time.perf_counter()
    names = require_names(controllers)
    require_independent(study, "a comparison")
    study = with_own_controllers(study.without_sweep(), names)
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
        return Comparison.of(study, given, seconds=time.perf_counter() - began)
    better = {}
    for name, of in studies.items():
        try:
            better[name] = with_gains(
                tables[name], tuned(of, budget, study.config.compare.get(name, {}).get("tune", {}))
            )
        except ConfigError as error:
            raise error.within_path(f"compare.{name}") from None
        step()
    return Comparison.of(study, given, Contest.of(study, better, step), budget, time.perf_counter() - began)
