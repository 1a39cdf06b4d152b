"""Classical margins of all draws: their statistics and answer."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Annotated, NamedTuple

import numpy as np
from matplotlib.figure import Figure

import dssc_jax.plotting as plotting
from dssc_jax.core.quantities import Quantity
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.fields import MERGED
from dssc_jax.statistics import CONFIDENCE, clopper_pearson, quantile_interval, tolerance_limits
from dssc_jax.statistics.order import upper_quantiles

SHARE_WITHIN = 0.95  # share of all draws within the tolerance limit

MARGIN_UNIT = "that of the margin"


class Status(IntEnum):
    """Whether the linearised loop of a draw has margins: only a stable loop has."""

    STABLE = 0
    UNSTABLE = 1
    NO_OPERATING_POINT = 2  # or the operating point is beyond a limit, where the loop is open


class MarginKind(NamedTuple):
    """A kind of classical margin, such as the phase margin.

    Args:
        unit: Unit of the margin.
        meaning: Its name in words.
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
"""The margins that are computed for every draw, operating point and break point, by name."""


@dataclass(frozen=True)
class MarginStatistics:
    """The statistics of one margin over all draws, at one break point and one operating point."""

    unit: Annotated[str, Quantity("", "unit of the margin")]
    median: Annotated[float, Quantity(MARGIN_UNIT, "median; None: infinite, or the loop is unstable")]
    median_interval: Annotated[tuple[float, float], Quantity(MARGIN_UNIT, "interval of the median")]
    worst: Annotated[float, Quantity(MARGIN_UNIT, "worst of all draws; None: a loop is unstable, or all are infinite")]
    tolerance_limit: Annotated[float, Quantity(MARGIN_UNIT, "limit that holds for the share of all draws (Wilks)")]
    side: Annotated[str, Quantity("", "side of the limit: lower if large margins are good, upper if small ones are")]


@dataclass(frozen=True)
class LoopStatistics:
    """How many draws have a stable loop, and statistics of their margins, at one break point and operating point.

    In JSON the entries of ``margins`` are merged into this object, each under the name of the margin.
    """

    stable: Annotated[int, Quantity("1", "draws with a stable loop")]
    stable_interval: Annotated[tuple[float, float], Quantity("1", "interval of their share of all draws")]
    no_operating_point: Annotated[int, Quantity("1", "draws without an operating point within the limits")]
    margins: dict[str, MarginStatistics] = field(metadata={MERGED: True})


@dataclass(frozen=True)
class MultiloopStatistics:
    """Statistics of the disk margin of all loops at once, and its worst perturbation, at one operating point."""

    margin: Annotated[MarginStatistics, Quantity("1", "alpha that is guaranteed: an upper bound of mu by D-scales")]
    found: Annotated[float, Quantity("1", "worst alpha of a perturbation that makes a loop singular; None: unstable")]
    frequency: Annotated[float, Quantity("rad/s", "critical frequency of that draw")]
    factors: Annotated[dict[str, float], Quantity("1", "gain of that perturbation in each channel")]
    phases: Annotated[dict[str, float], Quantity("rad", "phase of that perturbation in each channel")]


@dataclass(frozen=True)
class LoopMarginsAnswer:
    """Classical margins over all draws, at every operating point and break point."""

    draws: Annotated[int, Quantity("1", "number of draws")]
    sample_time: Annotated[float, Quantity("s", "sample time T_s")]
    share: Annotated[float, Quantity("1", "share of all draws for which a tolerance limit holds")]
    confidence: Annotated[float, Quantity("1", "confidence of each limit and interval")]
    limits: Annotated[str, Quantity("", "how the limits are computed")]
    taken: Annotated[str, Quantity("", "what is taken for parts of the loop without a derivative")]
    loops: Annotated[dict[str, LoopStatistics], Quantity("", "by break point, at the first operating point")]
    operating_points: Annotated[
        dict[str, dict[str, LoopStatistics]], Quantity("", "by operating point and break point")
    ]
    multiloop: Annotated[
        dict[str, MultiloopStatistics],
        Quantity("", "by operating point, all commands perturbed at once; empty for a single command"),
    ]
    seconds: Annotated[float, Quantity("s", "computing time")]


