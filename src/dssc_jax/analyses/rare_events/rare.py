"""A failure probability that is too small for plain draws, by importance sampling or by splitting."""

from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Annotated, Self, TypeAlias

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy import special

import dssc_jax.plotting as plotting
from dssc_jax.analyses.conditions import require_laws
from dssc_jax.analyses.rare_events.design_points import DesignPoint
from dssc_jax.analyses.rare_events.estimate import Estimate, PlainDraws
from dssc_jax.analyses.rare_events.importance import ImportanceSampling, WeightedEstimate, importance_sampling
from dssc_jax.analyses.rare_events.splitting import DEFAULT_SPLITTING, Splitting, SplittingEstimate, split
from dssc_jax.analyses.slacks import StudySlacks
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, unit_and_meaning
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.sampling import Arrays, inside_cube, values_at
from dssc_jax.results.analysis import Analysis
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.study import Study, takes_file

QUANTILE_LEVELS = (0.05, 0.5, 0.95)

Method: TypeAlias = ImportanceSampling | Splitting
"""The settings of a method."""

DEFAULT_IMPORTANCE = ImportanceSampling()


@dataclass(frozen=True)
class MethodProbability:
    """The failure probability by importance sampling or splitting, whatever the plain draws say."""

    probability: Annotated[float, Quantity("1", "failure probability")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability")]


@dataclass(frozen=True)
class ApproximatedFailures:
    """The failures around a design point, with two approximations of their probability; neither has an interval."""

    distance: Annotated[float, Quantity("1", "distance from the median draw in standard normal space")]
    first_order: Annotated[float, Quantity("1", "probability behind the tangent of the border (FORM)")]
    second_order: Annotated[float, Quantity("1", "probability behind its paraboloid (SORM); None: there is none")]
    values: Annotated[dict[str, float], Quantity("that of the number", "values of the uncertain numbers there")]


@dataclass(frozen=True)
class PlainFailures:
    """The failures among plain draws, which check the estimate of the rare-event method."""

    draws: Annotated[int, Quantity("1", "number of plain draws")]
    failures: Annotated[int, Quantity("1", "plain draws that failed")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability (Clopper-Pearson)")]
    contradicts: Annotated[bool, Quantity("", "whether this interval and that of the method are disjoint")]


@dataclass(frozen=True)
class FailingRange:
    """Values of an uncertain number in the draws that fail, beside the median of all draws."""

    median: Annotated[float, Quantity("that of the number", "median of its law")]
    failing: Annotated[np.ndarray | None, Quantity("that of the number", "5 %, 50 % and 95 % quantile at failures")]


@dataclass(frozen=True)
class RareAnswer:
    """The answer of :func:`rare`: a rare failure's probability, its cost, and where the failures are."""

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
    """The probability of a rare failure, and the failures from which it was estimated.

    The dimension ``failure`` of the dataset holds the failing points of the method and then the plain draws that
    failed. The dataset has along ``failure``:

    * the value of every uncertain number;
    * ``point``, the coordinates of the failure in standard normal space, along ``number``, too;
    * ``plain``, whether the failure is a plain draw;
    * ``weight``, the probability that the failure stands for, up to a factor;
    * ``noise``, the index of the in-loop noise; -1 for a plain draw.

    A splitting adds along ``repeat`` the ``estimate`` and the number of ``levels`` of each repeat. Importance sampling
    adds along ``design_point`` the ``distance`` from the median draw, ``second_order``, the ratio of SORM's probability
    to FORM's, and along ``number``, too, the coordinates ``design``.

    Args:
        method: The settings of the method.
        simulations: Number of simulations besides the plain draws.
        largest: Upper bound assumed for the weight of any failing point, used by the interval; 0 for a splitting.
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
        """Make the analysis of an estimate, with its failures in a dataset.

        Args:
            study: The study without a sweep.
            settings: The settings of the method.
            estimate: The estimate of the failure probability by this method.
            noisy: Whether the loop has in-loop noise.
            refusal: Why importance sampling gave no answer; empty if it did, or was not tried.
        """
        plain = estimate.plain
        points = np.concatenate([estimate.points, plain.points])
        is_plain = np.arange(len(points)) >= len(estimate.points)
        noise = np.concatenate(
            [estimate.noise_index, np.full(plain.failures, -1)]
        )  # the noise of plain draws is not kept
        weights = np.concatenate([estimate.weights, np.ones(plain.failures)])
        noise_meaning = "index of the in-loop noise; -1: of a plain draw"
        columns = {
            "plain": ("failure", is_plain, {"long_name": "a plain draw, not a point of the method"}),
            "noise": ("failure", noise, unit_and_meaning("1", noise_meaning)),
            "weight": ("failure", weights, unit_and_meaning("1", "weight of the failure")),
            "point": (("failure", "number"), points, unit_and_meaning("1", "standard normal coordinate")),
        }
        largest = 0.0
        if isinstance(estimate, SplittingEstimate):
            columns["estimate"] = ("repeat", estimate.estimates, unit_and_meaning("1", "failure probability"))
            columns["levels"] = ("repeat", estimate.levels, unit_and_meaning("1", "levels passed"))
        if isinstance(estimate, WeightedEstimate):
            largest = estimate.weight_bound
            columns |= design_point_columns(estimate.design_points)
        for name, values in values_at(study, inside_cube(special.ndtr(points))).items():
            quantity = study.quantities[name]
            columns[name] = ("failure", values, unit_and_meaning(quantity.unit, quantity.meaning))
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
        """The estimate of the method, rebuilt from the dataset."""
        data = self.dataset
        is_plain = data["plain"].values
        points = data["point"].values
        noise = data["noise"].values[~is_plain]
        weights = data["weight"].values[~is_plain]
        plain = PlainDraws(self.method.plain, points[is_plain])
        if isinstance(self.method, Splitting):
            return SplittingEstimate(
                simulations=self.simulations,
                points=points[~is_plain],
                noise_index=noise,
                weights=weights,
                plain=plain,
                estimates=data["estimate"].values,
                levels=data["levels"].values,
            )
        return WeightedEstimate(
            simulations=self.simulations,
            points=points[~is_plain],
            noise_index=noise,
            weights=weights,
            plain=plain,
            weight_bound=self.largest,
            design_points=read_design_points(data),
        )

    @property
    def failing(self) -> xr.Dataset:
        """The failures behind the answer: the method's points, or the plain draws if the method has no valid answer."""
        is_plain = self.dataset["plain"].values
        return self.dataset.isel(failure=~is_plain if self.estimate.answered else is_plain)

    @property
    def failing_values(self) -> Arrays:
        """Value of each uncertain number at the failures :attr:`failing`, by name, shape (failures,) each."""
        failing = self.failing
        return {name: failing[name].values for name in self.study.laws}

    @property
    def headline(self) -> str:
        """The failure probability with its interval and method, in one line."""
        low, high = self.estimate.interval()
        return (
            f"failure probability {self.estimate.probability:.3g} in [{low:.3g}, {high:.3g}] ({self.estimate.method})"
        )

    def figure(self) -> Figure:
        """Plot the estimates of the method beside the plain draws, and where failures lie within the laws."""
        return plotting.rare(self)

    def approximate_failures(self, design_point: DesignPoint) -> ApproximatedFailures:
        """The failures around a design point: their probability by FORM and SORM, and the uncertain numbers there."""
        points = design_point.point[None]  # shape (1, d)
        values = values_at(self.study, inside_cube(special.ndtr(points)))
        return ApproximatedFailures(
            distance=design_point.distance,
            first_order=design_point.first_order_probability,
            second_order=design_point.second_order_probability,
            values={name: float(column[0]) for name, column in values.items()},
        )

    def failing_ranges(self) -> dict[str, FailingRange]:
        """For each uncertain number, by name: the median of its law, and weighted quantiles of it at the failures."""
        weights = self.failing["weight"].values
        ranges = {}
        for name, values in self.failing_values.items():
            quantiles = None  # without failures
            if len(values):
                quantiles = np.quantile(values, QUANTILE_LEVELS, weights=weights, method="inverted_cdf")
            ranges[name] = FailingRange(self.study.laws[name].median, quantiles)
        return ranges

    @property
    def answer(self) -> RareAnswer:
        """The failure probability, its cost, and where the failures are, as ``summary.json`` has them."""
        estimate = self.estimate
        plain = estimate.plain
        is_splitting = isinstance(estimate, SplittingEstimate)
        design_points = estimate.design_points if isinstance(estimate, WeightedEstimate) else []
        return RareAnswer(
            requirements=tuple(requirement.text for requirement in self.study.requirements),
            probability=estimate.probability,
            interval=estimate.interval(),
            interval_method=estimate.method,
            confidence=CONFIDENCE,
            method="splitting" if is_splitting else "importance sampling",
            refusal=self.refusal or None,
            by_method=MethodProbability(estimate.mean, estimate.mean_interval()),
            plain=PlainFailures(
                draws=plain.draws, failures=plain.failures, interval=plain.interval(), contradicts=estimate.contradicted
            ),
            variation=estimate.variation,
            simulations=estimate.simulations,
            plain_draws=estimate.equivalent_draws,
            design_points=tuple(self.approximate_failures(design_point) for design_point in design_points),
            estimates=estimate.estimates if is_splitting else np.empty(0),
            levels=estimate.levels if is_splitting else np.empty(0),
            in_loop_noise=self.noisy,
            where=self.failing_ranges(),
            settings=asdict(self.method),
        )


def design_point_columns(design_points: list[DesignPoint]) -> dict[str, tuple[object, np.ndarray, dict[str, str]]]:
    """Design points as variables of a dataset, by name: a tuple (dimensions, values, attributes) for each variable.

    ``design`` contains the coordinates, along ``design_point`` and ``number``. ``distance`` and ``second_order`` have
    only the dimension ``design_point``. :func:`read_design_points` is the inverse.
    """
    points = np.array([design_point.point for design_point in design_points])
    distances = np.array([design_point.distance for design_point in design_points])
    factors = np.array([design_point.second_order for design_point in design_points])
    return {
        "design": (("design_point", "number"), points, unit_and_meaning("1", "standard normal coordinate")),
        "distance": ("design_point", distances, unit_and_meaning("1", "distance from the median draw")),
        "second_order": ("design_point", factors, unit_and_meaning("1", "SORM's factor")),
    }


def read_design_points(dataset: xr.Dataset) -> list[DesignPoint]:
    """Read the design points that :func:`design_point_columns` stored in a dataset."""
    design_points = []
    for index in range(dataset.sizes["design_point"]):
        row = dataset.isel(design_point=index)
        point = DesignPoint(
            point=row["design"].values,
            distance=float(row["distance"]),
            second_order=float(row["second_order"]),
        )
        design_points.append(point)
    return design_points


@takes_file
def rare(
    study: Study,
    importance: ImportanceSampling | None = DEFAULT_IMPORTANCE,
    splitting: Splitting | None = DEFAULT_SPLITTING,
    progress: ProgressCallback | None = None,
) -> RareEvent:
    """Estimate a failure probability that is too small for plain draws, at the study's own values.

    Importance sampling around the design points takes some hundred simulations besides the plain draws. Splitting takes
    some hundred thousand, but needs no design points. Both are guided by the slack of the worst requirement, relative
    to its bound.

    Args:
        study: The study, or its file; its sweep and its number of draws are ignored.
        importance: Settings of the importance sampling; None: splitting alone.
        splitting: Settings of the splitting, which answers where importance sampling does not; None: importance
            sampling alone.
        progress: Called with the simulations done; the total is not known beforehand.

    Raises:
        ConfigError: The study has no requirements, nothing is uncertain, or importance sampling alone has no answer.
    """
    study = study.without_sweep()
    if not study.requirements:
        raise ConfigError(study.source, "rare needs at least one [[requirement]]: its slack leads to the failures")
    require_laws(study)
    slacks = StudySlacks(study, progress)

    def slacks_at(points: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Simulate a draw at each point of standard normal space; a :data:`SlackFunction`."""
        return slacks(inside_cube(special.ndtr(points)), noise)

    seeds = (study.config.seed,)
    dimension = len(study.laws)
    refusal = ""  # why importance sampling has no answer
    if importance is not None:
        estimate_or_reason = importance_sampling(slacks_at, dimension, seeds, importance)
        if not isinstance(estimate_or_reason, str):
            return RareEvent.of(study, importance, estimate_or_reason, slacks.noisy)
        refusal = estimate_or_reason
    if splitting is None:
        raise ConfigError(study.source, f"importance sampling has no answer: {refusal or 'it is off'}; try `splitting`")
    estimate = split(slacks_at, dimension, seeds, splitting)
    return RareEvent.of(study, splitting, estimate, slacks.noisy, refusal)
