"""Theory and simulation combined: how far a number of a loop can change according to each."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.defaults import BISECTIONS, POINTS
from dssc_jax.analyses.margins import Margins, join_margins, margin, margin_parts, split_margins
from dssc_jax.analyses.margins.joined import MarginPart, medians_text, name_axis
from dssc_jax.analyses.margins.result import PARAMETER_UNIT, MarginAnswer
from dssc_jax.analyses.theory.chattering import SAMPLES_IN_MU, chattering, time_constant_of
from dssc_jax.analyses.theory.local import Time, local_margin
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import medians
from dssc_jax.results.analysis import Analysis
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in

VALUES = 9  # time constants at which oscillations are computed
PUSH = 1e-3  # initial output of these oscillations [output]
SETTLED = 0.75  # share of the duration after which oscillations have settled
PERFORMANCE = "performance"  # name of the simulated margins
OSCILLATIONS = "oscillations"  # name under which their absence is reported
OSCILLATION = ("amplitude", "predicted", "frequency")
"""Variables of an oscillation's dataset."""


@dataclass(frozen=True)
class TheoremAnswer:
    """How far the number may change according to Theorem 1, for all draws at once."""

    certified: Annotated[float | None, Quantity(PARAMETER_UNIT, "last value that Theorem 1 certifies for all draws")]
    text: Annotated[str, Quantity("", "what Theorem 1 certifies, in words")]


@dataclass(frozen=True)
class CriticalStatistics:
    """Statistics of the values at which the draws begin to fail, by simulation or by a linearisation."""

    criterion: Annotated[tuple[str, ...], Quantity("", "what a draw has to meet")]
    median: Annotated[float | None, Quantity(PARAMETER_UNIT, "median critical value; None if it lies before the start")]
    lower_tolerance: Annotated[float | None, Quantity(PARAMETER_UNIT, "value up to which the share `content` passes")]
    content: Annotated[float, Quantity("1", "share of draws of the tolerance limit")]
    confidence: Annotated[float, Quantity("1", "confidence of the tolerance limit")]
    fail_at_start: Annotated[float, Quantity("1", "share of draws that fail at the start")]
    pass_to_end: Annotated[float, Quantity("1", "share of draws that pass at every value of the grid")]
    non_monotone: Annotated[float, Quantity("1", "share of draws that pass again beyond a failure")]

    @classmethod
    def of(cls, answer: MarginAnswer) -> Self:
        """Copy the statistics from an answer for margins, whose fields have the same names."""
        return cls(**{field.name: getattr(answer, field.name) for field in fields(cls)})


@dataclass(frozen=True)
class Oscillation:
    """A controller's oscillation at n time constants of the unmodelled dynamics; each field has the shape (n,)."""

    mu: Annotated[np.ndarray, Quantity("s", "time constants")]
    amplitude: Annotated[np.ndarray, Quantity("output/s", "simulated amplitude of sigma")]
    predicted: Annotated[np.ndarray, Quantity("output/s", "amplitude by the describing function")]
    frequency: Annotated[np.ndarray, Quantity("rad/s", "frequency by the describing function")]


@dataclass(frozen=True)
class TheoryAnswer:
    """The answer of an assessment: the margins of a number by theory and by simulation."""

    parameter: Annotated[str, Quantity("", "the number that is varied")]
    unit: Annotated[str, Quantity("", "unit of the number")]
    draws: Annotated[int, Quantity("1", "number of draws")]
    bounds: Annotated[tuple[float, float], Quantity(PARAMETER_UNIT, "start and end of the walk")]
    certificate: TheoremAnswer
    proof: Annotated[JsonObject | None, Quantity("", "how far the sampled loop is proved; None if not asked")]
    performance: CriticalStatistics
    local: dict[str, CriticalStatistics]
    edge: Annotated[float | None, Quantity("s", "local critical time constant with laws at their medians")]
    oscillations: dict[str, Oscillation]
    not_covered: Annotated[dict[str, str], Quantity("", "why a method does not apply, by its name")]
    seconds: Annotated[float, Quantity("s", "computing time")]


