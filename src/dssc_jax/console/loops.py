"""Print classical margins of the linearised loop: those of the draws, and their worst case."""

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from dssc_jax.analyses.loop_margins import LoopMargins
from dssc_jax.analyses.loop_margins.designed import DesignedMargins
from dssc_jax.analyses.loop_margins.result import LoopStatistics, MultiloopStatistics
from dssc_jax.analyses.worst_loop import WorstLoop
from dssc_jax.analyses.worst_loop.result import LoopWorst, MultiloopWorst
from dssc_jax.console.terminal import show_files, show_head, show_line, show_paragraph, show_table, values_text
from dssc_jax.engine.linearisation.operating_points import EQUILIBRIUM
from dssc_jax.statistics import wilks_draws
from dssc_jax.study import Described, Study

ROUNDING = 1e-6
"""Largest relative difference between the margins of two break points that counts as rounding."""
HIGH_USE = 0.9
"""If the search used more than this share of its points, the option ``--points`` is suggested."""


def decibels(factor: float) -> str:
    """Format a gain margin as a factor and in decibels; "none" for 0."""
    return f"{factor:.4g} ({20.0 * math.log10(factor):.3g} dB)" if factor > 0.0 else "none"


def degrees(angle: float) -> str:
    """Format an angle [rad] in degrees."""
    return f"{math.degrees(angle):.3g} deg"


def seconds(value: float) -> str:
    """Format a time [s]."""
    return f"{value:.4g} s"


def radians_per_second(value: float) -> str:
    """Format a frequency [rad/s]."""
    return f"{value:.4g} rad/s"


def ratio(value: float) -> str:
    """Format a number without a unit."""
    return f"{value:.3g}"


MARGIN_ROWS: dict[str, tuple[str, Callable[[float], str]]] = {
    "gain_upper": ("gain margin", decibels),
    "gain_lower": ("lower gain margin", decibels),
    "phase": ("phase margin", degrees),
    "delay": ("delay margin", seconds),
    "disk": ("disk margin", ratio),
    "sensitivity_peak": ("peak sensitivity M_s", ratio),
    "complementary_peak": ("peak complementary M_t", ratio),
    "crossover": ("crossover", radians_per_second),
    "bandwidth": ("bandwidth", radians_per_second),
}
"""Title of each margin's row, and the function that formats its values."""


def margin_lines(margins: DesignedMargins) -> list[str]:
    """Lines on the gain, phase and delay margins of a designed loop, and on its crossings."""
    reduction = f", lower {decibels(margins.gain_lower_margin)}" if margins.gain_lower_margin > 0.0 else ""
    lines = [f"gain margin {margin_text(margins.gain_margin, decibels)}{reduction}"]
    if not margins.gain_crossovers:
        return [*lines, "the loop gain is never 1, so there is no phase or delay margin"]
    phase_margin = f"{degrees(margins.phase_margin)} at {radians_per_second(margins.phase_margin_at)}"
    lines.append(f"phase margin {phase_margin}, delay margin {margin_text(margins.delay_margin, seconds)}")
    if len(margins.gain_crossovers) > 1:
        lines.append(f"the loop gain is 1 at {crossings_text(margins.gain_crossovers)}")
    if len(margins.phase_crossings) > 1:
        lines.append(f"the phase is -180 degrees at {crossings_text(margins.phase_crossings)}")
    return lines


def crossings_text(frequencies: Sequence[float]) -> str:
    """Format the frequencies [rad/s] of several crossings."""
    texts = ", ".join(f"{frequency:.4g}" for frequency in frequencies)
    return f"{len(frequencies)} frequencies: {texts} rad/s"


