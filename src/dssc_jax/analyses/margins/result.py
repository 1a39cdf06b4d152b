"""Statistics of the critical values of a study's draws."""

from dataclasses import dataclass
from typing import Annotated, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.margins.search import CLOCK, Censoring, CriticalDraws, Walk
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.quantities import Quantity, unit_and_meaning
from dssc_jax.design.certification import CertifiedReach, reach
from dssc_jax.results.analysis import Analysis
from dssc_jax.statistics import CONFIDENCE, clopper_pearson
from dssc_jax.statistics.order import binomial_quantile
from dssc_jax.study import Study
from dssc_jax.study.laws import SPREAD

UNNAMED = {
    CLOCK: Quantity("s", "sample time T_s", above=0.0),
    SPREAD: Quantity("1", "spread of all laws about their medians", at_least=0.0),
}
"""Unit and meaning of what can be walked besides the loop's own numbers."""
CONTENT = 0.95  # share of draws that pass up to the lower tolerance limit
PARAMETER_UNIT = "that of the number"


@dataclass(frozen=True)
class Degradation:
    """Failure probability along the walk, with a confidence band that holds for all its values together."""

    band: Annotated[str, Quantity("", "how the band is computed")]
    value: Annotated[np.ndarray, Quantity(PARAMETER_UNIT, "values of the walk's grid")]
    probability: Annotated[np.ndarray, Quantity("1", "failure probability")]
    lower: Annotated[np.ndarray, Quantity("1", "lower end of the band")]
    upper: Annotated[np.ndarray, Quantity("1", "upper end of the band")]


@dataclass(frozen=True)
class MarginAnswer:
    """The answer for margins: the critical values of all draws, and their statistics."""

    parameter: Annotated[str, Quantity("", "the number that is varied")]
    unit: Annotated[str, Quantity("", "unit of the number")]
    draws: Annotated[int, Quantity("1", "number of draws")]
    bounds: Annotated[tuple[float, float], Quantity(PARAMETER_UNIT, "start and end of the walk")]
    log: Annotated[bool, Quantity("", "whether the walk is even in the logarithm")]
    criterion: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    critical: Annotated[np.ndarray, Quantity(PARAMETER_UNIT, "critical value of each draw; None if censored")]
    median: Annotated[float | None, Quantity(PARAMETER_UNIT, "median critical value; None if it lies before the start")]
    lower_tolerance: Annotated[
        float | None, Quantity(PARAMETER_UNIT, "value up to which the share `content` of all draws passes (Wilks)")
    ]
    content: Annotated[float, Quantity("1", "share of draws of the tolerance limit")]
    confidence: Annotated[float, Quantity("1", "confidence of the tolerance limit and of the band")]
    censored: Annotated[float, Quantity("1", "share of draws without a critical value between the bounds")]
    fail_at_start: Annotated[float, Quantity("1", "share of draws that fail at the start")]
    pass_to_end: Annotated[float, Quantity("1", "share of draws that pass at every value of the grid")]
    non_monotone: Annotated[float, Quantity("1", "share of draws that pass again beyond a failure")]
    first_violated: Annotated[dict[str, int], Quantity("1", "draws that violate each requirement first")]
    certified: Annotated[float | None, Quantity(PARAMETER_UNIT, "last value that Theorem 1 certifies for all draws")]
    certificate: Annotated[str, Quantity("", "what Theorem 1 says")]
    proof: Annotated[JsonObject | None, Quantity("", "how far the sampled loop is proved; None if not asked")]
    degradation: Degradation
    seconds: Annotated[float, Quantity("s", "computing time")]
    compile_seconds: Annotated[float, Quantity("s", "compile time within it")]