@dataclass(eq=False)
class Assessment(Analysis):
    """The margins of a number by Theorem 1, linearisation, describing functions and Monte Carlo.

    The dataset merges the datasets of several :class:`dssc_jax.analyses.margins.Margins`, along the additional
    dimension ``margin``, and those that :func:`chattering` returns, along the additional dimension ``controller``.

    Args:
        parts: Facts about the margins ``performance``, ``sampled`` and ``continuous`` that the dataset lacks, by name.
        oscillating: Attributes of the datasets of the oscillations, by controller.
        edge: Critical time constant of the linearised sampled loop with all laws at their medians [s]. None if another
            number is varied, or no critical value is on the walk.
        not_covered: The reason why a margin of the linearised loop, or an oscillation, is missing, by name.
        seconds: Computing time [s].
    """

    kind = "theory"
    title = "Theory and simulation"
    table = ("margin", "draw")

    parts: dict[str, MarginPart]
    oscillating: dict[str, JsonObject]
    edge: float | None
    not_covered: dict[str, str]
    seconds: float = 0.0

    @classmethod
    def of(
        cls,
        performance: Margins,
        local: dict[Time, Margins],
        oscillations: dict[str, xr.Dataset],
        edge: float | None,
        not_covered: dict[str, str],
        seconds: float,
    ) -> Self:
        """Make the assessment from margins and oscillations, joined in one dataset.

        Args:
            performance: Simulated margins for the requirements.
            local: Margins of the linearised loop, by kind of linearisation.
            oscillations: The return value of :func:`chattering`, by controller.
            edge: Critical time constant as in :class:`Assessment` [s]; None if there is none.
            not_covered: The reason why a margin of the linearised loop, or an oscillation, is missing, by name.
            seconds: Computing time [s].
        """
        margins = {PERFORMANCE: performance}
        for kind, local_margins in local.items():
            margins[kind.value] = local_margins
        dataset = join_margins(margins, dimension="margin", meaning="method of the margin")
        if oscillations:
            axis = name_axis("controller", oscillations, "controller")
            joined = xr.concat(list(oscillations.values()), dim=axis, combine_attrs="override")
            dataset = dataset.merge(joined, combine_attrs="override")
        attributes = {}
        for name, oscillation in oscillations.items():
            attributes[name] = {str(key): value for key, value in oscillation.attrs.items()}
        return cls(
            study=performance.study,
            dataset=dataset,
            parts=margin_parts(margins),
            oscillating=attributes,
            edge=edge,
            not_covered=not_covered,
            seconds=seconds,
        )

    @cached_property
    def all_margins(self) -> dict[str, Margins]:
        """All margins, by their names in :attr:`parts`."""
        return split_margins(self.dataset, "margin", self.parts, lambda name: self.study)

    @property
    def performance(self) -> Margins:
        """Simulated margins for the study's requirements; their certificate is the answer of Theorem 1."""
        return self.all_margins[PERFORMANCE]

    @property
    def local(self) -> dict[Time, Margins]:
        """Margins of the loop linearised at the origin, by kind of linearisation: sampled or in continuous time."""
        return {Time(name): margins for name, margins in self.all_margins.items() if name != PERFORMANCE}

    @cached_property
    def oscillations(self) -> dict[str, xr.Dataset]:
        """Oscillations over the time constant, simulated and by describing function, by name of the controller."""
        oscillations = {}
        for name, attributes in self.oscillating.items():
            variables = self.dataset[list(OSCILLATION)].sel(controller=name, drop=True).variables
            oscillations[name] = xr.Dataset(variables, attrs=attributes)
        return oscillations

    @property
    def margins(self) -> dict[str, Margins]:
        """Margins by simulation and by linearisation, by the title that a figure shows."""
        titles = {Time.SAMPLED: "local, sampled loop (eigenvalues)", Time.CONTINUOUS: "local, continuous (eigenvalues)"}
        local = {titles[kind]: margins for kind, margins in self.local.items()}
        return {"performance (simulated)": self.performance, **local}

    @property
    def headline(self) -> str:
        """The median critical value by each method, in one line."""
        margins = {"simulated": self.performance}
        for kind, local in self.local.items():
            margins[kind.value] = local
        return f"median critical {self.performance.parameter}: {medians_text(margins)}"

    def figure(self) -> Figure:
        """Plot the margins by each method, and the oscillations beyond the local margin."""
        return plotting.theory(self.margins, self.oscillations, self.edge)

    @property
    def answer(self) -> TheoryAnswer:
        """The margins by each method and the oscillations, as ``summary.json`` has them."""
        simulated = self.performance.answer
        oscillations = {}
        for name, oscillation in self.oscillations.items():
            columns = {variable: oscillation[variable].values for variable in OSCILLATION}
            oscillations[name] = Oscillation(mu=oscillation[self.performance.parameter].values, **columns)
        return TheoryAnswer(
            parameter=simulated.parameter,
            unit=simulated.unit,
            draws=simulated.draws,
            bounds=simulated.bounds,
            certificate=TheoremAnswer(simulated.certified, simulated.certificate),
            proof=simulated.proof,
            performance=CriticalStatistics.of(simulated),
            local={kind.value: CriticalStatistics.of(margins.answer) for kind, margins in self.local.items()},
            edge=self.edge,
            oscillations=oscillations,
            not_covered=self.not_covered,
            seconds=self.seconds,
        )


