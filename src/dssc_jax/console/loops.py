"""Print classical margins: those of the draws, and their worst case."""

import math
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from rich.markup import escape

from dssc_jax.analyses.loop_margins import LoopMargins
from dssc_jax.analyses.loop_margins.designed import DesignedMargins
from dssc_jax.analyses.loop_margins.result import LoopStatistics, MultiloopStatistics
from dssc_jax.analyses.worst_loop import WorstLoop
from dssc_jax.analyses.worst_loop.result import LoopWorst, MultiloopWorst
from dssc_jax.console.terminal import output, show_files, show_table
from dssc_jax.engine.linearisation.operating_points import EQUILIBRIUM
from dssc_jax.statistics import wilks_draws
from dssc_jax.study import Described, Study

SAME = 1e-6
"""Relative difference of margins of two break points that counts as rounding."""
POINTS_SPENT = 0.9
"""Share of the points from which on more of them are suggested."""


def decibels(factor: float) -> str:
    """A gain margin as a factor and in decibels."""
    return f"{factor:.4g} ({20.0 * math.log10(factor):.3g} dB)" if factor > 0.0 else "none"


def seconds(value: float) -> str:
    """A delay margin in seconds."""
    return f"{value:.4g} s"


def ratio(value: float) -> str:
    """A number without a unit."""
    return f"{value:.3g}"


MARGIN_ROWS: dict[str, tuple[str, Callable[[float], str]]] = {
    "gain_upper": ("gain margin", decibels),
    "gain_lower": ("lower gain margin", decibels),
    "phase": ("phase margin", lambda value: f"{math.degrees(value):.3g} deg"),
    "delay": ("delay margin", seconds),
    "disk": ("disk margin", ratio),
    "sensitivity_peak": ("peak sensitivity M_s", ratio),
    "complementary_peak": ("peak complementary M_t", ratio),
    "crossover": ("crossover", lambda value: f"{value:.4g} rad/s"),
    "bandwidth": ("bandwidth", lambda value: f"{value:.4g} rad/s"),
}
"""Row of each margin and its text."""


def margin_lines(margins: DesignedMargins) -> list[str]:
    """The margins of a designed loop in words, one line each."""
    reduction = f", lower {decibels(margins.gain_lower_margin)}" if margins.gain_lower_margin > 0.0 else ""
    lines = [f"gain margin {margin_text(margins.gain_margin, decibels)}{reduction}"]
    if not margins.gain_crossovers:
        return [*lines, "the loop gain is never 1, so there is no phase or delay margin"]
    lines.append(
        f"phase margin {math.degrees(margins.phase_margin):.3g} deg at {margins.phase_margin_at:.4g} rad/s, "
        f"delay margin {margin_text(margins.delay_margin, seconds)}"
    )
    for crossings, meaning in (
        (margins.gain_crossovers, "the loop gain is 1 at"),
        (margins.phase_crossings, "the phase is -180 degrees at"),
    ):
        if len(crossings) > 1:
            frequencies = ", ".join(f"{crossing:.4g}" for crossing in crossings)
            lines.append(f"{meaning} {len(crossings)} frequencies: {frequencies} rad/s")
    return lines