@dataclass(eq=False)
class LoopMargins(Analysis):
    """Classical margins of every draw's linearised loop.

    The dataset has along ``operating_point``, ``loop`` (the break point) and ``draw`` the variables of
    :data:`MARGIN_KINDS` and ``status`` (a :class:`Status`). Along ``frequency`` and ``level`` it has quantiles over the
    draws of the loop gain, its phase and both sensitivities, and along ``frequency`` and ``line`` the loop transfer
    function of some draws. Where several commands have an effect, ``multiloop_disk`` is the disk margin of all of them
    perturbed at once. ``multiloop_found`` is the size alpha of a perturbation found that makes the loop oscillate, with
    its ``multiloop_frequency`` and, along ``channel``, its ``multiloop_gain`` and ``multiloop_phase``.

    Args:
        times: Times of the operating points [s]; empty: the equilibrium.
        taken: The smooth substitutes that were taken for parts of the loop without a derivative, in words.
        seconds: Computing time [s].
    """

    kind = "loop"
    title = "Classical margins"
    table = ("operating_point", "loop", "draw")

    times: tuple[float, ...]
    taken: tuple[str, ...]
    seconds: float

    def values(self, name: str, point: str, loop: str) -> np.ndarray:
        """One margin of every draw, shape (draws,).

        A draw without a stable loop has the worst value, -inf or inf. If the response of a stable loop has no crossing
        that would define the margin, the margin is inf (``gain_lower``: 0).

        Args:
            name: Name of the margin.
            point: Name of the operating point.
            loop: Name of the break point.
        """
        data = self.dataset.sel(operating_point=point, loop=loop)
        worst = -np.inf if MARGIN_KINDS[name].side == "lower" else np.inf
        values = np.where(data["status"].values == Status.STABLE, data[name].values, worst)
        return np.where(np.isnan(values), np.inf, values)

    def statistics(self, point: str, loop: str) -> LoopStatistics:
        """Number of stable loops, and median, worst case and tolerance limit of every margin.

        Args:
            point: Name of the operating point.
            loop: Name of the break point.
        """
        status = self.dataset["status"].sel(operating_point=point, loop=loop).values
        stable = int(np.count_nonzero(status == Status.STABLE))
        low, high = clopper_pearson(stable, len(status))
        margins = {}
        for name, kind in MARGIN_KINDS.items():
            margins[name] = margin_statistics(self.values(name, point, loop), kind)
        return LoopStatistics(
            stable=stable,
            stable_interval=(low, high),
            no_operating_point=int(np.count_nonzero(status == Status.NO_OPERATING_POINT)),
            margins=margins,
        )

    def multiloop(self, point: str) -> MultiloopStatistics:
        """Statistics of the disk margin of all loops at once, at one operating point.

        Args:
            point: Name of the operating point.
        """
        data = self.dataset.sel(operating_point=point)
        guaranteed = data["multiloop_disk"].values
        attained = data["multiloop_found"].values
        margins = np.where(np.isnan(guaranteed), -np.inf, guaranteed)  # an unstable loop has the worst margin
        attained_margins = np.where(np.isnan(attained), np.inf, attained)  # an unstable loop has no perturbation
        worst = data.isel(draw=int(np.argmin(attained_margins)))
        channels = list(map(str, data["channel"].values))
        return MultiloopStatistics(
            margin=margin_statistics(margins, MARGIN_KINDS["disk"]),
            found=float(attained_margins.min()),
            frequency=float(worst["multiloop_frequency"]),
            factors=dict(zip(channels, worst["multiloop_gain"].values.tolist(), strict=True)),
            phases=dict(zip(channels, worst["multiloop_phase"].values.tolist(), strict=True)),
        )

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
        """Phase and delay margin at the first break point and the worst operating point, in one line."""
        first = self.loops[0]
        by_point = [self.statistics(point, first) for point in self.points]
        worst = min(by_point, key=lambda statistics: statistics.margins["disk"].tolerance_limit)
        phase = worst.margins["phase"]
        delay = worst.margins["delay"]
        draws = self.dataset.sizes["draw"]
        if not np.isfinite(phase.tolerance_limit) or not np.isfinite(delay.tolerance_limit):
            return f"broken at {first}: {worst.stable} of {draws} linearised loops are stable"
        return (
            f"broken at {first}: phase margin {np.degrees(phase.median):.3g} deg, delay margin "
            f"{delay.median:.3g} s (medians); 95 % of all draws have at least "
            f"{np.degrees(phase.tolerance_limit):.3g} deg and {delay.tolerance_limit:.3g} s"
        )

    def figure(self) -> Figure:
        """Plot Bode and Nyquist diagrams, sensitivities, and the distributions of phase and delay margin."""
        return plotting.loop_margins(self)

    @property
    def answer(self) -> LoopMarginsAnswer:
        """Statistics at every operating point and break point, as ``summary.json`` has them."""
        operating_points = {}
        for point in self.points:
            operating_points[point] = {loop: self.statistics(point, loop) for loop in self.loops}
        return LoopMarginsAnswer(
            draws=self.dataset.sizes["draw"],
            sample_time=self.study.config.loop.sample_time,
            share=SHARE_WITHIN,
            confidence=CONFIDENCE,
            limits="Wilks; each limit holds with this confidence for itself",
            taken="; ".join(self.taken) or "none; every part has a derivative",
            loops=operating_points[self.points[0]],
            operating_points=operating_points,
            multiloop={point: self.multiloop(point) for point in self.points if "multiloop_disk" in self.dataset},
            seconds=self.seconds,
        )


def margin_statistics(values: np.ndarray, kind: MarginKind) -> MarginStatistics:
    """Median, worst case and tolerance limit of one margin over the draws.

    Args:
        values: The margin of every draw, shape (draws,), as :meth:`LoopMargins.values` returns it.
        kind: The kind of margin.
    """
    lower_limit, upper_limit = tolerance_limits(values, SHARE_WITHIN, CONFIDENCE, kind.side)
    large_is_good = kind.side == "lower"
    (median,) = upper_quantiles(values, [0.5])
    return MarginStatistics(
        unit=kind.unit,
        median=float(median),
        median_interval=quantile_interval(values, 0.5),
        worst=float(values.min() if large_is_good else values.max()),
        tolerance_limit=lower_limit if large_is_good else upper_limit,
        side=kind.side,
    )
