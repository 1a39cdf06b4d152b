"""``probability``: a failure probability with an interval of a given width, by few simulations."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.conditions import require_laws
from dssc_jax.analyses.defaults import MOST_STRATIFIED, WIDTH
from dssc_jax.analyses.probability.strata import StratifiedEstimate, stratified_probability
from dssc_jax.analyses.slacks import StudySlacks
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import Quantity, unit_and_meaning
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.results.analysis import Analysis
from dssc_jax.statistics import CONFIDENCE, draws_as_narrow
from dssc_jax.study import Study, takes_file


@dataclass(frozen=True)
class ProbabilityAnswer:
    """The answer for a failure probability: the estimate, its interval, its strata and its cost."""

    requirements: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    probability: Annotated[float, Quantity("1", "failure probability")]
    interval: Annotated[tuple[float, float], Quantity("1", "interval of the failure probability")]
    confidence: Annotated[float, Quantity("1", "confidence of the interval")]
    width: Annotated[float, Quantity("1", "width of the interval that was asked for")]
    reached: Annotated[bool, Quantity("", "whether the interval is no wider")]
    simulations: Annotated[int, Quantity("1", "number of simulations, with those of the prediction")]
    plain_draws: Annotated[int, Quantity("1", "plain draws that an interval as narrow takes")]
    edges: Annotated[np.ndarray, Quantity("1", "predicted slacks between the strata, scaled")]
    weights: Annotated[np.ndarray, Quantity("1", "probability of each stratum")]
    draws: Annotated[np.ndarray, Quantity("1", "draws of each stratum")]
    failures: Annotated[np.ndarray, Quantity("1", "draws of each stratum that failed")]


@dataclass(eq=False)
class FailureProbability(Analysis):
    """The failure probability of a study, from strata along a predicted border of failure.

    The dataset has along ``stratum`` the number of ``draws`` and of ``failures``, and ``upper``, the upper edge of the
    stratum as a scaled predicted slack (infinite for the last one). Along ``net`` and ``stratum`` it has ``weight``,
    the probability of the stratum by each of several Sobol nets.

    Args:
        width: Width of the interval that was asked for.
        simulations: Number of simulations, for the prediction and in the strata.
    """

    kind = "probability"
    title = "Failure probability"
    table = ("stratum",)

    width: float
    simulations: int

    @classmethod
    def of(cls, study: Study, width: float, estimate: StratifiedEstimate) -> Self:
        """Make the analysis of an estimate, with its strata in a dataset.

        Args:
            study: The study without a sweep.
            width: Width of the interval that was asked for.
            estimate: The estimate.
        """
        upper = np.append(estimate.edges, np.inf)
        columns = {
            "upper": ("stratum", upper, unit_and_meaning("1", "upper edge of the predicted slack, scaled")),
            "draws": ("stratum", estimate.draws, unit_and_meaning("1", "number of draws")),
            "failures": ("stratum", estimate.failures, unit_and_meaning("1", "draws that failed")),
            "weight": (("net", "stratum"), estimate.weights, unit_and_meaning("1", "probability of the stratum")),
        }
        return cls(study, xr.Dataset(columns, attrs={"title": study.name}), width, estimate.simulations)

    @cached_property
    def estimate(self) -> StratifiedEstimate:
        """The estimate, rebuilt from the dataset."""
        data = self.dataset
        return StratifiedEstimate(
            simulations=self.simulations,
            weights=data["weight"].values,
            failures=data["failures"].values,
            draws=data["draws"].values,
            edges=data["upper"].values[:-1],  # the last stratum has no upper edge
        )

    @property
    def headline(self) -> str:
        """The failure probability with its interval, in one line."""
        low, high = self.estimate.interval()
        return f"failure probability {self.estimate.probability:.4g} in [{low:.4g}, {high:.4g}]"

    def figure(self) -> Figure:
        """Plot the probability and the draws of each stratum, and the share of failed draws in it."""
        return plotting.strata(self)

    @property
    def answer(self) -> ProbabilityAnswer:
        """The failure probability, its interval and its cost, as ``summary.json`` has them."""
        estimate = self.estimate
        low, high = estimate.interval()
        return ProbabilityAnswer(
            requirements=tuple(requirement.text for requirement in self.study.requirements),
            probability=estimate.probability,
            interval=(low, high),
            confidence=CONFIDENCE,
            width=self.width,
            reached=high - low <= self.width,
            simulations=estimate.simulations,
            plain_draws=draws_as_narrow(estimate.probability, high - low),
            edges=estimate.edges,
            weights=estimate.weights.mean(axis=0),
            draws=estimate.draws,
            failures=estimate.failures,
        )


@takes_file
def probability(
    study: Study, width: float = WIDTH, most: int = MOST_STRATIFIED, progress: ProgressCallback | None = None
) -> FailureProbability:
    """Estimate a study's failure probability at its own values.

    A pilot sample of plain draws predicts where draws fail. Further draws are spent where the prediction is in doubt.
    The interval is valid even if the prediction is bad.

    Args:
        study: The study, or its file; its sweep, its number of draws and its ``sampling`` are ignored.
        width: Upper minus lower limit at which the number of draws aims, in (0, 1).
        most: Largest number of draws in the strata, which may leave the interval wider.
        progress: Called with the simulations done; the total is not known beforehand.

    Raises:
        ConfigError: A number is out of range, the study has no requirements, or nothing is uncertain.
    """
    study = study.without_sweep()
    if not 0.0 < width < 1.0 or most < 1000:
        raise ConfigError("probability", f"needs width in (0, 1) and most >= 1000, got {width:g} and {most}")
    if not study.requirements:
        raise ConfigError(study.source, "probability needs at least one [[requirement]], whose slack it predicts")
    require_laws(study)
    slacks = StudySlacks(study, progress)
    estimate = stratified_probability(slacks, len(study.laws), (study.config.seed,), width, most)
    return FailureProbability.of(study, width, estimate)