def show_loop(margins: LoopMargins, files: list[Path]) -> None:
    """Print a table of margins for each operating point and break point.

    Args:
        margins: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = margins.answer
    draws = answer.draws
    show_head(margins.study.name, f"{draws} draws, T_s = {answer.sample_time:g} s")
    share = f"{100 * answer.share:g} % of all draws"
    confidence = f"{100 * answer.confidence:g} %"
    least_draws = wilks_draws(answer.share, answer.confidence)
    for point, loops in answer.operating_points.items():
        place = "at the equilibrium" if point == EQUILIBRIUM else f"at {point}"
        for names, statistics in merged_break_points(loops).items():
            title = f"{' and '.join(names)}, {place}: {statistics.stable} of {draws} stable"
            head = (title, "median", f"{share}, confidence {confidence}", "worst drawn")
            show_table(head, margin_rows(statistics))
            reason = no_margins_text(statistics, draws, least_draws, f"{share} with {confidence} confidence")
            if reason:
                show_line(reason)
        if point in answer.multiloop:
            show_line(multiloop_text(answer.multiloop[point], place))
    show_line(f"taken where there is no derivative: {answer.taken}")
    if set(answer.operating_points) == {EQUILIBRIUM} and not has_linear_plant(margins.study):
        text = "margins hold at the equilibrium; where the plant is not linear, --at T1,T2 takes them along the flight"
        show_line(text)
    if draws < least_draws:
        show_paragraph(f"a limit needs at least {least_draws} draws")
    show_files(files)


def merged_break_points(loops: Mapping[str, LoopStatistics]) -> dict[tuple[str, ...], LoopStatistics]:
    """Merge break points with equal statistics, such as those of a controller that reads y alone.

    Args:
        loops: Statistics over the draws, by break point.

    Returns:
        The statistics, by the names of all break points that have them.
    """
    merged: dict[tuple[str, ...], LoopStatistics] = {}
    unmerged = list(loops)
    while unmerged:
        first, *later = unmerged
        equal = [name for name in later if have_equal_margins(loops[first], loops[name])]
        merged[first, *equal] = loops[first]
        unmerged = [name for name in later if name not in equal]
    return merged


def have_equal_margins(first: LoopStatistics, second: LoopStatistics) -> bool:
    """Whether two break points have the same statistics over the draws, up to rounding."""
    if (first.stable, first.no_operating_point) != (second.stable, second.no_operating_point):
        return False
    numbers = []
    for statistics in (first, second):
        margins = statistics.margins.values()
        numbers.append([(margin.median, margin.tolerance_limit, margin.worst) for margin in margins])
    return bool(np.allclose(*numbers, rtol=ROUNDING, atol=0.0, equal_nan=True))


def margin_rows(statistics: LoopStatistics) -> list[tuple[str, ...]]:
    """One row for each margin of a loop: title, median, tolerance limit and worst value over the draws."""
    rows = []
    for name, (title, format_value) in MARGIN_ROWS.items():
        margin = statistics.margins[name]
        cells = [margin_text(value, format_value) for value in (margin.median, margin.tolerance_limit, margin.worst)]
        rows.append((title, *cells))
    return rows


def multiloop_text(statistics: MultiloopStatistics, place: str) -> str:
    """Describe the disk margin for perturbations of all commands at once.

    Args:
        statistics: The margin's statistics over the draws, and the smallest destabilising perturbation found.
        place: The operating point.
    """
    margin = statistics.margin
    median = margin_text(margin.median, ratio)
    limit = margin_text(margin.tolerance_limit, ratio)
    worst = margin_text(margin.worst, ratio)
    text = f"all commands at once, {place}: disk margin median {median}, limit {limit}, worst drawn {worst}"
    if not math.isfinite(margin.worst) or not math.isfinite(statistics.found):
        return text
    cause = f"a perturbation of {ratio(statistics.found)} makes a loop oscillate at {statistics.frequency:.3g} rad/s"
    return f"{text}; {cause}: {factors_text(statistics.factors, statistics.phases)}"


def factors_text(gains: Mapping[str, float], phases: Mapping[str, float]) -> str:
    """Format the complex factors of a perturbation: gain and phase [rad] by channel."""
    return ", ".join(f"{channel} {gain:.3g} at {degrees(phases[channel])}" for channel, gain in gains.items())


def has_linear_plant(study: Study | Described) -> bool:
    """Whether a study's plant is declared linear, so that the margins are the same along the flight.

    A study whose code is not loaded tells nothing, and counts as nonlinear.
    """
    if isinstance(study, Described):
        return False
    plant = study.loop.plant
    return plant.linear is not None and plant.remainder is None


def no_margins_text(statistics: LoopStatistics, draws: int, least_draws: int, level: str) -> str:
    """Tell why some draws have no margin at a break point, and whether a limit exists; empty if all draws have margins.

    Args:
        statistics: Statistics of the break point.
        draws: Number of draws.
        least_draws: Number of draws that a tolerance limit needs.
        level: Share and confidence of the limit, in words.
    """
    counts = {
        "the loop is unstable": draws - statistics.stable - statistics.no_operating_point,
        "no operating point within the limits": statistics.no_operating_point,
    }
    reasons = [f"{count} of {draws} draws without margins: {cause}" for cause, count in counts.items() if count]
    if reasons and draws >= least_draws and not math.isfinite(statistics.margins["disk"].tolerance_limit):
        reasons.append(f"hence no finite limit holds for {level}")
    return "; ".join(reasons)


def margin_text(value: float, format_value: Callable[[float], str]) -> str:
    """Format a margin; a dash stands for an infinite margin, and for NaN, a loop without margins.

    Args:
        value: The margin.
        format_value: Formats a finite margin.
    """
    return format_value(value) if math.isfinite(value) else "-"


def show_worst_loop(worst: WorstLoop, files: list[Path]) -> None:
    """Print the worst margins at each break point: drawn, found by the search, and bounded over the box of the laws.

    Args:
        worst: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = worst.answer
    show_head(worst.study.name, worst.headline)
    for broken_at, loop in answer.loops.items():
        rows = []
        for name, margin in loop.margins.items():
            title, format_value = MARGIN_ROWS[name]
            cells = [margin_text(value, format_value) for value in (margin.drawn, margin.found, margin.bounded)]
            rows.append((title, *cells, values_text(margin.numbers)))
        head = (broken_at, f"worst of {answer.draws} draws", "worst found", "bounded", "found at")
        show_table(head, rows)
        show_line(growth_text(loop))
    for commands, worst_of_all in answer.multiloop.items():
        show_line(worst_multiloop_text(commands, worst_of_all, answer.draws))
    effort = f"{answer.points:,} of at most {answer.most_points:,} points of the box were linearised"
    if answer.points >= HIGH_USE * answer.most_points:
        effort += "; --points raises the number, and may find worse values and nearer bounds"
    show_line(effort)
    cut_names = [name for name, side in answer.box.items() if side.cut]
    ends = f"; cut at {answer.sigma:g} sigma: {', '.join(cut_names)}" if cut_names else ""
    ranges = ", ".join(f"{name} in [{side.low:.6g}, {side.high:.6g}]" for name, side in answer.box.items())
    show_line(f"box: {ranges}{ends}")
    show_line(f"taken where there is no derivative: {answer.taken}")
    show_files(files)


