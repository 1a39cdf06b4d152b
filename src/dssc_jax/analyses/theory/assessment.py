"""Theory and simulation combined: how far one number of a loop can change according to each."""

import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.defaults import BISECTIONS, POINTS
from dssc_jax.analyses.margins import Margins, join_margins, margin, margin_settings, part_margins
from dssc_jax.analyses.theory.chattering import SAMPLES_IN_MU, chattering, time_constant_of
from dssc_jax.analyses.theory.linearised import kind_of
from dssc_jax.analyses.theory.local import Time, local_margin
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import Stored
from dssc_jax.study import Study

VALUES, PUSH, SETTLED = 9, 1e-3, 0.75  # time constants, initial output [m], share of the duration that is ignored
PERFORMANCE, OSCILLATIONS = "performance", "oscillations"
OSCILLATION = ("amplitude", "predicted", "frequency")
"""Variables of an oscillation's dataset."""


@dataclass(eq=False)
class Assessment(Analysis):
    """Theorem 1, linearisation, describing functions and Monte Carlo for the margins of one number.

    The dataset is that of :class:`dssc_jax.analyses.margins.Margins` with the additional dimension ``margin``, and the
    return value of :func:`chattering` with the additional dimension ``controller``.

    Args:
        performance: Simulated margins for the study's requirements; their certificate is the answer of Theorem 1.
        local: Margins of the loop linearised at the origin, sampled and in continuous time.
        oscillations: Oscillations over the time constant of the unmodelled dynamics, simulated and by describing
            function, by controller.
        edge: Local critical value of that time constant, with laws at their medians; None if there is none.
        not_covered: The reason why one of the above is missing, by its name.
        seconds: Computing time.
    """

    kind = "theory"
    title = "Theory and simulation"
    table = ("margin", "draw")

    performance: Margins
    local: dict[Time, Margins]
    oscillations: dict[str, xr.Dataset]
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
        """Combine the separate parts of an assessment."""
        parts = {PERFORMANCE: performance, **{kind.value: margins for kind, margins in local.items()}}
        dataset = join_margins(parts, "margin", "what the margin is of")
        if oscillations:
            names = np.array(list(oscillations))
            axis = xr.DataArray(names, dims="controller", name="controller", attrs={"long_name": "controller"})
            beyond = xr.concat(list(oscillations.values()), dim=axis, combine_attrs="override")
            dataset = dataset.merge(beyond, combine_attrs="override")
        return cls(performance.study, dataset, performance, local, oscillations, edge, not_covered, seconds)

    @property
    def margins(self) -> dict[str, Margins]:
        """Simulated and linearised margins, by their criterion."""
        titles = {Time.SAMPLED: "local, sampled loop (eigenvalues)", Time.CONTINUOUS: "local, continuous (eigenvalues)"}
        local = {titles[kind]: margins for kind, margins in self.local.items()}
        return {"performance (simulated)": self.performance, **local}

    @property
    def headline(self) -> str:
        """The answer in one line."""
        parts = {"simulated": self.performance, **{kind.value: margins for kind, margins in self.local.items()}}
        medians = ((name, margins.median) for name, margins in parts.items())
        values = (f"{name} {'before the start' if value is None else f'{value:.4g}'}" for name, value in medians)
        return f"median critical {self.performance.parameter}: {', '.join(values)}"

    def figure(self) -> Figure:
        """Plot the answer."""
        return plotting.theory(self.margins, self.oscillations, self.edge)

    def content(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        own = self.performance.summary()
        return {
            **{name: own[name] for name in ("parameter", "unit", "draws", "bounds")},
            "certificate": {"certified": own["certified"], "text": own["certificate"]},
            "proof": own["proof"],
            PERFORMANCE: distribution_summary(self.performance),
            "local": {kind.value: distribution_summary(margins) for kind, margins in self.local.items()},
            "edge": self.edge,
            OSCILLATIONS: {
                name: {"mu": of[self.performance.parameter].values, **{part: of[part].values for part in OSCILLATION}}
                for name, of in self.oscillations.items()
            },
            "not_covered": self.not_covered,
            "seconds": self.seconds,
        }

    def settings(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        local = {kind.value: margins for kind, margins in self.local.items()}
        return {
            "margins": margin_settings({PERFORMANCE: self.performance, **local}),
            OSCILLATIONS: {name: dict(of.attrs) for name, of in self.oscillations.items()},
            **{name: getattr(self, name) for name in ("edge", "not_covered", "seconds")},
        }

    @classmethod
    def restored(cls, stored: Stored) -> Self:
        """See :class:`Analysis`."""
        study, dataset, settings = stored
        margins = part_margins(dataset, "margin", settings["margins"], lambda name: study)
        performance = margins.pop(PERFORMANCE)
        oscillations = {
            name: xr.Dataset(dataset[list(OSCILLATION)].sel(controller=name, drop=True).variables, attrs=about)
            for name, about in settings[OSCILLATIONS].items()
        }
        local = {Time(name): one for name, one in margins.items()}
        rest = (settings[name] for name in ("edge", "not_covered", "seconds"))
        return cls.of(performance, local, oscillations, *rest)


def distribution_summary(margins: Margins) -> dict[str, Any]:
    """Summarise a distribution of margins."""
    summary = margins.summary()
    names = ("criterion", "median", "lower_tolerance", "content", "confidence")
    return {name: summary[name] for name in (*names, "fail_at_start", "pass_to_end", "non_monotone")}


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
    """Assess one number's critical value by Theorem 1, linearisation, describing functions and simulation.

    Each method answers a different question. The theorem covers all draws and all states, but the loop without lag and
    sampling. A proof covers the sampled loop with its lag, for all plants of the laws at once. Eigenvalues cover small
    deviations, describing functions the oscillations that switching laws sustain, and simulation the requirements. If a
    method does not apply, the result gives the reason.

    Args:
        study: The study; its own sweep is ignored.
        over: Dotted name of the number.
        bounds: The safe end, then the other end.
        log: Space the values evenly in the logarithm.
        points: Number of values in the bracketing grid.
        bisections: Number of bisections of the grid cell.
        rivals: The study with other controllers, whose oscillations are shown for comparison.
        prove: Also prove the sampled loop, as far as a proof is found.
        progress: Called with the lanes done for the simulated margin.

    Raises:
        ConfigError: the number, or a bound, is not admissible, or the draws are not independent.
    """
    began = time.perf_counter()
    walk = {"over": over, "bounds": bounds, "log": log, "points": points, "bisections": bisections}
    performance = margin(study, **walk, prove=prove, progress=progress)
    study = study.without_sweep()
    local, not_covered, edge = {}, {}, None
    for kind in Time:
        try:
            local[kind] = local_margin(study, **walk, kind=kind)
        except ConfigError as error:
            not_covered[kind.value] = error.rule
    if Time.SAMPLED in local and over == f"unmodelled.{study.loop.unmodelled[0].time_constant}":
        middle = study.override({**{name: law.median for name, law in study.laws.items()}, "draws": 1})
        critical = float(local_margin(middle, **walk).dataset["critical"].values[0])
        edge = None if np.isnan(critical) else critical
    oscillations = {}
    try:
        values = time_constants(study, over, bounds)
        after = SETTLED * study.config.loop.duration
        for name, loop in {kind_of(study, "controller"): study, **(rivals or {})}.items():
            oscillations[name] = chattering(loop, values, push=PUSH, after=after)
    except ConfigError as error:
        not_covered[OSCILLATIONS] = error.rule
    return Assessment.of(performance, local, oscillations, edge, not_covered, time.perf_counter() - began)


def time_constants(study: Study, over: str, bounds: tuple[float, float]) -> list[float]:
    """Time constants within the walk that the clock resolves.

    Raises:
        ConfigError: there are none, or the walk is not over the time constant of the unmodelled dynamics.
    """
    if len(study.loop.channels) > 1 or over != time_constant_of(study):
        rule = "oscillations are predicted over the time constant of the unmodelled dynamics, on a plant of one channel"
        raise ConfigError(over, rule)
    least, most = max(min(bounds), SAMPLES_IN_MU * study.config.loop.sample_time), max(bounds)
    if least >= most:
        raise ConfigError(
            over, f"the clock would chatter rather than the dynamics: T_s exceeds {most / SAMPLES_IN_MU:g} s, mu/20"
        )
    return np.geomspace(least, most, VALUES).tolist()