@dataclass(eq=False)
class Margins(Analysis):
    """How far a number can change before each draw of a study fails: the critical values of the draws.

    The dataset has along ``draw``: ``critical``, ``censoring``, ``non_monotone`` and all drawn numbers, and after a
    simulation ``violated_first`` (:class:`~dssc_jax.analyses.margins.search.FirstViolated`). Along ``value``, the grid
    of the walk, and ``draw`` it has ``slack``, the slack of the worst requirement relative to its bound.

    Args:
        parameter: The number that is varied.
        walk: The walk from the safe end to the other end.
        criterion: The condition for a draw to pass, in words.
        certificate: The range of the walk that Theorem 1 certifies, for all draws at once.
        seconds: Computing time [s].
        compile_seconds: Compile time within it [s].
        proof: How far the sampled loop is proved (:meth:`dssc_jax.ProvedReach.summary`); None if not asked.
    """

    kind = "margin"
    title = "Robustness margins"
    table = ("draw",)

    parameter: str
    walk: Walk
    criterion: tuple[str, ...]
    certificate: CertifiedReach
    seconds: float = 0.0
    compile_seconds: float = 0.0
    proof: JsonObject | None = None

    @classmethod
    def of(
        cls,
        study: Study,
        parameter: str,
        walk: Walk,
        draws: CriticalDraws,
        criterion: tuple[str, ...],
        seconds: float,
        compile_seconds: float = 0.0,
        unit: str = "1",
    ) -> Self:
        """Make the margins of a study from the critical values that a search found, without a proof.

        Args:
            study: The study.
            parameter: The number that is varied.
            walk: The walk that was searched.
            draws: Critical value and uncertain numbers of each draw.
            criterion: The conditions for a draw to pass, in words.
            seconds: Computing time [s].
            compile_seconds: Compile time within it [s].
            unit: Unit of the slack.
        """
        return cls(
            study=study,
            dataset=margins_dataset(study, parameter, walk, draws, unit),
            parameter=parameter,
            walk=walk,
            criterion=criterion,
            certificate=reach(study, parameter, walk.grid),
            seconds=seconds,
            compile_seconds=compile_seconds,
        )

    @property
    def direction(self) -> float:
        """1 for a walk that ascends, -1 for one that descends."""
        return 1.0 if self.walk.end > self.walk.start else -1.0

    @property
    def reached(self) -> np.ndarray:
        """A measure of how far along the walk each draw passes, shape (draws,); larger means farther.

        The measure is the critical value, with its sign changed if the walk descends. A draw that fails at the start
        has -inf, a draw that passes to the end inf.
        """
        critical = self.dataset["critical"].values
        censoring = self.dataset["censoring"].values
        outside = np.where(censoring == Censoring.BEYOND, np.inf, -np.inf)
        return np.where(censoring == Censoring.INSIDE, self.direction * critical, outside)

    def at_rank(self, rank: int) -> float | None:
        """Return the critical value of the draw at a rank: rank 1 is the draw that fails nearest to the walk's start.

        The value is the walk's end if the draw at this rank passes to the end, and None if it fails at the start.
        """
        reach_of_draw = np.sort(self.reached)[rank - 1]
        if np.isposinf(reach_of_draw):
            return self.walk.end
        if np.isneginf(reach_of_draw):
            return None
        return float(self.direction * reach_of_draw)

    @property
    def median(self) -> float | None:
        """The median critical value: the walk's end if the median draw passes to the end, None if it fails at once.

        For an even number of draws, the median is the one of the two middle values that is nearer to the walk's start.
        """
        return self.at_rank((self.dataset.sizes["draw"] + 1) // 2)

    def lower_tolerance(self, content: float = CONTENT, confidence: float = CONFIDENCE) -> float | None:
        """Compute the value up to which a share ``content`` of all draws passes, with the given confidence (Wilks).

        Draws without a critical value within the walk count in the order, too: those that fail at the start come first,
        those that pass to the end last. None means that there are too few draws, or that the limit lies before the
        walk's start. If the limit lies at the walk's end or beyond, the walk's end is returned.

        Args:
            content: Share of all draws that pass.
            confidence: Probability that the value keeps this promise.

        Reference:
            S. S. Wilks, Annals of Mathematical Statistics 12 (1941) 91-96.
        """
        rank = binomial_quantile(1.0 - confidence, self.dataset.sizes["draw"], 1.0 - content)
        return self.at_rank(rank) if rank else None

    def degradation(self, confidence: float = CONFIDENCE) -> xr.Dataset:
        """Failure probability along the walk, with a confidence band for all values of the grid together.

        The interval at each value is exact (Clopper-Pearson), with the confidence 1 - (1 - confidence)/points
        (Bonferroni). The probability need not grow along the walk, since a draw may pass again beyond a value at which
        it fails.

        Returns:
            Dimension ``value``; variables ``probability``, ``lower``, ``upper``.
        """
        slack = self.dataset["slack"]
        failures = (slack < 0.0).sum("draw").values
        draws = slack.sizes["draw"]
        band = clopper_pearson(failures, draws, 1.0 - (1.0 - confidence) / slack.sizes["value"])
        return xr.Dataset(
            {
                "probability": ("value", failures / draws),
                "lower": ("value", band[:, 0]),
                "upper": ("value", band[:, 1]),
            },
            coords={"value": slack["value"]},
            attrs={"confidence": confidence, "band": "simultaneous: Bonferroni over Clopper-Pearson"},
        )

    @property
    def first_violated(self) -> dict[str, int]:
        """For each requirement, the number of draws that violate it at their first failure along the walk.

        The largest number comes first. Draws whose first failure is an early end are counted as ``ended early``. The
        dictionary is empty if the margins do not come from simulations.
        """
        if "violated_first" not in self.dataset:
            return {}
        names = [*(requirement.short_text for requirement in self.study.requirements), "ended early"]
        violated = self.dataset["violated_first"].values
        counts = {}
        for index, name in enumerate(names):
            count = int(np.count_nonzero(violated == index))
            if count:
                counts[name] = count
        return {name: counts[name] for name in sorted(counts, key=counts.__getitem__, reverse=True)}

    @property
    def headline(self) -> str:
        """The median critical value and its lower tolerance limit, in one line."""
        middle = self.value_text(self.median)
        lower = self.value_text(self.lower_tolerance())
        return f"median critical {self.parameter}: {middle}; 95 % of all draws pass up to: {lower}"

    def value_text(self, value: float | None) -> str:
        """Format a value of the walk with its unit, as text; None stands for a value before the start."""
        if value is None:
            return "before the start"
        unit = self.dataset["critical"].attrs["units"]
        return f"{value:.4g}" if unit == "1" else f"{value:.4g} {unit}"

    def figure(self) -> Figure:
        """Plot the critical values and the failure probability along the walk."""
        return plotting.margin(self)

    @property
    def answer(self) -> MarginAnswer:
        """The critical values and their statistics, as ``summary.json`` has them."""
        data = self.dataset
        curve = self.degradation()
        censoring = data["censoring"].values
        return MarginAnswer(
            parameter=self.parameter,
            unit=data["critical"].attrs["units"],
            draws=data.sizes["draw"],
            bounds=(self.walk.start, self.walk.end),
            log=self.walk.log,
            criterion=self.criterion,
            critical=data["critical"].values,
            median=self.median,
            lower_tolerance=self.lower_tolerance(),
            content=CONTENT,
            confidence=CONFIDENCE,
            censored=float(np.mean(censoring != Censoring.INSIDE)),
            fail_at_start=float(np.mean(censoring == Censoring.BEFORE)),
            pass_to_end=float(np.mean(censoring == Censoring.BEYOND)),
            non_monotone=float(data["non_monotone"].mean()),
            first_violated=self.first_violated,
            certified=self.certificate.value,
            certificate=self.certificate.text,
            proof=self.proof,
            degradation=Degradation(
                band=curve.attrs["band"],
                value=curve["value"].values,
                probability=curve["probability"].values,
                lower=curve["lower"].values,
                upper=curve["upper"].values,
            ),
            seconds=self.seconds,
            compile_seconds=self.compile_seconds,
        )


def margins_dataset(study: Study, parameter: str, walk: Walk, draws: CriticalDraws, unit: str) -> xr.Dataset:
    """The dataset of :class:`Margins`: critical values and drawn numbers along ``draw``, slacks also along ``value``.

    Args:
        study: The study.
        parameter: The number that is varied.
        walk: The walk that was searched.
        draws: Critical value and uncertain numbers of each draw.
        unit: Unit of the slack.
    """
    critical = draws.critical
    quantity = study.quantities.get(parameter) or UNNAMED[parameter]
    attributes = unit_and_meaning(quantity.unit, quantity.meaning)
    codes = {"flag_values": [code.value for code in Censoring], "flag_meanings": "before inside beyond"}
    side_attributes = {"long_name": "side of the walk on which the value lies", **codes}
    variables: dict[str, tuple[object, np.ndarray, object]] = {
        "critical": ("draw", critical.value, attributes | {"long_name": f"critical {quantity.meaning}"}),
        "censoring": ("draw", critical.censoring, side_attributes),
        "non_monotone": ("draw", critical.non_monotone, {"long_name": "passes again beyond a failure"}),
    }
    if critical.first_violated is not None:
        meaning = "index of the requirement violated first"
        variables["violated_first"] = ("draw", critical.first_violated, unit_and_meaning("1", meaning))
    for name, values in draws.uncertain_values.items():
        drawn = study.quantities[name]
        variables[name] = ("draw", values, unit_and_meaning(drawn.unit, drawn.meaning))
    variables["slack"] = (("value", "draw"), critical.slack, unit_and_meaning(unit, "signed slack"))
    index = ("draw", np.arange(study.config.draws), {"long_name": "draw index"})
    return xr.Dataset(
        variables,
        coords={"draw": index, "value": (("value",), walk.grid, attributes)},
        attrs={"title": study.name, "parameter": parameter},
    )
