"""A failure probability that is too small for plain draws, by splitting on the worst requirement's slack."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy import special

import dssc_jax.plotting as plotting
from dssc_jax.analyses.rare_events.splitting import USUAL, Estimate, Plain, Splitting, split
from dssc_jax.closed_loop.requirements import worst_slack
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import Arrays, Engine, evaluate, is_noisy
from dssc_jax.engine.sampling import inside, values_at
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.fields import MERGED
from dssc_jax.statistics import CONFIDENCE
from dssc_jax.study import Study, takes_file

QUANTILE_LEVELS = (0.05, 0.5, 0.95)


@dataclass(frozen=True)
class SplittingProbability:
    """The failure probability from the repeats of the splitting alone."""

    probability: Annotated[float, Quantity("1", "failure probability")]
    interval: Annotated[tuple[float, float], Quantity("1", "its interval")]


@dataclass(frozen=True)
class PlainFailures:
    """The failures of the plain draws."""

    draws: Annotated[int, Quantity("1", "number of plain draws")]
    failures: Annotated[int, Quantity("1", "plain draws that failed")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability (Clopper-Pearson)")]
    contradicts: Annotated[bool, Quantity("", "whether this interval and that of the splitting are disjoint")]


@dataclass(frozen=True)
class FailingRange:
    """Range of a number at failures."""

    median: Annotated[float, Quantity("that of the number", "median of its law")]
    failing: Annotated[np.ndarray | None, Quantity("that of the number", "5 %, 50 % and 95 % quantile at failures")]


@dataclass(frozen=True)
class SplittingSettings:
    """Settings of the splitting."""

    particles: Annotated[int, Quantity("1", "particles of each repeat")]
    killed: Annotated[int, Quantity("1", "particles that a level replaces")]
    moves: Annotated[int, Quantity("1", "moves of each clone at a level")]
    repeats: Annotated[int, Quantity("1", "number of independent repeats")]


@dataclass(frozen=True)
class RareAnswer:
    """A rare failure's probability, its cost, and where the failures are."""

    requirements: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    probability: Annotated[float, Quantity("1", "failure probability")]
    interval: Annotated[tuple[float, float], Quantity("1", "its interval")]
    interval_method: Annotated[str, Quantity("", "method of the interval")]
    confidence: Annotated[float, Quantity("1", "confidence of each interval")]
    splitting: SplittingProbability
    plain: PlainFailures
    variation: Annotated[float, Quantity("1", "coefficient of variation of the splitting; None: no failure reached")]
    simulations: Annotated[int, Quantity("1", "number of simulations of the splitting")]
    plain_draws: Annotated[float, Quantity("1", "plain draws that would give this variation; None: infinitely many")]
    estimates: Annotated[np.ndarray, Quantity("1", "failure probability from each repeat")]
    levels: Annotated[np.ndarray, Quantity("1", "levels that each repeat passed")]
    in_loop_noise: Annotated[bool, Quantity("", "whether the loop has in-loop noise")]
    where: dict[str, FailingRange]
    settings: SplittingSettings = field(metadata={MERGED: True})


