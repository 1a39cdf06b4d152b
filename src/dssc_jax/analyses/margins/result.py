"""What the critical values of a study's draws say together."""

from collections.abc import Mapping
from dataclasses import InitVar, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from dssc_jax.analyses.margins.search import CLOCK, Censoring, Critical, Walk
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.design.certification import Reach, reach
from dssc_jax.results.analysis_folder import read, save
from dssc_jax.statistics import CONFIDENCE, clopper_pearson
from dssc_jax.statistics.order import binomial_quantile
from dssc_jax.study import Described, Study
from dssc_jax.study.laws import SPREAD

UNNAMED = {
    CLOCK: Quantity("s", "sample time T_s", above=0.0),
    SPREAD: Quantity("1", "spread of all laws about their medians", at_least=0.0),
}
"""What can be walked beside the loop's own numbers."""
CONTENT = 0.95  # share of draws that the lower tolerance limit speaks of


@dataclass
class Margins:
    """The critical values of a study's draws.

    Args:
        study: The study.
        parameter: The number that was walked.
        walk: The way it went.
        dataset: Along ``draw``: ``critical``, ``censoring``, ``non_monotone`` and every drawn number; along ``value``
            and ``draw``: ``margin``, that of the worst requirement relative to its bound.
        criterion: What a draw must keep in order to pass, in words.
        times: Seconds in all, and compiling.
        certificate: How far Theorem 1 certifies the loop on the same walk, for all draws at once.
        stored: The certificate of a study whose code is not loaded; else it follows from the study.
    """

    study: Study
    parameter: str
    walk: Walk
    dataset: xr.Dataset
    criterion: tuple[str, ...]
    times: dict[str, float] = field(default_factory=dict)
    certificate: Reach = field(init=False)
    stored: InitVar[Reach | None] = None

    def __post_init__(self, stored: Reach | None) -> None:
        self.certificate = stored or reach(self.study, self.parameter, self.walk.grid)

    @classmethod
    def of(
        cls,
        study: Study,
        parameter: str,
        walk: Walk,
        found: Critical,
        drawn: Mapping[str, np.ndarray],
        times: Mapping[str, float],
        criterion: tuple[str, ...],
    ) -> "Margins":
        """The margins that a search found, with the drawn numbers beside them."""
        quantity = study.quantities.get(parameter) or UNNAMED[parameter]
        about = {"units": quantity.unit, "long_name": quantity.meaning}
        codes = {"flag_values": [code.value for code in Censoring], "flag_meanings": "before found beyond"}
        columns = {
            "critical": (found.value, {**about, "long_name": f"critical {quantity.meaning}"}),
            "censoring": (found.censoring, codes),
            "non_monotone": (found.non_monotone, {"long_name": "passes again beyond a failure"}),
        }
        for name, values in drawn.items():
            law = study.quantities[name]
            columns[name] = (values, {"units": law.unit, "long_name": law.meaning})
        data = xr.Dataset(
            {name: (("draw",), values, attributes) for name, (values, attributes) in columns.items()},
            coords={"draw": np.arange(study.config.draws), "value": (("value",), walk.grid, about)},
            attrs={"title": study.name, "parameter": parameter},
        )
        data["margin"] = (("value", "draw"), found.margin, {"units": "1", "long_name": "signed margin"})
        return cls(study, parameter, walk, data, criterion, dict(times))

    @property
    def reached(self) -> np.ndarray:
        """How far each draw goes, as a number that grows on the way; infinite where it is censored. Shape (n,)."""
        critical, censoring = self.dataset["critical"].values, self.dataset["censoring"].values
        direction = 1.0 if self.walk.end > self.walk.start else -1.0
        outside = np.where(censoring == Censoring.BEYOND, np.inf, -np.inf)
        return np.where(censoring == Censoring.FOUND, direction * critical, outside)

    def at_rank(self, rank: int) -> float | None:
        """The rank-th critical value from the safe end; the walk's end where it lies beyond, None before its start."""
        found = np.sort(self.reached)[rank - 1]
        if np.isposinf(found):
            return self.walk.end
        return None if np.isneginf(found) else float(found if self.walk.end > self.walk.start else -found)

    def lower_tolerance(self, content: float = CONTENT, confidence: float = CONFIDENCE) -> float | None:
        """The value up to which a share ``content`` of all draws passes, with confidence (Wilks).

        Censored draws keep their places in the order. None: there are too few draws for it, or it lies before the
        walk's start; the walk's end: that far at least.

        Reference:
            S. S. Wilks, Annals of Mathematical Statistics 12 (1941) 91-96.
        """
        rank = binomial_quantile(1.0 - confidence, self.dataset.sizes["draw"], 1.0 - content)
        return self.at_rank(rank) if rank else None

    def degradation(self, confidence: float = CONFIDENCE) -> xr.Dataset:
        """Failure probability along the walk, with a band that holds at all values of the grid together.

        Exact (Clopper-Pearson) intervals, each at 1 - (1 - confidence)/points (Bonferroni): no draw need be monotone.

        Returns:
            Dimension ``value``; variables ``probability``, ``lower``, ``upper``.
        """
        margin = self.dataset["margin"]
        failures, draws = (margin < 0.0).sum("draw").values, margin.sizes["draw"]
        band = clopper_pearson(failures, draws, 1.0 - (1.0 - confidence) / margin.sizes["value"])
        columns = {"probability": failures / draws, "lower": band[:, 0], "upper": band[:, 1]}
        return xr.Dataset(
            {name: (("value",), column) for name, column in columns.items()},
            coords={"value": margin["value"]},
            attrs={"confidence": confidence, "band": "simultaneous: Bonferroni over Clopper-Pearson"},
        )

    def summary(self) -> dict[str, Any]:
        """The margins in plain numbers, for JSON."""
        data, draws = self.dataset, self.dataset.sizes["draw"]
        censoring, curve = data["censoring"].values, self.degradation()
        return {
            "study": self.study.name,
            "parameter": self.parameter,
            "unit": data["critical"].attrs["units"],
            "draws": draws,
            "bounds": [self.walk.start, self.walk.end],
            "criterion": list(self.criterion),
            "critical": [None if np.isnan(value) else float(value) for value in data["critical"].values],
            "median": self.at_rank((draws + 1) // 2),
            "lower_tolerance": self.lower_tolerance(),
            "content": CONTENT,
            "confidence": CONFIDENCE,
            "censored": float(np.mean(censoring != Censoring.FOUND)),
            "fail_at_start": float(np.mean(censoring == Censoring.BEFORE)),
            "pass_to_end": float(np.mean(censoring == Censoring.BEYOND)),
            "non_monotone": float(data["non_monotone"].mean()),
            "certified": self.certificate.value,
            "certificate": self.certificate.text,
            "degradation": {
                "band": curve.attrs["band"],
                **{name: curve[name].values.tolist() for name in ("value", "probability", "lower", "upper")},
            },
            **self.times,
        }

    def save(self, folder: str | Path) -> Path:
        """Write dataset and summary into a folder.

        Raises:
            ConfigError: the folder holds something else.
        """
        walk = {name: getattr(self.walk, name) for name in ("start", "end", "log", "points", "parted")}
        how = {"parameter": self.parameter, "walk": walk, "criterion": list(self.criterion), "times": self.times}
        how["certificate"] = self.certificate._asdict()
        return save(Path(folder), "margin", self.study, self.dataset, self.summary(), how)

    @classmethod
    def load(cls, folder: str | Path, trust_code: bool = False) -> "Margins":
        """Read what :meth:`save`, or the command ``margin``, wrote.

        Args:
            folder: The folder.
            trust_code: Import the models that its study names as ``module:object``.

        Raises:
            ConfigError: it is no margin analysis, or it is damaged.
        """
        study, dataset, how = read(Path(folder), "margin", trust_code)
        try:
            stored = Reach(**how["certificate"]) if isinstance(study, Described) else None
            walk, criterion = Walk(**how["walk"]), tuple(how["criterion"])
            return cls(study, how["parameter"], walk, dataset, criterion, how["times"], stored)
        except (KeyError, TypeError) as error:
            raise ConfigError(str(folder), f"margin.json is damaged, or of another version: {error!r}") from error
