"""Classical margins of all draws: their statistics, figure and folder."""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple, Self

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.analyses.loop_margins.fans import FANS, LEVELS_OF_FAN, fan_of
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import Stored
from dssc_jax.statistics import CONFIDENCE, clopper_pearson, quantile_interval, tolerance_limits
from dssc_jax.statistics.order import upper_quantiles
from dssc_jax.study import Study

EQUILIBRIUM = "equilibrium"
SHARE_WITHIN = 0.95  # of all draws, within the tolerance limit
LINES = 60  # draws whose frequency responses are stored


class Status(IntEnum):
    """Whether a draw's linearised loop has margins."""

    STABLE = 0
    UNSTABLE = 1
    NO_OPERATING_POINT = 2


class MarginKind(NamedTuple):
    """Meaning of a classical margin.

    Args:
        unit: Its unit.
        meaning: In words.
        side: Side of the tolerance limit: ``lower`` if large values are good, ``upper`` if small ones are.
    """

    unit: str
    meaning: str
    side: str


MARGIN_KINDS = {
    "gain_upper": MarginKind("1", "gain margin: least destabilising factor above 1", "lower"),
    "gain_lower": MarginKind("1", "lower gain margin: largest destabilising factor below 1", "upper"),
    "phase": MarginKind("rad", "phase margin", "lower"),
    "delay": MarginKind("s", "delay margin", "lower"),
    "disk": MarginKind("1", "disk margin alpha", "lower"),
    "sensitivity_peak": MarginKind("1", "peak sensitivity M_s", "upper"),
    "complementary_peak": MarginKind("1", "peak complementary sensitivity M_t", "upper"),
    "crossover": MarginKind("rad/s", "gain crossover frequency", "lower"),
    "bandwidth": MarginKind("rad/s", "bandwidth of T", "lower"),
}
"""What is computed for every draw, operating point and break point."""


class LoopAnswer(NamedTuple):
    """Margins of all draws at one break point and one operating point.

    Args:
        margins: By name, each of shape (draws,); NaN for a draw without margins.
        status: A :class:`Status` for each draw.
        response: G on the common grid, shape (draws, frequencies).
        poles: Of L, shape (draws, states); NaN for a draw without an operating point.
    """

    margins: dict[str, np.ndarray]
    status: np.ndarray
    response: np.ndarray
    poles: np.ndarray


