"""The result of a sensitivity analysis: for every output and factor, a few quantities with their intervals."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.sensitivity.outputs import FAILURE
from dssc_jax.core.quantities import Quantity, unit_and_meaning
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import headline_measure
from dssc_jax.study import Study

ENDS = {"": "", "_low": ", lower end of its interval", "_high": ", upper end of its interval"}
"""Suffixes of a quantity and of the ends of its interval in the dataset, and what each adds to its meaning."""
OUTPUT_UNIT = "that of the output"


@dataclass(frozen=True)
class SobolFactor:
    """Sobol indices of a factor: the shares of an output's variance that it explains alone, and with all interactions.

    Estimates are not clipped, so an index of about 0 may be negative.
    """

    first: Annotated[float, Quantity("1", "first-order index")]
    first_interval: Annotated[tuple[float, float], Quantity("1", "interval of the first-order index")]
    total: Annotated[float, Quantity("1", "total index")]
    total_interval: Annotated[tuple[float, float], Quantity("1", "interval of the total index")]


@dataclass(frozen=True)
class ShapleyFactor:
    """Shapley effect of a factor: the share of an output's variance that knowing the factor explains.

    The share is averaged over all orders in which the factors may become known.
    """

    effect: Annotated[float, Quantity("1", "Shapley effect: share of the variance")]
    effect_interval: Annotated[tuple[float, float], Quantity("1", "interval of the Shapley effect")]


@dataclass(frozen=True)
class MorrisFactor:
    """Size and spread of a factor's elementary effects: the changes of an output when the factor alone moves."""

    size: Annotated[float, Quantity(OUTPUT_UNIT, "mu*: mean size of an elementary effect")]
    size_interval: Annotated[tuple[float, float], Quantity(OUTPUT_UNIT, "its interval")]
    spread: Annotated[float, Quantity(OUTPUT_UNIT, "sigma: spread of the elementary effects")]
    spread_interval: Annotated[tuple[float, float], Quantity(OUTPUT_UNIT, "its interval")]


Factor: TypeAlias = SobolFactor | ShapleyFactor | MorrisFactor


@dataclass(frozen=True)
class SensitivityMeasure:
    """Description in words of a quantity that a method computes for each factor."""

    meaning: Annotated[str, Quantity("", "in a few words")]
    legend: Annotated[str, Quantity("", "text for tables and figures")]
    share: Annotated[bool, Quantity("", "whether it is a share of the variance")] = True


class SensitivityMethod(NamedTuple):
    """Description of a method of sensitivity analysis, in words for tables, figures and answers.

    Args:
        title: What the quantities of the method are called together.
        quantities: The quantities that the method computes for each factor, by name.
        factor: Type of the answer for a factor; it is called with estimate and interval of each quantity in turn.
        ranking: Name of the quantity by which factors are ranked.
        interval: How the intervals are computed.
    """

    title: str
    quantities: dict[str, SensitivityMeasure]
    factor: Callable[..., Factor]
    ranking: str
    interval: str


@dataclass(frozen=True)
class SensitivityAnswer:
    """The answer of a sensitivity analysis: how much every output depends on each uncertain number."""

    method: Annotated[str, Quantity("", "name of the method")]
    title: Annotated[str, Quantity("", "what its quantities are called together")]
    rows: Annotated[int, Quantity("1", "number of rows of the design; of trajectories with Morris screening")]
    simulations: Annotated[int, Quantity("1", "number of simulations")]
    confidence: Annotated[float, Quantity("1", "confidence of each interval")]
    interval_method: Annotated[str, Quantity("", "method of the intervals")]
    factors: Annotated[tuple[str, ...], Quantity("", "the uncertain numbers, then the in-loop noise if there is any")]
    quantities: dict[str, SensitivityMeasure]
    headline: Annotated[list[str], Quantity("", "the outputs that are shown")]
    reasons: Annotated[dict[str, str], Quantity("", "why an output has no quantities")]
    missing: Annotated[dict[str, int], Quantity("1", "simulations without a value of each output")]
    outputs: Annotated[dict[str, dict[str, Factor] | None], Quantity("", "by output and factor; None: no quantities")]


