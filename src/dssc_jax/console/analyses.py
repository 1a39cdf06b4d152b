"""Print comparisons of controllers, sensitivities, and failure probabilities from strata or of rare events."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dssc_jax.analyses.comparison import Comparison
from dssc_jax.analyses.comparison.compare import ComparisonAnswer
from dssc_jax.analyses.comparison.contest import ContestAnswer
from dssc_jax.analyses.probability import FailureProbability
from dssc_jax.analyses.rare_events.rare import RareAnswer, RareEvent
from dssc_jax.analyses.sensitivity import Sensitivity
from dssc_jax.analyses.sensitivity.result import SensitivityAnswer
from dssc_jax.console.terminal import (
    number_text,
    output,
    show_files,
    show_head,
    show_line,
    show_pairs,
    show_paragraph,
    show_required,
    show_table,
)
from dssc_jax.results.summary import largest_count

MOST_FACTORS = 3
"""Largest number of factors printed for a required metric."""


def show_comparison(comparison: Comparison, files: list[Path]) -> None:
    """Print the failures of each controller and the difference of each pair, before and after a tuning.

    Without a tuning there are only those before. The gains before tuning are the given ones, or those that correspond
    to the gains of DSSC (Table 2).

    Args:
        comparison: The comparison.
        files: Files that were written, whose paths are printed.
    """
    answer = comparison.answer
    show_required(comparison.study.name, answer.requirements)
    show_contest(answer.corresponding, answer, "given or corresponding gains")
    if answer.tuned:
        show_contest(answer.tuned.contest, answer, "tuned gains")
        for name, controller in answer.tuned.contest.controllers.items():
            if name in answer.untuned:
                continue
            untuned = answer.corresponding.controllers[name].controller
            gains = ", ".join(changed_numbers(untuned, controller.controller))
            show_line(f"{name} tuned: {gains or 'the given gains stay'}")
        show_line(f"tuning: {answer.tuned.budget}")
    for name, reason in answer.untuned.items():
        show_line(f"{name} keeps its gains: {reason}")
    show_files(files)


def show_contest(contest: ContestAnswer, answer: ComparisonAnswer, gains: str) -> None:
    """Print a table of the controllers' failures, and a table of the paired differences.

    Args:
        contest: Failures of each controller and pair, with one set of gains.
        answer: The whole answer, for requirements, draws and headline metric.
        gains: Description of the gains, which is the title of the first column.
    """
    rows = []
    head = [gains, "failures", "probability", "95 % interval", f"median {answer.headline}"]
    has_several_requirements = len(answer.requirements) > 1
    if has_several_requirements:
        head.append("most violated")
    for name, controller in contest.controllers.items():
        low, high = controller.interval
        probability = f"{controller.probability:.4g}" if controller.failures else f"<= {high:.3g}"
        median = number_text(controller.median.get(answer.headline), ".4g")
        row = [name, f"{controller.failures}/{answer.draws}", probability, f"[{low:.3g}, {high:.3g}]", median]
        if has_several_requirements:
            row.append(largest_count(controller.violations))
        rows.append(row)
    show_table(head, rows)
    show_pairs(contest.pairs, "failure probability, paired", "exact McNemar")


def changed_numbers(untuned: Mapping[str, object], tuned: Mapping[str, object], path: str = "") -> list[str]:
    """List the numbers of a controller's table that tuning has changed, as ``name = number``.

    Args:
        untuned: The table before tuning.
        tuned: The table after tuning.
        path: Dotted name of the table with a final dot; empty for the outermost table.
    """
    numbers = []
    for name, value in tuned.items():
        if isinstance(value, Mapping):
            untuned_part = untuned.get(name)
            untuned_table = untuned_part if isinstance(untuned_part, Mapping) else {}
            numbers += changed_numbers(untuned_table, value, f"{path}{name}.")
        elif value != untuned.get(name):
            numbers.append(f"{path}{name} = {value:.4g}")
    return numbers


def show_sensitivity(sensitivity: Sensitivity, files: list[Path]) -> None:
    """Print sensitivities of failure and of the headline metric, and the main factors of each required metric.

    The analysis's folder holds the sensitivities of all outputs.

    Args:
        sensitivity: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = sensitivity.answer
    effort = f"{answer.simulations} simulations on {answer.rows} rows"
    show_head(sensitivity.study.name, f"{answer.title}, {effort}; {100 * answer.confidence:g} % intervals")
    for name in answer.headline:
        quantities = sensitivity.outputs[name]
        if quantities is not None:
            show_output_sensitivities(name, quantities, answer)
    rows = []
    refusals = []
    required_metrics = [requirement.measure.name for requirement in sensitivity.study.requirements]
    for name in dict.fromkeys((*answer.headline, *required_metrics)):
        if name in answer.reasons:
            refusals.append(f"{name} ({answer.reasons[name]})")
        elif name not in answer.headline:
            rows.append((name, main_factors(sensitivity, name)))
    if rows:
        legend = answer.quantities[sensitivity.description.ranking].legend
        show_table(("required metric", f"depends most on ({legend})"), rows)
    if refusals:
        show_line(f"no answer: {'; '.join(refusals)}")
    show_files(files)


def show_output_sensitivities(name: str, quantities: Mapping[str, np.ndarray], answer: SensitivityAnswer) -> None:
    """Print a table of an output's sensitivities, one row for each factor, the largest first.

    The sensitivities of the first kind decide the order.

    Args:
        name: Name of the output.
        quantities: Value, low and high end of each sensitivity, by kind of sensitivity, shape (factors, 3).
        answer: The whole answer, for factors and legends.
    """
    tables = list(quantities.values())
    rows = []
    for index in np.argsort(-tables[0][:, 0], kind="stable"):
        cells = [sensitivity_text(*table[index]) for table in tables]
        rows.append((answer.factors[index], *cells))
    legends = [measure.legend for measure in answer.quantities.values()]
    show_table((name, *legends), rows)


