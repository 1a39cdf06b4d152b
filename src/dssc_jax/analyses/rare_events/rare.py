"""A failure probability that is too small for plain draws, by importance sampling or by splitting."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Annotated, Self, TypeAlias

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy import special

import dssc_jax.plotting as plotting
from dssc_jax.analyses.rare_events.design_points import DesignPoint
from dssc_jax.analyses.rare_events.estimate import Estimate, Plain
from dssc_jax.analyses.rare_events.importance import ImportanceSampling, WeightedEstimate, importance_sampling
from dssc_jax.analyses.rare_events.splitting import USUAL, Splitting, SplittingEstimate, split
from dssc_jax.closed_loop.requirements import worst_slack
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import Engine, evaluate, is_noisy
from dssc_jax.engine.sampling import Arrays, inside_cube, values_at
from dssc_jax.results.analysis import Analysis
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.study import Study, takes_file

QUANTILE_LEVELS = (0.05, 0.5, 0.95)
LANES = 2048  # lanes of a batch

Method: TypeAlias = ImportanceSampling | Splitting
"""The settings of a method."""

USUAL_IMPORTANCE = ImportanceSampling()


@dataclass(frozen=True)
class MethodProbability:
    """The failure probability from the method alone, without regard to the plain draws."""

    probability: Annotated[float, Quantity("1", "failure probability")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability")]


@dataclass(frozen=True)
class ApproximatedFailures:
    """The failures around one design point, and two approximations of their probability, without interval."""

    distance: Annotated[float, Quantity("1", "distance from the median draw in standard normal space")]
    first_order: Annotated[float, Quantity("1", "probability behind the tangent of the border (FORM)")]
    second_order: Annotated[float, Quantity("1", "probability behind its paraboloid (SORM); None: there is none")]
    values: Annotated[dict[str, float], Quantity("that of the number", "values of the uncertain numbers there")]


@dataclass(frozen=True)
class PlainFailures:
    """The failures of the plain draws."""

    draws: Annotated[int, Quantity("1", "number of plain draws")]
    failures: Annotated[int, Quantity("1", "plain draws that failed")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability (Clopper-Pearson)")]
    contradicts: Annotated[bool, Quantity("", "whether this interval and that of the method are disjoint")]


@dataclass(frozen=True)
class FailingRange:
    """Range of a number at failures."""

    median: Annotated[float, Quantity("that of the number", "median of its law")]
    failing: Annotated[np.ndarray | None, Quantity("that of the number", "5 %, 50 % and 95 % quantile at failures")]


@dataclass(frozen=True)
class RareAnswer:
    """A rare failure's probability, its cost, and where the failures are."""

    requirements: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    probability: Annotated[float, Quantity("1", "failure probability")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability")]
    interval_method: Annotated[str, Quantity("", "method of the interval")]
    confidence: Annotated[float, Quantity("1", "confidence of each interval")]
    method: Annotated[str, Quantity("", "importance sampling, or splitting")]
    refusal: Annotated[str | None, Quantity("", "why there is no importance sampling, if there is none")]
    by_method: MethodProbability
    plain: PlainFailures
    variation: Annotated[float, Quantity("1", "coefficient of variation; None: no failure reached")]
    simulations: Annotated[int, Quantity("1", "number of simulations besides the plain draws")]
    plain_draws: Annotated[float, Quantity("1", "plain draws that would give this variation; None: infinitely many")]
    design_points: tuple[ApproximatedFailures, ...]
    estimates: Annotated[np.ndarray, Quantity("1", "failure probability from each repeat of the splitting")]
    levels: Annotated[np.ndarray, Quantity("1", "levels that each repeat passed")]
    in_loop_noise: Annotated[bool, Quantity("", "whether the loop has in-loop noise")]
    where: dict[str, FailingRange]
    settings: Annotated[dict[str, float], Quantity("", "settings of the method, by name")]


@dataclass(eq=False)
class RareEvent(Analysis):
    """The probability of a study's rare failure.

    Along ``failure``, the dataset has the failing points of the method and then the plain draws that failed: every
    uncertain number; ``plain``, which of the two it is; ``weight``, a point's weight; and ``noise``, its index of the
    in-loop noise. Along ``failure`` and ``number`` it has their ``point`` in standard normal space. Of a splitting it
    has along ``repeat``: ``estimate`` and ``levels``. Of importance sampling it has along ``design_point`` its
    ``distance`` and ``second_order`` (SORM's factor), and along ``number``, too, the ``design``.

    Args:
        method: The settings of the method.
        simulations: Number of evaluations of the slack besides those of the plain draws.
        largest: The largest weight that a failing point could be expected to have; 0 for a splitting.
        noisy: Whether the loop has in-loop noise.
        refusal: Why importance sampling gave no answer; empty if it did, or was not tried.
    """

    kind = "rare"
    title = "A rare failure"
    table = ("failure",)

    method: Method
    simulations: int
    largest: float
    noisy: bool
    refusal: str

    @classmethod
    def of(cls, study: Study, settings: Method, estimate: Estimate, noisy: bool, refusal: str = "") -> Self:
        """Create the analysis from an estimate."""
        plain = estimate.plain
        points = np.concatenate([estimate.points, plain.points])
        columns = {
            "plain": (
                "failure",
                np.arange(len(points)) >= len(estimate.points),
                {"long_name": "a plain draw, not a point of the method"},
            ),
            "noise": (
                "failure",
                np.concatenate([estimate.noise, np.full(plain.failures, -1)]),
                {"units": "1", "long_name": "index of the in-loop noise; -1: of a plain draw"},
            ),
            "weight": (
                "failure",
                np.concatenate([estimate.weights, np.ones(plain.failures)]),
                {"units": "1", "long_name": "weight of the failure"},
            ),
            "point": (("failure", "number"), points, {"units": "1", "long_name": "standard normal coordinate"}),
        }
        largest = 0.0
        if isinstance(estimate, SplittingEstimate):
            columns["estimate"] = ("repeat", estimate.estimates, {"units": "1", "long_name": "failure probability"})
            columns["levels"] = ("repeat", estimate.levels, {"units": "1", "long_name": "levels passed"})
        if isinstance(estimate, WeightedEstimate):
            largest = estimate.largest
            columns |= columns_of(estimate.design_points)
        for name, values in values_at(study, inside_cube(special.ndtr(points))).items():
            quantity = study.quantities[name]
            columns[name] = ("failure", values, {"units": quantity.unit, "long_name": quantity.meaning})
        number = ("number", np.array(list(study.laws)), {"long_name": "uncertain number"})
        dataset = xr.Dataset(columns, coords={"number": number}, attrs={"title": study.name})
        return cls(
            study=study,
            dataset=dataset,
            method=settings,
            simulations=estimate.simulations,
            largest=largest,
            noisy=noisy,
            refusal=refusal,
        )

    @cached_property
    def estimate(self) -> Estimate:
        """The probability and how it was estimated."""
        data = self.dataset
        plain = data["plain"].values
        points = data["point"].values
        noise = data["noise"].values[~plain]
        weights = data["weight"].values[~plain]
        draws = Plain(self.method.plain, points[plain])
        if isinstance(self.method, Splitting):
            estimates = data["estimate"].values
            levels = data["levels"].values
            return SplittingEstimate(
                simulations=self.simulations,
                points=points[~plain],
                noise=noise,
                weights=weights,
                plain=draws,
                estimates=estimates,
                levels=levels,
            )
        design_points = design_points_of(data)
        return WeightedEstimate(
            simulations=self.simulations,
            points=points[~plain],
            noise=noise,
            weights=weights,
            plain=draws,
            largest=self.largest,
            design_points=design_points,
        )

    @property
    def failing(self) -> xr.Dataset:
        """The failures: those of the plain draws if they answer, else the method's."""
        return self.dataset.isel(failure=self.dataset["plain"].values != self.estimate.answered)

    @property
    def failing_values(self) -> Arrays:
        """Values of each uncertain number at :attr:`failing`."""
        failing = self.failing
        return {name: failing[name].values for name in self.study.laws}

    @property
    def headline(self) -> str:
        """The answer in one line."""
        low, high = self.estimate.interval()
        return (
            f"failure probability {self.estimate.probability:.3g} in [{low:.3g}, {high:.3g}] ({self.estimate.method})"
        )

    def figure(self) -> Figure:
        """Plot the answer."""
        return plotting.rare(self)

    def approximated(self, design_point: DesignPoint) -> ApproximatedFailures:
        """The failures around a design point."""
        values = values_at(self.study, inside_cube(special.ndtr(design_point.point[None])))
        return ApproximatedFailures(
            design_point.distance,
            design_point.first_order_probability,
            design_point.second_order_probability,
            {name: float(column[0]) for name, column in values.items()},
        )

    @property
    def answer(self) -> RareAnswer:
        """The numbers that summary.json holds."""
        estimate = self.estimate
        plain = estimate.plain
        splits = isinstance(estimate, SplittingEstimate)
        weights = self.failing["weight"].values
        ranges = {}
        for name, values in self.failing_values.items():
            quantiles = weighted_quantiles(values, weights, QUANTILE_LEVELS) if len(values) else None
            ranges[name] = FailingRange(self.study.laws[name].median, quantiles)
        design_points = estimate.design_points if isinstance(estimate, WeightedEstimate) else []
        return RareAnswer(
            requirements=tuple(requirement.text for requirement in self.study.requirements),
            probability=estimate.probability,
            interval=estimate.interval(),
            interval_method=estimate.method,
            confidence=CONFIDENCE,
            method="splitting" if splits else "importance sampling",
            refusal=self.refusal or None,
            by_method=MethodProbability(estimate.mean, estimate.mean_interval()),
            plain=PlainFailures(plain.draws, plain.failures, plain.interval(), estimate.contradicted),
            variation=estimate.variation,
            simulations=estimate.simulations,
            plain_draws=estimate.plain_draws,
            design_points=tuple(self.approximated(design_point) for design_point in design_points),
            estimates=estimate.estimates if splits else np.empty(0),
            levels=estimate.levels if splits else np.empty(0),
            in_loop_noise=self.noisy,
            where=ranges,
            settings=asdict(self.method),
        )


def columns_of(design_points: list[DesignPoint]) -> dict[str, tuple[object, np.ndarray, dict[str, str]]]:
    """Variables of a dataset that hold design points."""
    points = np.array([design_point.point for design_point in design_points])
    distances = np.array([design_point.distance for design_point in design_points])
    factors = np.array([design_point.second_order for design_point in design_points])
    return {
        "design": (("design_point", "number"), points, {"units": "1", "long_name": "standard normal coordinate"}),
        "distance": ("design_point", distances, {"units": "1", "long_name": "distance from the median draw"}),
        "second_order": ("design_point", factors, {"units": "1", "long_name": "SORM's factor"}),
    }


def design_points_of(dataset: xr.Dataset) -> list[DesignPoint]:
    """The design points that a dataset holds."""
    design_points = []
    for index in range(dataset.sizes["design_point"]):
        row = dataset.isel(design_point=index)
        design_points.append(DesignPoint(row["design"].values, float(row["distance"]), float(row["second_order"])))
    return design_points


def weighted_quantiles(values: np.ndarray, weights: np.ndarray, levels: Sequence[float]) -> np.ndarray:
    """Quantiles of weighted values: with equal weights those of NumPy's inverted distribution function."""
    return np.quantile(values, levels, weights=weights, method="inverted_cdf")


@takes_file
def rare(
    study: Study,
    importance: ImportanceSampling | None = USUAL_IMPORTANCE,
    splitting: Splitting | None = USUAL,
    progress: ProgressCallback | None = None,
) -> RareEvent:
    """Estimate a failure probability that is too small for plain draws, at the study's own values.

    Importance sampling around the design points takes some hundred simulations besides the plain draws. Splitting takes
    some hundred thousand; it needs no design points. Both use the worst requirement's scaled slack.

    Args:
        study: The study, or its file; its sweep and its number of draws are ignored.
        importance: Settings of the importance sampling; None: splitting alone.
        splitting: Settings of the splitting, which answers where importance sampling does not; None: importance
            sampling alone.
        progress: Called with the simulations done; the total is not known beforehand.

    Raises:
        ConfigError: the study has no requirements, nothing is uncertain, or importance sampling alone has no answer.
    """
    study = study.without_sweep()
    if not study.requirements:
        raise ConfigError(study.source, "rare needs at least one [[requirement]]: its slack leads to the failures")
    if not study.laws:
        raise ConfigError(study.source, "nothing is uncertain; give at least one number a law")
    slacks = Slacks(study, progress)
    seeds = (study.config.seed,)
    dimension = len(study.laws)
    refusal = ""
    if importance is not None:
        estimate_or_reason = importance_sampling(slacks, dimension, seeds, importance)
        if not isinstance(estimate_or_reason, str):
            return RareEvent.of(study, importance, estimate_or_reason, slacks.noisy)
        refusal = estimate_or_reason
    if splitting is None:
        raise ConfigError(study.source, f"importance sampling has no answer: {refusal or 'it is off'}; try `splitting`")
    estimate = split(slacks, dimension, seeds, splitting)
    return RareEvent.of(study, splitting, estimate, slacks.noisy, refusal)


class Slacks:
    """The worst requirement's slack of a study at points of the standard normal space.

    Args:
        study: The study, without a sweep.
        progress: Called with the simulations done.
    """

    def __init__(self, study: Study, progress: ProgressCallback | None) -> None:
        self.study = study
        self.progress = progress
        self.engine = Engine(study, LANES)
        self.finished = 0

    @property
    def noisy(self) -> bool:
        """Whether the loop has in-loop noise."""
        return is_noisy(self.engine)

    def advance(self, simulations: int) -> None:
        """Report progress."""
        self.finished += simulations
        if self.progress:
            self.progress(self.finished, None)

    def __call__(self, points: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """See :data:`dssc_jax.analyses.rare_events.estimate.SlackFunction`."""
        results = evaluate(self.engine, values_at(self.study, inside_cube(special.ndtr(points))), noise)
        self.advance(len(points))
        return worst_slack(self.study.requirements, results)
