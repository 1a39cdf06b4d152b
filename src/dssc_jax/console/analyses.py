"""Print analyses: comparisons, sensitivity, rare events."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from rich.markup import escape

from dssc_jax.analyses.comparison import Comparison
from dssc_jax.analyses.comparison.compare import ComparisonAnswer, ContestAnswer
from dssc_jax.analyses.probability import FailureProbability
from dssc_jax.analyses.rare_events.rare import RareAnswer, RareEvent
from dssc_jax.analyses.sensitivity import Sensitivity
from dssc_jax.console.terminal import number_text, output, show_files, show_pairs, show_table
from dssc_jax.results.summary import largest_count

LEADING = 3  # factors that are told of a required metric, at most


def show_comparison(comparison: Comparison, files: list[Path]) -> None:
    """Print controllers singly and in pairs, with corresponding gains (Table 2) and with tuned gains, if any."""
    answer = comparison.answer
    console = output()
    required = "; ".join(answer.requirements) or "that the draw stays finite"
    console.print(f"[bold]{escape(comparison.study.name)}[/bold]  required: {escape(required)}")
    show_contest(answer.corresponding, answer, "given or corresponding gains")
    if answer.tuned:
        show_contest(answer.tuned.contest, answer, "tuned gains")
        for name, controller in answer.tuned.contest.controllers.items():
            untuned = answer.corresponding.controllers[name].controller
            if name in answer.untuned:
                continue
            gains = ", ".join(tuned_numbers(untuned, controller.controller))
            console.print(f"{name} tuned: {gains or 'the given gains stay'}", markup=False, soft_wrap=True)
        console.print(f"tuning: {escape(answer.tuned.budget)}", soft_wrap=True)
    for name, reason in answer.untuned.items():
        console.print(f"{name} keeps its gains: {reason}", markup=False, soft_wrap=True)
    show_files(files)


def show_contest(contest: ContestAnswer, answer: ComparisonAnswer, gains: str) -> None:
    """Print one row for each controller and one for each pair."""
    rows = []
    worst = ["most violated"] if len(answer.requirements) > 1 else []
    for name, controller in contest.controllers.items():
        low, high = controller.interval
        share = f"{controller.probability:.4g}" if controller.failures else f"<= {high:.3g}"
        middle = number_text(controller.median.get(answer.headline), ".4g")
        violated = [largest_count(controller.violations)] if worst else []
        cells = (name, f"{controller.failures}/{answer.draws}", share, f"[{low:.3g}, {high:.3g}]", middle)
        rows.append((*cells, *violated))
    show_table((gains, "failures", "probability", "95 % interval", f"median {answer.headline}", *worst), rows)
    show_pairs(contest.pairs, "failure probability, paired", "exact McNemar")


def tuned_numbers(untuned: Mapping[str, object], tuned: Mapping[str, object], path: str = "") -> list[str]:
    """The numbers of a table that tuning has changed, as ``name = number``."""
    numbers = []
    for name, value in tuned.items():
        if isinstance(value, Mapping):
            untuned_part = untuned.get(name)
            numbers += tuned_numbers(untuned_part if isinstance(untuned_part, Mapping) else {}, value, f"{path}{name}.")
        elif value != untuned.get(name):
            numbers.append(f"{path}{name} = {value:.4g}")
    return numbers


def show_sensitivity(sensitivity: Sensitivity, files: list[Path]) -> None:
    """Print what failure, the headline metric and each required metric depend on; the folder has all outputs."""
    answer = sensitivity.answer
    console = output()
    console.print(
        f"[bold]{escape(sensitivity.study.name)}[/bold]  {answer.title}, {answer.simulations} simulations on "
        f"{answer.rows} rows; {100 * answer.confidence:g} % intervals"
    )
    legends = [measure.legend for measure in answer.quantities.values()]
    for name in answer.headline:
        quantities = sensitivity.outputs[name]
        if quantities is None:
            continue
        tables = list(quantities.values())
        rows = []
        for index in np.argsort(-tables[0][:, 0], kind="stable"):
            rows.append((answer.factors[index], *(interval_text(*table[index]) for table in tables)))
        show_table((name, *legends), rows)
    required = [requirement.measure.name for requirement in sensitivity.study.requirements]
    reported = dict.fromkeys((*answer.headline, *required))
    brief = [name for name in reported if name not in answer.headline and name not in answer.reasons]
    if brief:
        ranking = sensitivity.description.ranking
        legend = answer.quantities[ranking].legend
        rows = [(name, leading_factors(sensitivity, name)) for name in brief]
        show_table(("required metric", f"depends most on ({legend})"), rows)
    refusals = [f"{name} ({answer.reasons[name]})" for name in reported if name in answer.reasons]
    if refusals:
        console.print(f"no answer: {'; '.join(refusals)}", markup=False, soft_wrap=True)
    show_files(files)


def leading_factors(sensitivity: Sensitivity, name: str) -> str:
    """The factors on which an output depends most, with intervals: those beyond doubt, or else the largest."""
    quantities = sensitivity.outputs[name] or {}
    table = quantities[sensitivity.description.ranking]
    order = np.argsort(-table[:, 0], kind="stable")[:LEADING]
    clear = [index for index in order if table[index, 1] > 0.0] or order[:1]
    return ", ".join(f"{sensitivity.factors[index]} {interval_text(*table[index])}" for index in clear)


def interval_text(value: float, low: float, high: float) -> str:
    """A quantity with its interval, marked if it could be 0."""
    return f"{value:.3g} [{low:.3g}, {high:.3g}]{'  consistent with 0' if low <= 0.0 else ''}"


def show_probability(estimate: FailureProbability, files: list[Path]) -> None:
    """Print a failure probability, its strata and its cost."""
    answer = estimate.answer
    console = output()
    console.print(f"[bold]{escape(estimate.study.name)}[/bold]  required: {escape('; '.join(answer.requirements))}")
    console.print(f"{estimate.headline} ({100 * answer.confidence:g} %, strata)", markup=False)
    if not answer.reached:
        low, high = answer.interval
        remark = f"the interval has a width of {high - low:.3g}, not {answer.width:g}: the pilot expected another share"
        console.print(remark, markup=False)
    rows = []
    for index, draws in enumerate(answer.draws):
        cells = (f"{answer.weights[index]:.4f}", f"{draws:,}", f"{answer.failures[index]:,}")
        rows.append((str(index), *cells))
    show_table(("stratum", "probability", "draws", "failures"), rows)
    ratio = answer.plain_draws / answer.simulations
    console.print(
        f"{answer.simulations:,} simulations; plain draws take {answer.plain_draws:,} for an interval as narrow, "
        f"{ratio:.1f} times as many",
        markup=False,
    )
    show_files(files)


def show_rare(event: RareEvent, files: list[Path]) -> None:
    """Print the probability of a rare failure, its cost, and where the failures are."""
    answer = event.answer
    estimate = answer.by_method
    plain = answer.plain
    console = output()
    low, high = answer.interval
    level = f"{100 * answer.confidence:g} % {answer.interval_method}"
    console.print(f"[bold]{escape(event.study.name)}[/bold]  required: {escape('; '.join(answer.requirements))}")
    if answer.refusal:
        console.print(f"no importance sampling: {answer.refusal}", markup=False)
    if estimate.probability == 0.0:
        console.print("no repeat reached a failure; the splitting then says nothing of its probability", markup=False)
    if plain.contradicts:
        estimate_low, estimate_high = estimate.interval
        console.print(
            f"warning: plain draws contradict the {answer.method}, which found {estimate.probability:.3g} in "
            f"[{estimate_low:.3g}, {estimate_high:.3g}]: it missed a way to failure, or its points are too few. "
            "The answer is that of the plain draws",
            style="bold yellow",
            markup=False,
        )
    value = f"{answer.probability:.3g} in [{low:.3g}, {high:.3g}]" if answer.probability else f"<= {high:.3g}"
    console.print(f"failure probability {value} ({level})", markup=False)
    console.print(
        f"beside it {plain.failures:,} of {plain.draws:,} plain draws failed; a failure that the search did not meet "
        f"may be as probable as {plain.interval[1]:.3g}",
        markup=False,
    )
    if estimate.probability > 0.0:
        console.print(
            f"coefficient of variation {answer.variation:.2g} by {answer.simulations:,} simulations; plain "
            f"draws would take {answer.plain_draws:,.0f}",
            markup=False,
        )
        show_design_points(answer)
        show_failing_ranges(answer)
    if answer.in_loop_noise:
        console.print("in-loop noise is redrawn with the numbers; a failure that only rare noise causes costs more")
    show_files(files)


def show_design_points(answer: RareAnswer) -> None:
    """Print the design points with the approximations made there."""
    if not answer.design_points:
        return
    rows = []
    for design_point in answer.design_points:
        approximated = (design_point.first_order, design_point.second_order)
        probabilities = ("-" if np.isnan(value) else f"{value:.3g}" for value in approximated)
        values = (f"{value:.4g}" for value in design_point.values.values())
        rows.append((f"{design_point.distance:.3g}", *probabilities, *values))
    names = answer.design_points[0].values
    show_table(("design point [sigma]", "FORM", "SORM", *names), rows)
    console = output()
    console.print("FORM and SORM approximate the failures around one design point; they have no interval", markup=False)


def show_failing_ranges(answer: RareAnswer) -> None:
    """Print where the uncertain numbers lie at failures."""
    rows = []
    for name, number in answer.where.items():
        if number.failing is not None:
            rows.append((name, f"{number.median:.4g}", *(f"{value:.4g}" for value in number.failing)))
    if rows:
        show_table(("number", "median", "failing: 5 %", "median", "95 %"), rows)
