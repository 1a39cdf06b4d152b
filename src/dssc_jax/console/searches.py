"""Print searches: tuned gains, selected candidates, and the worst draw."""

import math
from pathlib import Path

from rich.markup import escape

from dssc_jax.analyses.falsification.answer import FalsifiedAnswer, LikelihoodAnswer
from dssc_jax.analyses.falsification.falsify import Falsified
from dssc_jax.analyses.selection import Selection
from dssc_jax.analyses.tuning.objective import MissedBound, Verdict
from dssc_jax.analyses.tuning.result import ObjectiveAnswer, SearchFacts, Tuned, aim_quantity, tuned_table
from dssc_jax.console.terminal import (
    number_text,
    output,
    show_files,
    show_line,
    show_paragraph,
    show_required,
    show_table,
)
from dssc_jax.study import Study

ENDED_EARLY = "ended early"
"""Printed in place of a number that does not exist because a draw ended early."""


def show_tuning(tuned: Tuned, files: list[Path]) -> None:
    """Print the tuned numbers, their evaluation on draws that were not used to tune, and how the search went.

    Args:
        tuned: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = tuned.answer
    output().print(f"[bold]{escape(tuned.study.name)}[/bold]")
    rows = [(name, f"{answer.start[name]:.6g}", f"{value:.6g}") for name, value in answer.tuned.items()]
    show_table(("tuned", "start", "result"), rows)
    show_verdict(answer.verdict.verdict, answer.objective)
    if answer.gradients:
        show_paragraph(f"gradients: {answer.gradients.text}")
    show_search(tuned.study, answer.search)
    show_files(files)


def show_selection(selection: Selection, files: list[Path]) -> None:
    """Print the selected candidates, the claim about them, and the cost.

    Args:
        selection: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = selection.answer
    show_required(selection.study.name, answer.requirements)
    show_paragraph(f"{selection.headline} ({100 * answer.confidence:g} %, all together)")
    rows = []
    for rank, candidate in enumerate(answer.chosen, start=1):
        values = (f"{value:.5g}" for value in candidate.values.values())
        rows.append((str(rank), *values, f"{candidate.failures:,} of {candidate.draws:,}"))
    show_table(("", *answer.ranges, "failed draws"), rows)
    if answer.within > answer.wanted_within:
        show_paragraph(f"the simulations did not suffice for {answer.wanted_within:g}; ask for more with --most")
    ratio = answer.equal_simulations / answer.simulations
    show_paragraph(
        f"{answer.simulations:,} simulations, {ratio:.1f} times fewer than with as many draws for every candidate; "
        f"{answer.left} candidates were left at the end"
    )
    show_paragraph(
        "the shares of failures are those on which the choice was made; `run` judges it on the study's draws"
    )
    show_files(files)


def show_verdict(verdict: Verdict, objective: ObjectiveAnswer) -> None:
    """Print objective, limits and failures at the start and at the result, on draws that were not used to tune."""
    show_table((f"on {verdict.draws} fresh draws", "start", "result", "limit"), verdict_rows(verdict, objective))
    show_paragraph(reduction_sentence(verdict))
    show_paragraph(difference_sentence(verdict))


def verdict_rows(verdict: Verdict, objective: ObjectiveAnswer) -> list[tuple[str, str, str, str]]:
    """Make the rows of a verdict's table: what is compared, its value at the start and at the result, and its limit."""
    name = f"{objective.aggregate} {objective.level:g}" if objective.aggregate == "cvar" else objective.aggregate
    start, result = verdict.objective
    rows = [(f"objective ({name})", objective_text(start), objective_text(result), "")]
    for metric, (bound, mean_at_start, mean_at_result) in verdict.limits.items():
        rows.append(
            (f"mean {metric}", objective_text(mean_at_start), objective_text(mean_at_result), f"<= {bound:.5g}")
        )
    failed_at_start, failed = verdict.failures
    rows.append(("failed draws", str(failed_at_start), str(failed), ""))
    if len(verdict.requirements) > 1:
        for text, (at_start, at_result) in verdict.requirements.items():
            rows.append((f"  violate {text}", str(at_start), str(at_result), ""))
    return rows


def reduction_sentence(verdict: Verdict) -> str:
    """State by how much the tuning reduced the objective."""
    reduction = number_text(verdict.reduction, ".1%")
    low, high = (number_text(end, ".1%") for end in verdict.reduction_interval)
    return f"reduction {reduction} in [{low}, {high}] (95 %, bootstrap over draws)"


def difference_sentence(verdict: Verdict) -> str:
    """State by how much the cost of a draw changed."""
    median, low, high = (number_text(value, "+.4g") for value in verdict.difference)
    return f"cost draw by draw, result less start: median {median} in [{low}, {high}] (95 %, exact)"