@dataclass(eq=False)
class Sensitivity(Analysis):
    """Sensitivity of every output of a study to its uncertain numbers.

    The dimension ``output`` of the dataset holds every metric and ``failure``. The dimension ``factor`` holds the
    uncertain numbers, then the in-loop noise if there is any. Along both, the dataset has the quantities of the method
    with the ends of their intervals, such as ``total``, ``total_low`` and ``total_high``. For an output without
    quantities these are NaN. Along ``output`` the dataset has ``missing``, the number of simulations without a value.

    Args:
        method: Name of the method, see :func:`dssc_jax.sensitivity`.
        rows: Number of rows of the design; for ``morris`` number of trajectories.
        simulations: Total number of simulations.
        reasons: Why an output has no quantities, by the name of the output.
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
    def description(self) -> SensitivityMethod:
        """What the method computes, in words."""
        return DESCRIPTIONS[self.method]

    @property
    def factors(self) -> tuple[str, ...]:
        """Names of the factors: the uncertain numbers, then the in-loop noise if there is any."""
        return tuple(map(str, self.dataset["factor"].values))

    @property
    def outputs(self) -> dict[str, dict[str, np.ndarray] | None]:
        """The quantities of each output by name, with estimate, lower and upper end, shape (factors, 3) each.

        An output without quantities has None. Estimates of indices are not clipped, so they may be slightly negative.
        """
        outputs = {}
        for name in map(str, self.dataset["output"].values):
            outputs[name] = None if name in self.reasons else self._quantities(name)
        return outputs

    def _quantities(self, output: str) -> dict[str, np.ndarray]:
        """The quantities of an output by name, with estimate, lower and upper end, shape (factors, 3) each."""
        data = self.dataset.sel(output=output)
        quantities = {}
        for name in self.description.quantities:
            quantities[name] = np.stack([data[name + end].values for end in ENDS], axis=-1)
        return quantities

    @property
    def headline(self) -> str:
        """The factor on which the main output depends most, in one line; or why there are no quantities."""
        answered_outputs = [name for name in shown_outputs(self.study, self.reasons) if name not in self.reasons]
        if not answered_outputs:
            return f"nothing to tell of {FAILURE}; it {self.reasons[FAILURE]}"
        output = answered_outputs[0]
        ranking = self.description.ranking
        values = self.dataset[ranking].sel(output=output).values
        top = int(np.argmax(values))
        meaning = self.description.quantities[ranking].meaning
        return f"{output} depends most on {self.factors[top]}: {meaning} {float(values[top]):.3g}"

    def figure(self) -> Figure:
        """Plot what failure and the headline metric depend on, with intervals."""
        return plotting.sensitivity(self)

    @property
    def answer(self) -> SensitivityAnswer:
        """The quantities of every output and factor, as ``summary.json`` has them."""
        outputs = {}
        for name, quantities in self.outputs.items():
            outputs[name] = None if quantities is None else self._factor_answers(quantities)
        return SensitivityAnswer(
            method=self.method,
            title=self.description.title,
            rows=self.rows,
            simulations=self.simulations,
            confidence=self.confidence,
            interval_method=self.description.interval,
            factors=self.factors,
            quantities=self.description.quantities,
            headline=shown_outputs(self.study, self.reasons),
            reasons=self.reasons,
            missing=dict(zip(outputs, self.dataset["missing"].values.tolist(), strict=True)),
            outputs=outputs,
        )

    def _factor_answers(self, quantities: Mapping[str, np.ndarray]) -> dict[str, Factor]:
        """The answer for each factor by name, from the quantities of an output, shape (factors, 3) each."""
        answers = {}
        for row, factor in enumerate(self.factors):
            arguments = []
            for table in quantities.values():
                estimate, low, high = table[row].tolist()
                arguments += [estimate, (low, high)]
            answers[factor] = self.description.factor(*arguments)
        return answers


DESCRIPTIONS = {
    "sobol": SensitivityMethod(
        "Sobol indices",
        {
            "first": SensitivityMeasure("first-order index", "first order: alone"),
            "total": SensitivityMeasure("total index", "total: with all interactions"),
        },
        SobolFactor,
        "total",
        "Student's t over Sobol replicates",
    ),
    "shapley": SensitivityMethod(
        "Shapley effects",
        {"effect": SensitivityMeasure("Shapley effect", "Shapley effect: share of the variance")},
        ShapleyFactor,
        "effect",
        "Student's t over Sobol replicates",
    ),
    "morris": SensitivityMethod(
        "Morris screening",
        {
            "size": SensitivityMeasure("mean size of an elementary effect", "mu*: mean size of an effect", share=False),
            "spread": SensitivityMeasure("spread of the elementary effects", "sigma: their spread", share=False),
        },
        MorrisFactor,
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
    """The dataset of :class:`Sensitivity`: every quantity and the ends of its interval, by output and factor.

    Args:
        study: The study.
        method: Name of the method.
        factors: Names of the factors.
        outputs: The quantities of each output in the method's order, shape (factors, 3) each; None: no quantities.
        missing: Number of simulations without a value, by output.
    """
    blank = np.full((len(factors), len(ENDS)), np.nan)
    columns = {}
    for place, (name, measure) in enumerate(DESCRIPTIONS[method].quantities.items()):
        tables = [blank if quantities is None else quantities[place] for quantities in outputs.values()]
        values = np.stack(tables)
        unit = "1" if measure.share else "the output's"
        for column, (suffix, end) in enumerate(ENDS.items()):
            attributes = unit_and_meaning(unit, measure.meaning + end)
            columns[name + suffix] = (("output", "factor"), values[..., column], attributes)
    counts = np.array(list(missing.values()))
    columns["missing"] = (("output",), counts, unit_and_meaning("1", "simulations without a value"))
    coords = {
        "output": ("output", np.array(list(outputs)), {"long_name": "metric, or failure"}),
        "factor": ("factor", np.array(list(factors)), {"long_name": "uncertain number, or noise"}),
    }
    return xr.Dataset(columns, coords=coords, attrs={"title": study.name})


def shown_outputs(study: Study, refused: Collection[str]) -> list[str]:
    """The main outputs that are shown: failure and one metric.

    The metric is the study's headline metric, or if that has no quantities, the first required metric with quantities.

    Args:
        study: The study.
        refused: Names of the outputs without quantities.
    """
    headline = headline_measure(study).name
    metrics = [headline, *(requirement.measure.name for requirement in study.requirements)]
    answered = [name for name in metrics if name not in refused]
    main_metric = answered[0] if answered else headline
    return list(dict.fromkeys([FAILURE, main_metric]))  # each name once