@dataclass(eq=False)
class LoopMargins(Analysis):
    """Classical margins of every draw's linearised loop.

    The dataset has along ``operating_point``, ``loop`` (the break point) and ``draw`` each of gain_upper, gain_lower,
    phase, delay, disk, sensitivity_peak, complementary_peak, crossover and bandwidth, and ``status``. Along
    ``frequency`` it has quantiles over the draws of the loop gain, its phase and both sensitivities (along ``level``),
    and the loop transfer function of some draws (along ``line``).

    Args:
        times: Times of the operating points [s]; empty: the equilibrium.
        taken: What is taken for parts of the loop that have no derivative, in words.
        seconds: Computing time.
    """

    kind = "loop"
    title = "Classical margins"
    table = ("operating_point", "loop", "draw")

    times: tuple[float, ...]
    taken: tuple[str, ...]
    seconds: float

    def values(self, name: str, point: str, loop: str) -> np.ndarray:
        """A margin of every draw; a draw without margins has the worst value. Shape (draws,)."""
        own = self.dataset.sel(operating_point=point, loop=loop)
        worst = -np.inf if MARGIN_KINDS[name].side == "lower" else np.inf
        values = np.where(own["status"].values == Status.STABLE, own[name].values, worst)
        return np.where(np.isnan(values), np.inf, values)  # stable, and never with this crossing

    def statistics(self, point: str, loop: str) -> dict[str, Any]:
        """Quantiles of every margin with exact limits at one break point."""
        status = self.dataset["status"].sel(operating_point=point, loop=loop).values
        stable = int(np.count_nonzero(status == Status.STABLE))
        summary: dict[str, Any] = {
            "stable": stable,
            "stable_interval": clopper_pearson(stable, len(status))[0:2],
            "no_operating_point": int(np.count_nonzero(status == Status.NO_OPERATING_POINT)),
        }
        for name, about in MARGIN_KINDS.items():
            values = self.values(name, point, loop)
            limits = tolerance_limits(values, SHARE_WITHIN, CONFIDENCE, about.side)
            summary[name] = {
                "unit": about.unit,
                "median": float(upper_quantiles(values, [0.5])[0]),
                "median_interval": quantile_interval(values, 0.5),
                "worst": float(values.min() if about.side == "lower" else values.max()),
                "tolerance_limit": limits[0] if about.side == "lower" else limits[1],
                "side": about.side,
            }
        return summary

    @property
    def points(self) -> list[str]:
        """Names of the operating points."""
        return list(map(str, self.dataset["operating_point"].values))

    @property
    def loops(self) -> list[str]:
        """Names of the break points."""
        return list(map(str, self.dataset["loop"].values))

    @property
    def headline(self) -> str:
        """The answer in one line."""
        first = self.loops[0]
        smallest = [self.statistics(point, first) for point in self.points]
        own = min(smallest, key=lambda each: each["disk"]["tolerance_limit"])
        phase, delay = own["phase"], own["delay"]
        draws = self.dataset.sizes["draw"]
        if not np.isfinite(phase["tolerance_limit"]) or not np.isfinite(delay["tolerance_limit"]):
            return f"broken at {first}: {own['stable']} of {draws} linearised loops are stable"
        return (
            f"broken at {first}: phase margin {np.degrees(phase['median']):.3g} deg, delay margin "
            f"{delay['median']:.3g} s (medians); 95 % of all draws have at least "
            f"{np.degrees(phase['tolerance_limit']):.3g} deg and {delay['tolerance_limit']:.3g} s"
        )

    def figure(self) -> Figure:
        """Plot the answer."""
        return plotting.loop_margins(self)

    def content(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        every = {point: {loop: self.statistics(point, loop) for loop in self.loops} for point in self.points}
        return {
            "draws": self.dataset.sizes["draw"],
            "sample_time": self.study.config.loop.sample_time,
            "share": SHARE_WITHIN,
            "confidence": CONFIDENCE,
            "limits": "Wilks; each limit holds with this confidence for itself",
            "taken": "; ".join(self.taken) or "none; every part has a derivative",
            "loops": every[self.points[0]],
            "operating_points": every,
            "seconds": self.seconds,
        }

    def settings(self) -> dict[str, Any]:
        """See :class:`Analysis`."""
        return {"times": list(self.times), "taken": list(self.taken), "seconds": self.seconds}

    @classmethod
    def restored(cls, stored: Stored) -> Self:
        """See :class:`Analysis`."""
        settings = stored.settings
        times, taken = tuple(settings["times"]), tuple(settings["taken"])
        return cls(stored.study, stored.dataset, times, taken, settings["seconds"])


def margins_dataset(
    study: Study, answers: Mapping[str, Mapping[str, LoopAnswer]], frequencies: np.ndarray
) -> xr.Dataset:
    """The dataset of :class:`LoopMargins`.

    Args:
        study: The study.
        answers: By operating point and break point.
        frequencies: Of the responses [rad/s].
    """
    points = list(answers)
    loops = list(dict.fromkeys(loop for own in answers.values() for loop in own))
    draws, shape = study.config.draws, (len(points), len(loops))
    blank = LoopAnswer(
        {name: np.full(draws, np.nan) for name in MARGIN_KINDS},
        np.full(draws, Status.NO_OPERATING_POINT.value),
        np.full((draws, frequencies.size), np.nan, complex),
        np.full((draws, 0), np.nan, complex),
    )
    every = [answers[point].get(loop, blank) for point in points for loop in loops]
    angles = frequencies * study.config.loop.sample_time
    columns: dict[str, Any] = {}
    for name, about in MARGIN_KINDS.items():
        values = np.stack([one.margins[name] for one in every]).reshape(*shape, draws)
        columns[name] = (LoopMargins.table, values, {"units": about.unit, "long_name": about.meaning})
    flags = {"flag_values": [s.value for s in Status], "flag_meanings": " ".join(s.name.lower() for s in Status)}
    status = np.stack([one.status for one in every]).reshape(*shape, draws)
    columns["status"] = (LoopMargins.table, status, {"long_name": "whether the loop has margins", **flags})
    with np.errstate(all="ignore"):
        fans = [fan_of(one.response, one.poles, angles) for one in every]
        shown = np.stack([(-one.response / (1.0 + one.response))[:LINES] for one in every])
    for name, (unit, meaning) in FANS.items():
        values = np.stack([fan[name] for fan in fans]).reshape(*shape, len(LEVELS_OF_FAN), -1)
        dims = (*LoopMargins.table[:2], "level", "frequency")
        columns[name] = (dims, values, {"units": unit, "long_name": f"{meaning}, quantile over the draws"})
    for name, part in (("loop_real", shown.real), ("loop_imaginary", shown.imag)):
        values = part.reshape(*shape, -1, frequencies.size)
        meaning = f"{name.removeprefix('loop_')} part of the loop transfer function L"
        columns[name] = ((*LoopMargins.table[:2], "line", "frequency"), values, {"units": "1", "long_name": meaning})
    coords = {
        "operating_point": ("operating_point", np.array(points), {"long_name": "where the loop is linearised"}),
        "loop": ("loop", np.array(loops), {"long_name": "where the loop is broken"}),
        "draw": ("draw", np.arange(draws), {"long_name": "draw index"}),
        "level": ("level", np.array(LEVELS_OF_FAN), {"units": "1", "long_name": "level of the quantile"}),
        "frequency": ("frequency", frequencies, {"units": "rad/s", "long_name": "frequency"}),
    }
    return xr.Dataset(columns, coords=coords, attrs={"title": study.name})