def show_search(study: Study, search: SearchFacts) -> None:
    """Print what was certified and proved, the searches for counterexamples, and how the search for gains ended."""
    if search.certified_points is not None:
        show_paragraph(f"certified: all {search.certified_points} points that were visited, by Theorem 1")
    aimed = search.aimed
    if aimed is not None:
        meaning = aim_quantity(study).meaning
        show_paragraph(f"{meaning}: {aimed.start:.4g} at the start, {aimed.result:.4g} at the result")
    if search.proved_points is not None:
        show_paragraph(f"proved: all {search.proved_points} points that were accepted, with lag and sampling")
    if search.proof is not None:
        show_line(search.proof)
    for number, hunt in enumerate(search.counterexamples, start=1):
        slack = number_text(hunt.worst.slack, ".4g", ENDED_EARLY)
        show_paragraph(f"hunt {number}: worst slack {slack} in {hunt.simulations} simulations")
    if not search.feasible:
        missed = number_text(search.violation, ".2%", "draws that end early")
        draws = tuned_table(study).validation
        show_paragraph(f"no point met every limit on the {draws:,} validation draws; the nearest misses by {missed}")
        for bound in search.missed:
            show_paragraph(f"  {missed_text(bound, draws)}")
    show_paragraph(f"{search.method}, {search.stopped}; {search.seconds:.1f} s")


def missed_text(bound: MissedBound, draws: int) -> str:
    """Tell by how much, and in how many draws, the tuned loop misses a bound.

    Args:
        bound: The bound.
        draws: Number of validation draws.
    """
    excess = number_text(bound.excess, ".4g", "an infinite amount")
    if math.isfinite(bound.excess) and bound.unit not in ("", "1"):
        excess = f"{excess} {bound.unit}"
    if bound.draws is None:
        return f"{bound.text}: missed by {excess}"
    text = f"{bound.text}: missed by {bound.draws:,} of {draws:,} draws"
    is_event = bound.unit == "" and not math.isfinite(bound.excess)  # such as "runs to its end", without an amount
    return text if is_event else f"{text}, by at most {excess}"


def objective_text(value: float | None) -> str:
    """Format a value of the objective or of a limited metric; "ended early" if None or infinite."""
    return number_text(value, ".5g", ENDED_EARLY)


def likelihood_text(likelihood: LikelihoodAnswer) -> str:
    """Tell how far a draw is from the median draw [sigma], and how likely such draws are."""
    return (
        f"at {likelihood.distance:.3g} sigma: log density {likelihood.log_density:.4g} relative to the mode; "
        f"{likelihood.mass:.5g} of all draws lie nearer"
    )


def outcome_text(answer: FalsifiedAnswer) -> str:
    """Tell whether a failure was found, how bad the worst draw is, and the cost of the search.

    The worst draw is told by the worst value of a requirement, or by how the draw ended.
    """
    worst = answer.worst
    if worst.worst_value is not None:
        value = f"{worst.worst_value} where {worst.worst_requirement} is required"
    elif worst.ending is not None:
        value = f"it {worst.ending}"
    else:
        value = ENDED_EARLY
    cost = f"{answer.simulations} simulations, {answer.seconds:.1f} s"
    if answer.failed:
        return f"it fails: {value}; the first failure came after {answer.first_failure} of {cost}"
    return f"no failure was found, which proves nothing; the worst of {cost}: {value}"


def show_falsification(falsified: Falsified, files: list[Path]) -> None:
    """Print the worst draw and the likeliest failure that were found, with their likelihoods.

    Args:
        falsified: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = falsified.answer
    show_required(falsified.study.name, answer.requirements)
    within = answer.within
    if within:
        show_paragraph(f"searched: within {within.distance:.4g} sigma, which holds {within.mass:.5g} of all draws")
    nearest = answer.nearest_failure
    columns = {"worst draw": answer.worst.witness}
    if nearest:
        columns["likeliest failure"] = nearest.witness
    rows = []
    for name, unit in answer.units.items():
        values = [f"{column[name]:.6g}" for column in columns.values()]
        rows.append((name, *values, "" if unit == "1" else unit))
    show_table(("number", *columns, ""), rows)
    show_paragraph(outcome_text(answer))
    if len(answer.worst_seen) > 1:
        values = ", ".join(f"{name}: {value}" for name, value in answer.worst_seen.items())
        show_line(f"worst seen of each requirement, in different draws: {values}")
    course = falsified.course_at(falsified.worst)
    if course:
        show_line(f"worst draw: {course}")
    if falsified.nearest_failure is not None and falsified.nearest_failure != falsified.worst:
        show_paragraph(f"likeliest failure: {falsified.course_at(falsified.nearest_failure)}")
    show_line(f"worst draw {likelihood_text(answer.worst.likelihood)}")
    if nearest:
        show_line(f"likeliest failure found {likelihood_text(nearest.likelihood)}")
    show_files(files)
