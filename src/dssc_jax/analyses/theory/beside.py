"""Theory beside simulation: what each of them says of how far one number of a loop may go."""

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import xarray as xr

from dssc_jax.analyses.margins import Margins, margin
from dssc_jax.analyses.margins.search import BISECTIONS, POINTS
from dssc_jax.analyses.theory.chattering import FINEST, MU, chattering
from dssc_jax.analyses.theory.linearised import kind_of
from dssc_jax.analyses.theory.local import Time, local_margin
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.study import Study

VALUES, PUSH, SETTLED = 9, 1e-3, 0.75  # time constants, initial output [m], share of the duration that is left aside
OSCILLATIONS = "oscillations"


@dataclass(frozen=True)
class Beside:
    """Theorem 1, linearisation, describing functions and Monte Carlo on the margins of one number.

    Args:
        performance: Simulated, against the study's requirements; its certificate is what Theorem 1 says.
        local: Of the loop linearised at the origin, sampled and in continuous time.
        oscillations: Simulated over a lag's time constant, and by describing function, by controller.
        edge: Local critical value of a lag's mu, laws at their medians; None where there is none.
        silent: Why something of the above is not there.
        seconds: What it took.
    """

    performance: Margins
    local: dict[Time, Margins]
    oscillations: dict[str, xr.Dataset]
    edge: float | None
    silent: dict[str, str] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def margins(self) -> dict[str, Margins]:
        """Simulated and linearised margins, by what they are of."""
        titles = {Time.SAMPLED: "local, sampled loop (eigenvalues)", Time.CONTINUOUS: "local, continuous (eigenvalues)"}
        found = {titles[kind]: of for kind, of in self.local.items()}
        return {"performance (simulated)": self.performance, **found}

    def summary(self) -> dict[str, Any]:
        """All of it in plain numbers, for JSON."""
        own = self.performance.summary()
        return {
            **{name: own[name] for name in ("study", "parameter", "unit", "draws", "bounds")},
            "certificate": {"certified": own["certified"], "text": own["certificate"]},
            "performance": told(self.performance),
            "local": {kind.value: told(of) for kind, of in self.local.items()},
            "edge": self.edge,
            OSCILLATIONS: {
                name: {
                    "mu": of[MU].values.tolist(),
                    **{part: of[part].values.tolist() for part in ("amplitude", "predicted", "frequency")},
                }
                for name, of in self.oscillations.items()
            },
            "silent": self.silent,
            "seconds": self.seconds,
        }


def told(found: Margins) -> dict[str, Any]:
    """What one can defend of a distribution of margins."""
    summary = found.summary()
    names = ("criterion", "median", "lower_tolerance", "content", "confidence")
    return {name: summary[name] for name in (*names, "fail_at_start", "pass_to_end", "non_monotone")}


def beside(
    study: Study,
    *,
    over: str,
    bounds: tuple[float, float],
    log: bool = False,
    points: int = POINTS,
    bisections: int = BISECTIONS,
    rivals: Mapping[str, Study] | None = None,
    progress: ProgressCallback | None = None,
) -> Beside:
    """What Theorem 1, linearisation, describing functions and simulation say of one number's critical value.

    Each answers a question of its own: the theorem for all draws and all states, but of the loop without lag and
    sampling; eigenvalues for small deviations; describing functions for what switching laws sustain; simulation for the
    requirements. Where one of them does not speak the result says why.

    Args:
        study: The study; its own sweep is left aside.
        over: Dotted name of the number.
        bounds: The safe end, then the other.
        log: Walk evenly in the logarithm.
        points: Values of the bracketing grid.
        bisections: Halvings of the grid's cell.
        rivals: The study under other controllers, whose oscillations over a lag's mu are shown beside its own.
        progress: Told of the simulated margin's lanes.

    Raises:
        ConfigError: the number, or a bound, is not admissible, or the draws are not independent.
    """
    began = time.perf_counter()
    walk = {"over": over, "bounds": bounds, "log": log, "points": points, "bisections": bisections}
    performance = margin(study, **walk, progress=progress)
    study, local, silent = study.without_sweep(), {}, {}
    edge = None
    for kind in Time:
        try:
            local[kind] = local_margin(study, **walk, kind=kind)
        except ConfigError as error:
            silent[kind.value] = error.rule
    if Time.SAMPLED in local and over == MU:
        middle = study.override({**{name: law.median for name, law in study.laws.items()}, "draws": 1})
        edge = local_margin(middle, **walk).dataset["critical"].values[0]
    found = {}
    try:
        values = time_constants(study, over, bounds)
        after = SETTLED * study.config.loop.duration
        for name, loop in {kind_of(study, "controller"): study, **(rivals or {})}.items():
            found[name] = chattering(loop, values, push=PUSH, after=after)
    except ConfigError as error:
        silent[OSCILLATIONS] = error.rule
    edge = None if edge is None or np.isnan(edge) else float(edge)
    return Beside(performance, local, found, edge, silent, time.perf_counter() - began)


def time_constants(study: Study, over: str, bounds: tuple[float, float]) -> list[float]:
    """Time constants within the walk that the clock resolves.

    Raises:
        ConfigError: there are none, or the walk is not over a lag's mu.
    """
    if over != MU or kind_of(study, "unmodelled") != "lag" or len(study.loop.channels) > 1:
        raise ConfigError(over, "describing functions are of a lag's mu, on a plant of one channel")
    least, most = max(min(bounds), FINEST * study.config.loop.sample_time), max(bounds)
    if least >= most:
        raise ConfigError(over, f"the clock would chatter rather than the lag: T_s exceeds {most / FINEST:g} s, mu/20")
    return np.geomspace(least, most, VALUES).tolist()