def assess(
    study: Study,
    *,
    over: str,
    bounds: tuple[float, float],
    log: bool = False,
    points: int = POINTS,
    bisections: int = BISECTIONS,
    rivals: Mapping[str, Study] | None = None,
    prove: bool = False,
    progress: ProgressCallback | None = None,
) -> Assessment:
    """Assess the critical value of a number, beyond which a loop fails, by theory and by simulation.

    Each method answers a different question:

    * Theorem 1 covers all draws and all states, but the loop without lag and sampling.
    * A proof, with ``prove``, covers the sampled loop with its lag, for all plants of the laws at once.
    * Eigenvalues cover small deviations.
    * Describing functions cover the oscillations that switching laws sustain.
    * Simulation covers the requirements.

    Args:
        study: The study; its own sweep is ignored.
        over: Dotted name of the number.
        bounds: Values between which the critical one is sought: the safe end first.
        log: Space the values evenly in the logarithm.
        points: Number of values in the bracketing grid.
        bisections: Number of bisections of the grid cell.
        rivals: The study with other controllers, whose oscillations are shown for comparison.
        prove: Also prove the sampled loop, as far as a proof is found.
        progress: Called with the lanes done for the simulated margin.

    Returns:
        The margins and oscillations; where a method does not apply, the reason in their place.

    Raises:
        ConfigError: The number, or a bound, is not admissible, or the draws are not independent.
    """
    began = time.perf_counter()
    walk = {"over": over, "bounds": bounds, "log": log, "points": points, "bisections": bisections}
    performance = margin(study, **walk, prove=prove, progress=progress)
    study = study.without_sweep()
    local, not_covered = local_margins(study, walk)
    edge = None
    if Time.SAMPLED in local and is_time_constant(study, over):
        edge = median_edge(study, walk)
    oscillations = {}
    try:
        values = time_constants(study, over, bounds)
        after = SETTLED * study.config.loop.duration
        loops = {kind_in(study.config, "controller"): study, **(rivals or {})}
        for name, loop in loops.items():  # an error keeps the oscillations found before it
            oscillations[name] = chattering(loop, values, push=PUSH, after=after)
    except ConfigError as error:
        not_covered[OSCILLATIONS] = error.rule
    return Assessment.of(performance, local, oscillations, edge, not_covered, time.perf_counter() - began)


def local_margins(study: Study, walk: Mapping[str, Any]) -> tuple[dict[Time, Margins], dict[str, str]]:
    """Compute the margins of the linearised loop for each kind of linearisation that the study allows.

    Returns the margins by kind, and for each other kind, by its name, the reason why it has no margins.

    Args:
        study: The study without a sweep.
        walk: The settings of the walk, as arguments of :func:`local_margin`.
    """
    margins = {}
    reasons = {}
    for kind in Time:
        try:
            margins[kind] = local_margin(study, **walk, kind=kind)
        except ConfigError as error:
            reasons[kind.value] = error.rule
    return margins, reasons


def median_edge(study: Study, walk: Mapping[str, Any]) -> float | None:
    """Critical value of the linearised sampled loop with all laws at their medians; None if it is not on the walk.

    Args:
        study: The study without a sweep.
        walk: The settings of the walk, as arguments of :func:`local_margin`.
    """
    median_study = study.override({**medians(study), "draws": 1})
    critical = float(local_margin(median_study, **walk).dataset["critical"].values[0])
    return None if np.isnan(critical) else critical


def is_time_constant(study: Study, name: str) -> bool:
    """Whether a dotted name is that of the time constant of the unmodelled dynamics."""
    try:
        return time_constant_of(study) == name
    except ConfigError:
        return False


def time_constants(study: Study, over: str, bounds: tuple[float, float]) -> list[float]:
    """The time constants at which oscillations are computed [s]: within the walk, and at least 20 samples long.

    Args:
        study: The study.
        over: Dotted name of the number that is walked.
        bounds: Both ends of the walk.

    Raises:
        ConfigError: All time constants of the walk are too short, or the walk is over another number.
    """
    if len(study.loop.channels) > 1 or over != time_constant_of(study):
        rule = "oscillations are predicted over the time constant of the unmodelled dynamics, on a plant of one channel"
        raise ConfigError(over, rule)
    low = max(min(bounds), SAMPLES_IN_MU * study.config.loop.sample_time)
    high = max(bounds)
    if low >= high:
        raise ConfigError(
            over, f"the clock would chatter rather than the dynamics: T_s exceeds {high / SAMPLES_IN_MU:g} s, mu/20"
        )
    return np.geomspace(low, high, VALUES).tolist()