def show_loop(margins: LoopMargins, files: list[Path]) -> None:
    """Print the margins of every operating point and break point."""
    answer = margins.answer
    draws = answer.draws
    console = output()
    console.print(f"[bold]{escape(margins.study.name)}[/bold]  {draws} draws, T_s = {answer.sample_time:g} s")
    share = f"{100 * answer.share:g} % of all draws"
    confidence = f"{100 * answer.confidence:g} %"
    least_draws = wilks_draws(answer.share, answer.confidence)
    for point, loops in answer.operating_points.items():
        place = "at the equilibrium" if point == EQUILIBRIUM else f"at {point}"
        for names, statistics in distinct(loops).items():
            broken_at = " and ".join(names)
            rows = []
            for name, (text, form) in MARGIN_ROWS.items():
                margin = statistics.margins[name]
                numbers = (margin.median, margin.tolerance_limit, margin.worst)
                rows.append((text, *(margin_text(number, form) for number in numbers)))
            title = f"{broken_at}, {place}: {statistics.stable} of {draws} stable"
            show_table((title, "median", f"{share}, confidence {confidence}", "worst drawn"), rows)
            reason = no_margins_text(statistics, draws, least_draws, f"{share} with {confidence} confidence")
            if reason:
                console.print(reason, markup=False, soft_wrap=True)
        if point in answer.multiloop:
            console.print(multiloop_text(answer.multiloop[point], place), markup=False, soft_wrap=True)
    console.print(f"taken where there is no derivative: {answer.taken}", markup=False, soft_wrap=True)
    if set(answer.operating_points) == {EQUILIBRIUM} and not runs_linear_plants(margins.study):
        text = "margins hold at the equilibrium; where the plant is not linear, --at T1,T2 takes them along the flight"
        console.print(text, markup=False, soft_wrap=True)
    if draws < least_draws:
        console.print(f"a limit needs at least {least_draws} draws", markup=False)
    show_files(files)


def distinct(loops: Mapping[str, LoopStatistics]) -> dict[tuple[str, ...], LoopStatistics]:
    """The statistics under the names of all break points that share them, as where a controller takes y alone."""
    groups: list[tuple[list[str], LoopStatistics]] = []
    for name, statistics in loops.items():
        group = next((names for names, margins in groups if same_margins(margins, statistics)), None)
        if group is None:
            groups.append(([name], statistics))
        else:
            group.append(name)
    return {tuple(names): statistics for names, statistics in groups}


def same_margins(first: LoopStatistics, second: LoopStatistics) -> bool:
    """Whether two break points have the same statistics over the draws, up to rounding."""
    if (first.stable, first.no_operating_point) != (second.stable, second.no_operating_point):
        return False
    numbers = []
    for statistics in (first, second):
        margins = statistics.margins.values()
        numbers.append([(margin.median, margin.tolerance_limit, margin.worst) for margin in margins])
    return bool(np.allclose(*numbers, rtol=SAME, atol=0.0, equal_nan=True))


def multiloop_text(statistics: MultiloopStatistics, place: str) -> str:
    """The disk margin of all loops at once, in words."""
    margin = statistics.margin
    numbers = ", ".join(
        f"{name} {margin_text(value, ratio)}"
        for name, value in (("median", margin.median), ("limit", margin.tolerance_limit), ("worst drawn", margin.worst))
    )
    text = f"all commands at once, {place}: disk margin {numbers}"
    if not math.isfinite(margin.worst) or not math.isfinite(statistics.found):
        return text
    factors = ", ".join(
        f"{channel} {gain:.3g} at {math.degrees(statistics.phases[channel]):.3g} deg"
        for channel, gain in statistics.factors.items()
    )
    cause = f"a perturbation of {ratio(statistics.found)} makes a loop oscillate at {statistics.frequency:.3g} rad/s"
    return f"{text}; {cause}: {factors}"


def runs_linear_plants(study: Study | Described) -> bool:
    """Whether a study's plant is known to be linear, so that its margins are the same along the flight."""
    if isinstance(study, Described):
        return False
    plant = study.loop.plant
    return plant.linear is not None and plant.remainder is None


def no_margins_text(statistics: LoopStatistics, draws: int, least_draws: int, level: str) -> str:
    """Why draws at one break point have no margin, and hence no limit may exist; empty if all have."""
    counts = {
        "the loop is unstable": draws - statistics.stable - statistics.no_operating_point,
        "no operating point within the limits": statistics.no_operating_point,
    }
    reasons = [f"{count} of {draws} draws without margins: {cause}" for cause, count in counts.items() if count]
    if reasons and draws >= least_draws and not math.isfinite(statistics.margins["disk"].tolerance_limit):
        reasons.append(f"hence no finite limit holds for {level}")
    return "; ".join(reasons)