def worst_multiloop_text(commands: str, worst: MultiloopWorst, draws: int) -> str:
    """Describe the worst disk margin for perturbations of all commands at once.

    Args:
        commands: Names of the commands, in words.
        worst: Worst case over the box of the laws.
        draws: Number of draws.
    """
    bound = f"no bound after {worst.cells} cells"
    if math.isfinite(worst.bounded):
        bound = f"bounded by {ratio(worst.bounded)}"
    text = (
        f"{commands} at once: disk margin {ratio(worst.drawn)} in the worst of {draws} draws, worst found "
        f"{ratio(worst.found)}, {bound}; found at {values_text(worst.numbers)}"
    )
    if worst.found == 0.0:
        return f"{text}, where a loop is unstable"
    factors = factors_text(worst.factors, worst.phases)
    return f"{text}; there the loop oscillates at {worst.frequency:.3g} rad/s with {factors}"


def growth_text(loop: LoopWorst) -> str:
    """Tell by which factor the box of the laws may grow before a loop is unstable."""
    if loop.unstable:
        defect = "unstable" if loop.has_operating_point else "without an operating point within its limits"
        nearest = f"; {defect} from {loop.growth_found:.4g} times its size on, at {values_text(loop.unstable)}"
    else:
        nearest = f"; no unstable loop was found up to {loop.growable:.4g} times its size"
    if loop.growth_bounded == 0.0:
        return f"robust stability: nothing is bounded after {loop.cells} cells{nearest}"
    return f"robust stability: stable up to {loop.growth_bounded:.4g} times the box{nearest}"
