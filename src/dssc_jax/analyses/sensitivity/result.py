"""The result of a sensitivity analysis: for every output and factor, a few quantities with their intervals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.sensitivity.outputs import FAILURE
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import Stored
from dssc_jax.results.result import headline_measure
from dssc_jax.study import Study

ENDS = {"": "", "_low": ", lower end of its interval", "_high": ", upper end of its interval"}
"""Suffixes of a quantity and of the ends of its interval in the dataset."""


class SensitivityMeasure(NamedTuple):
    """What a method tells of a factor.

    Args:
        meaning: In a few words.
        legend: Text for tables and figures.
        share: Whether it is a share of the output's variance; otherwise it has the output's unit.
    """

    meaning: str
    legend: str
    share: bool = True


class SensitivityMethod(NamedTuple):
    """How a result was computed, in words.

    Args:
        title: What the quantities are called together.
        quantities: By name.
        ranking: The quantity that says what matters most.
        interval: Name of the intervals.
    """

    title: str
    quantities: dict[str, SensitivityMeasure]
    ranking: str
    interval: str


@dataclass(eq=False)
class Sensitivity(Analysis):
    """Sensitivity of every output of a study to its uncertain numbers.

    The dataset has along ``output`` (every metric, and ``failure``) and ``factor`` (the uncertain numbers, then the
    in-loop noise if there is any) the quantities of the method with the ends of their intervals, such as ``total``,
    ``total_low`` and ``total_high``. They are NaN if an output has none. Along ``output`` it has ``missing``, the
    number of simulations without a value.

    Args:
        method: Name of the method, see :func:`dssc_jax.sensitivity`.
        rows: Number of rows of the design; trajectories for ``morris``.
        simulations: Total number of simulations.
        reasons: The reason for each output without quantities.
        confidence: Confidence of the intervals.
    """

    kind = "sensitivity"
    title = "Sensitivity"
    table = ("output", "factor")

    method: str
    rows: int
    simulations: int
    reasons: dict[str, str]
    confidence: float

    @property
    def words(self) -> SensitivityMethod:
        """The method in words."""
        return WORDS[self.method]

    @property
    def factors(self) -> tuple[str, ...]:
        """Names of the factors."""
        return tuple(map(str, self.dataset["factor"].values))

    @property
    def outputs(self) -> dict[str, dict[str, np.ndarray] | None]:
        """The quantities of each output by name: estimate, lower and upper end, shape (factors, 3); None if none.

        Estimates of indices are not clipped: below 0 means about 0.
        """
        names = map(str, self.dataset["output"].values)
        return {name: None if name in self.reasons else self._quantities(name) for name in names}

    def _quantities(self, name: str) -> dict[str, np.ndarray]:
        own = self.dataset.sel(output=name)
        return {part: np.stack([own[part + end].values for end in ENDS], axis=-1) for part in self.words.quantities}

    @property
    def headline(self) -> str:
        """The answer in one line."""
        name = next((one for one in shown_outputs(self.study) if one not in self.reasons), None)
        if name is None:
            return f"nothing to tell of {FAILURE}; it {self.reasons[FAILURE]}"
        ranking = self.words.ranking
        values = self.dataset[ranking].sel(output=name)
        first = int(np.argmax(values.values))
        meaning = self.words.quantities[ranking].meaning
        return f"{name} depends most on {self.factors[first]}: {meaning} {float(values[first]):.3g}"

    def figure(self) -> Figure:
        """Plot the answer."""
        return plotting.sensitivity(self)

    def content(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        outputs: dict[str, Any] = {}
        for name, parts in self.outputs.items():
            outputs[name] = parts and {
                factor: {
                    key: number
                    for part, values in parts.items()
                    for key, number in ((part, values[i, 0]), (f"{part}_interval", values[i, 1:]))
                }
                for i, factor in enumerate(self.factors)
            }
        return {
            "method": self.method,
            "title": self.words.title,
            "rows": self.rows,
            "simulations": self.simulations,
            "confidence": self.confidence,
            "interval_method": self.words.interval,
            "factors": self.factors,
            "quantities": {name: quantity._asdict() for name, quantity in self.words.quantities.items()},
            "headline": shown_outputs(self.study),
            "reasons": self.reasons,
            "missing": dict(zip(self.outputs, self.dataset["missing"].values.tolist(), strict=True)),
            "outputs": outputs,
        }

    def settings(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        return {name: getattr(self, name) for name in ("method", "rows", "simulations", "reasons", "confidence")}

    @classmethod
    def restored(cls, stored: Stored) -> Self:
        """See :class:`Analysis`."""
        return cls(stored.study, stored.dataset, **stored.settings)


WORDS = {
    "sobol": SensitivityMethod(
        "Sobol indices",
        {
            "first": SensitivityMeasure("first-order index", "first order: alone"),
            "total": SensitivityMeasure("total index", "total: with all interactions"),
        },
        "total",
        "Student's t over Sobol replicates",
    ),
    "shapley": SensitivityMethod(
        "Shapley effects",
        {"effect": SensitivityMeasure("Shapley effect", "Shapley effect: share of the variance")},
        "effect",
        "Student's t over Sobol replicates",
    ),
    "morris": SensitivityMethod(
        "Morris screening",
        {
            "size": SensitivityMeasure("mean size of an elementary effect", "mu*: mean size of an effect", share=False),
            "spread": SensitivityMeasure("spread of the elementary effects", "sigma: their spread", share=False),
        },
        "size",
        "Student's t over trajectories, Clopper-Pearson for failure",
    ),
}


def sensitivity_dataset(
    study: Study,
    method: str,
    factors: Sequence[str],
    outputs: Mapping[str, tuple[np.ndarray, ...] | None],
    missing: Mapping[str, int],
) -> xr.Dataset:
    """Store the quantities of each output in a dataset: see :class:`Sensitivity`."""
    blank = np.full((len(factors), len(ENDS)), np.nan)
    columns = {}
    for place, (part, quantity) in enumerate(WORDS[method].quantities.items()):
        values = np.stack([own[place] if own else blank for own in outputs.values()])
        for end, (suffix, side) in enumerate(ENDS.items()):
            about = {"units": "1" if quantity.share else "the output's", "long_name": quantity.meaning + side}
            columns[part + suffix] = (("output", "factor"), values[..., end], about)
    about = {"units": "1", "long_name": "simulations without a value"}
    columns["missing"] = (("output",), np.array(list(missing.values())), about)
    names: Mapping[str, tuple[Sequence[str], str]] = {
        "output": (list(outputs), "metric, or failure"),
        "factor": (list(factors), "uncertain number, or noise"),
    }
    coords = {name: (name, np.array(values), {"long_name": text}) for name, (values, text) in names.items()}
    return xr.Dataset(columns, coords=coords, attrs={"title": study.name})


def shown_outputs(study: Study) -> list[str]:
    """The main outputs: failure, and the study's headline metric."""
    return list(dict.fromkeys((FAILURE, headline_measure(study).name)))