def margin_text(value: float, form: Callable[[float], str]) -> str:
    """A margin as text; that of a loop without margins is infinite."""
    return form(value) if math.isfinite(value) else "-"


def show_worst_loop(worst: WorstLoop, files: list[Path]) -> None:
    """Print the worst margins of every break point: drawn, found and bounded."""
    answer = worst.answer
    console = output()
    console.print(f"[bold]{escape(worst.study.name)}[/bold]  {escape(worst.headline)}", soft_wrap=True)
    for broken_at, loop in answer.loops.items():
        rows = []
        for name, margin in loop.margins.items():
            text, form = MARGIN_ROWS[name]
            numbers = ", ".join(f"{number} = {value:.6g}" for number, value in margin.numbers.items())
            values = (margin.drawn, margin.found, margin.bounded)
            rows.append((text, *(margin_text(value, form) for value in values), numbers))
        head = (broken_at, f"worst of {answer.draws} draws", "worst found", "bounded", "found at")
        show_table(head, rows)
        console.print(growth_text(loop), markup=False, soft_wrap=True)
    for name, joint in answer.multiloop.items():
        console.print(worst_multiloop_text(name, joint, answer.draws), markup=False, soft_wrap=True)
    effort = f"{answer.points:,} of at most {answer.most_points:,} points of the box were linearised"
    if answer.points >= POINTS_SPENT * answer.most_points:
        effort += "; --points raises the number, and may find worse values and nearer bounds"
    console.print(effort, markup=False, soft_wrap=True)
    cut_names = [name for name, side in answer.box.items() if side.cut]
    ends = f"; cut at {answer.sigma:g} sigma: {', '.join(cut_names)}" if cut_names else ""
    ranges = ", ".join(f"{name} in [{side.low:.6g}, {side.high:.6g}]" for name, side in answer.box.items())
    console.print(f"box: {ranges}{ends}", markup=False, soft_wrap=True)
    console.print(f"taken where there is no derivative: {answer.taken}", markup=False, soft_wrap=True)
    show_files(files)


def worst_multiloop_text(name: str, worst: MultiloopWorst, draws: int) -> str:
    """The worst disk margin of all commands at once, in words."""
    bound = f"no bound after {worst.cells} cells"
    if math.isfinite(worst.bounded):
        bound = f"bounded by {ratio(worst.bounded)}"
    numbers = ", ".join(f"{number} = {value:.6g}" for number, value in worst.numbers.items())
    text = (
        f"{name} at once: disk margin {ratio(worst.drawn)} in the worst of {draws} draws, worst found "
        f"{ratio(worst.found)}, {bound}; found at {numbers}"
    )
    if worst.found == 0.0:
        return f"{text}, where a loop is unstable"
    factors = ", ".join(
        f"{channel} {gain:.3g} at {math.degrees(worst.phases[channel]):.3g} deg"
        for channel, gain in worst.factors.items()
    )
    return f"{text}; there the loop oscillates at {worst.frequency:.3g} rad/s with {factors}"


def growth_text(loop: LoopWorst) -> str:
    """How far the box may grow, in words."""
    if loop.unstable:
        numbers = ", ".join(f"{name} = {value:.6g}" for name, value in loop.unstable.items())
        defect = "unstable" if loop.has_operating_point else "without an operating point within its limits"
        nearest = f"; {defect} from {loop.growth_found:.4g} times its size on, at {numbers}"
    else:
        nearest = f"; no unstable loop was found up to {loop.growable:.4g} times its size"
    if loop.growth_bounded == 0.0:
        return f"robust stability: nothing is bounded after {loop.cells} cells{nearest}"
    return f"robust stability: stable up to {loop.growth_bounded:.4g} times the box{nearest}"