@dataclass(eq=False)
class RareEvent(Analysis):
    """The probability of a study's rare failure.

    The dataset has along ``repeat``: ``estimate`` and ``levels``. Along ``failure``, the failing particles and then the
    plain draws that failed, it has every uncertain number; ``plain``, which of the two it is; and ``noise``,
    a particle's index of the in-loop noise. Along ``failure`` and ``number`` it has its ``point`` in standard
    normal space.

    Args:
        splitting: The settings of the splitting.
        simulations: Number of evaluations of the slack by the splitting.
        noisy: Whether the loop has in-loop noise.
    """

    kind = "rare"
    title = "A rare failure"
    table = ("failure",)

    splitting: Splitting
    simulations: int
    noisy: bool

    @classmethod
    def of(cls, study: Study, splitting: Splitting, estimate: Estimate, noisy: bool) -> Self:
        """Create the analysis from the estimate of a splitting."""
        plain = estimate.plain
        points = np.concatenate([estimate.points, plain.points])
        columns = {
            "estimate": ("repeat", estimate.estimates, {"units": "1", "long_name": "failure probability"}),
            "levels": ("repeat", estimate.levels, {"units": "1", "long_name": "levels passed"}),
            "plain": (
                "failure",
                np.arange(len(points)) >= len(estimate.points),
                {"long_name": "a plain draw, not a particle"},
            ),
            "noise": (
                "failure",
                np.concatenate([estimate.noise, np.full(plain.failures, -1)]),
                {"units": "1", "long_name": "index of the in-loop noise; -1: of a plain draw"},
            ),
            "point": (("failure", "number"), points, {"units": "1", "long_name": "standard normal coordinate"}),
        }
        for name, values in values_at(study, inside(special.ndtr(points))).items():
            quantity = study.quantities[name]
            columns[name] = ("failure", values, {"units": quantity.unit, "long_name": quantity.meaning})
        number = ("number", np.array(list(study.laws)), {"long_name": "uncertain number"})
        dataset = xr.Dataset(columns, coords={"number": number}, attrs={"title": study.name})
        return cls(study, dataset, splitting, estimate.simulations, noisy)

    @cached_property
    def estimate(self) -> Estimate:
        """The probability and how it was estimated."""
        data = self.dataset
        plain = data["plain"].values
        return Estimate(
            estimates=data["estimate"].values,
            levels=data["levels"].values,
            simulations=self.simulations,
            points=data["point"].values[~plain],
            noise=data["noise"].values[~plain],
            plain=Plain(self.splitting.plain, data["point"].values[plain]),
        )

    @property
    def failing_values(self) -> Arrays:
        """Values of each uncertain number at failures: those of the plain draws if they answer, else the particles'."""
        chosen = self.dataset["plain"].values != self.estimate.answered
        return {name: self.dataset[name].values[chosen] for name in self.study.laws}

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

    @property
    def answer(self) -> RareAnswer:
        """The numbers that summary.json holds."""
        estimate = self.estimate
        plain = estimate.plain
        ranges = {}
        for name, values in self.failing_values.items():
            quantiles = np.quantile(values, QUANTILE_LEVELS) if len(values) else None
            ranges[name] = FailingRange(self.study.laws[name].median, quantiles)
        splitting = self.splitting
        return RareAnswer(
            requirements=tuple(requirement.text for requirement in self.study.requirements),
            probability=estimate.probability,
            interval=estimate.interval(),
            interval_method=estimate.method,
            confidence=CONFIDENCE,
            splitting=SplittingProbability(estimate.mean, estimate.mean_interval()),
            plain=PlainFailures(plain.draws, plain.failures, plain.interval(), estimate.contradicted),
            variation=estimate.variation,
            simulations=estimate.simulations,
            plain_draws=estimate.plain_draws,
            estimates=estimate.estimates,
            levels=estimate.levels,
            in_loop_noise=self.noisy,
            where=ranges,
            settings=SplittingSettings(splitting.particles, splitting.killed, splitting.moves, splitting.repeats),
        )


@takes_file
def rare(study: Study, splitting: Splitting = USUAL, progress: ProgressCallback | None = None) -> RareEvent:
    """Estimate a study's failure probability at its own values, by splitting on the worst requirement's scaled slack.

    Args:
        study: The study, or its file; its sweep and its number of draws are ignored.
        splitting: The settings of the splitting.
        progress: Called with the simulations done; the total is not known beforehand.

    Raises:
        ConfigError: the study has no requirements, or nothing is uncertain.
    """
    study = study.without_sweep()
    if not study.requirements:
        raise ConfigError(study.source, "rare needs at least one [[requirement]]: its slack leads to the failures")
    if not study.laws:
        raise ConfigError(study.source, "nothing is uncertain; give at least one number a law")
    engine = Engine(study, splitting.repeats * splitting.killed)
    finished = 0

    def slack(points: np.ndarray, noise: np.ndarray) -> np.ndarray:
        nonlocal finished
        results = evaluate(engine, values_at(study, inside(special.ndtr(points))), noise)
        finished += len(points)
        if progress:
            progress(finished, None)
        return worst_slack(study.requirements, results)

    estimate = split(slack, len(study.laws), (study.config.seed,), splitting)
    return RareEvent.of(study, splitting, estimate, is_noisy(engine))