def main_factors(sensitivity: Sensitivity, name: str) -> str:
    """Name the factors on which an output depends most, each with its sensitivity and interval.

    Factors whose interval includes 0 are left out. If no factor remains, the largest one is named.

    Args:
        sensitivity: The analysis.
        name: Name of the output.
    """
    quantities = sensitivity.outputs[name] or {}
    table = quantities[sensitivity.description.ranking]
    order = np.argsort(-table[:, 0], kind="stable")[:MOST_FACTORS]
    named = [index for index in order if table[index, 1] > 0.0]
    if not named:
        named = [order[0]]
    return ", ".join(f"{sensitivity.factors[index]} {sensitivity_text(*table[index])}" for index in named)


def sensitivity_text(value: float, low: float, high: float) -> str:
    """Format a sensitivity with its interval, and mark it if the interval extends to 0 or below.

    Args:
        value: The sensitivity.
        low: Lower end of the interval.
        high: Upper end of the interval.
    """
    return f"{value:.3g} [{low:.3g}, {high:.3g}]{'  consistent with 0' if low <= 0.0 else ''}"


def show_probability(estimate: FailureProbability, files: list[Path]) -> None:
    """Print a failure probability, the failures in each stratum, and how many plain draws would be as precise.

    Args:
        estimate: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = estimate.answer
    show_required(estimate.study.name, answer.requirements)
    show_paragraph(f"{estimate.headline} ({100 * answer.confidence:g} %, strata)")
    if not answer.reached:
        low, high = answer.interval
        remark = f"the interval has a width of {high - low:.3g}, not {answer.width:g}: the pilot expected another share"
        show_paragraph(remark)
    rows = []
    for index, draws in enumerate(answer.draws):
        cells = (f"{answer.weights[index]:.4f}", f"{draws:,}", f"{answer.failures[index]:,}")
        rows.append((str(index), *cells))
    show_table(("stratum", "probability", "draws", "failures"), rows)
    ratio = answer.plain_draws / answer.simulations
    show_paragraph(
        f"{answer.simulations:,} simulations; plain draws take {answer.plain_draws:,} for an interval as narrow, "
        f"{ratio:.1f} times as many"
    )
    show_files(files)


def show_rare(event: RareEvent, files: list[Path]) -> None:
    """Print the probability of a rare failure, the check by plain draws, the cost, and where failures lie.

    Args:
        event: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = event.answer
    estimate = answer.by_method
    plain = answer.plain
    low, high = answer.interval
    level = f"{100 * answer.confidence:g} % {answer.interval_method}"
    show_required(event.study.name, answer.requirements)
    if answer.refusal:
        show_paragraph(f"no importance sampling: {answer.refusal}")
    if estimate.probability == 0.0:
        show_paragraph("no repeat reached a failure; the splitting then says nothing of its probability")
    if plain.contradicts:
        estimate_low, estimate_high = estimate.interval
        warning = (
            f"warning: plain draws contradict the {answer.method}, which found {estimate.probability:.3g} in "
            f"[{estimate_low:.3g}, {estimate_high:.3g}]: it missed a way to failure, or its points are too few. "
            "The answer is that of the plain draws"
        )
        output().print(warning, style="bold yellow", markup=False)
    text = f"{answer.probability:.3g} in [{low:.3g}, {high:.3g}]" if answer.probability else f"<= {high:.3g}"
    show_paragraph(f"failure probability {text} ({level})")
    show_paragraph(
        f"beside it {plain.failures:,} of {plain.draws:,} plain draws failed; a failure that the search did not meet "
        f"may be as probable as {plain.interval[1]:.3g}"
    )
    if estimate.probability > 0.0:
        show_paragraph(
            f"coefficient of variation {answer.variation:.2g} by {answer.simulations:,} simulations; plain "
            f"draws would take {answer.plain_draws:,.0f}"
        )
        show_design_points(answer)
        show_failing_ranges(answer)
    if answer.in_loop_noise:
        show_paragraph("in-loop noise is redrawn with the numbers; a failure that only rare noise causes costs more")
    show_files(files)


def show_design_points(answer: RareAnswer) -> None:
    """Print each design point: its distance [sigma], its FORM and SORM probability, and its uncertain numbers.

    FORM and SORM are the first- and second-order approximations of the probability of the failures around a design
    point.
    """
    if not answer.design_points:
        return
    rows = []
    for design_point in answer.design_points:
        row = [f"{design_point.distance:.3g}"]
        for probability in (design_point.first_order, design_point.second_order):
            row.append(number_text(probability, ".3g", missing="-"))
        for value in design_point.values.values():
            row.append(f"{value:.4g}")
        rows.append(row)
    names = answer.design_points[0].values
    show_table(("design point [sigma]", "FORM", "SORM", *names), rows)
    show_paragraph("FORM and SORM approximate the failures around one design point; they have no interval")


def show_failing_ranges(answer: RareAnswer) -> None:
    """Print the median of each uncertain number, and its 5, 50 and 95 % quantiles over the draws that fail."""
    rows = []
    for name, number in answer.where.items():
        if number.failing is not None:
            rows.append((name, f"{number.median:.4g}", *(f"{value:.4g}" for value in number.failing)))
    if rows:
        show_table(("number", "median", "failing: 5 %", "median", "95 %"), rows)
