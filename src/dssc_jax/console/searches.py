"""Print searches: tuned gains, and the worst draw."""

import math
from pathlib import Path

from rich.markup import escape

from dssc_jax.analyses.falsification.falsify import Falsified, LikelihoodAnswer
from dssc_jax.analyses.selection import Selection
from dssc_jax.analyses.tuning.objective import MissedBound, Verdict
from dssc_jax.analyses.tuning.result import ObjectiveAnswer, SearchFacts, Tuned, aim_quantity, tuned_table
from dssc_jax.console.terminal import number_text, output, show_files, show_table
from dssc_jax.study import Study

ENDED = "ended early"


def show_tuning(tuned: Tuned, files: list[Path]) -> None:
    """Print the tuned numbers and their evaluation on fresh draws."""
    answer = tuned.answer
    console = output()
    console.print(f"[bold]{escape(tuned.study.name)}[/bold]")
    rows = [(name, f"{answer.start[name]:.6g}", f"{value:.6g}") for name, value in answer.tuned.items()]
    show_table(("tuned", "start", "result"), rows)
    show_verdict(answer.verdict.verdict, answer.objective)
    if answer.gradients:
        console.print(f"gradients: {answer.gradients.text}")
    show_search(tuned.study, answer.search)
    show_files(files)


def show_selection(selection: Selection, files: list[Path]) -> None:
    """Print the chosen candidates, what is claimed of them, and the cost."""
    answer = selection.answer
    console = output()
    console.print(f"[bold]{escape(selection.study.name)}[/bold]  required: {escape('; '.join(answer.requirements))}")
    console.print(f"{selection.headline} ({100 * answer.confidence:g} %, all together)", markup=False)
    rows = []
    for place, candidate in enumerate(answer.chosen):
        values = (f"{value:.5g}" for value in candidate.values.values())
        rows.append((str(place + 1), *values, f"{candidate.failures:,} of {candidate.draws:,}"))
    show_table(("", *answer.ranges, "failed draws"), rows)
    if answer.within > answer.wanted_within:
        console.print(f"the simulations did not suffice for {answer.wanted_within:g}; ask for more with --most")
    ratio = answer.equal_simulations / answer.simulations
    console.print(
        f"{answer.simulations:,} simulations, {ratio:.1f} times fewer than with as many draws for every candidate; "
        f"{answer.left} candidates were left at the end"
    )
    console.print("the shares of failures are those on which the choice was made; `run` judges it on the study's draws")
    show_files(files)


def show_verdict(verdict: Verdict, objective: ObjectiveAnswer) -> None:
    """Print start and result on fresh draws."""
    console = output()
    name = f"{objective.aggregate} {objective.level:g}" if objective.aggregate == "cvar" else objective.aggregate
    start, result = verdict.objective
    rows = [(f"objective ({name})", number_text(start, ".5g", ENDED), number_text(result, ".5g", ENDED), "")]
    for metric, (bound, start, result) in verdict.limits.items():
        means = (number_text(start, ".5g", ENDED), number_text(result, ".5g", ENDED))
        rows.append((f"mean {metric}", *means, f"<= {bound:.5g}"))
    failed_at_start, failed = verdict.failures
    rows.append(("failed draws", str(failed_at_start), str(failed), ""))
    if len(verdict.requirements) > 1:
        for text, (at_start, at_result) in verdict.requirements.items():
            rows.append((f"  violate {text}", str(at_start), str(at_result), ""))
    show_table((f"on {verdict.draws} fresh draws", "start", "result", "limit"), rows)
    low, high = verdict.reduction_interval
    reduction = number_text(verdict.reduction, ".1%")
    interval = f"[{number_text(low, '.1%')}, {number_text(high, '.1%')}]"
    console.print(f"reduction {reduction} in {interval} (95 %, bootstrap over draws)")
    median, low, high = (number_text(value, "+.4g") for value in verdict.difference)
    console.print(f"cost draw by draw, result less start: median {median} in [{low}, {high}] (95 %, exact)")


def show_search(study: Study, search: SearchFacts) -> None:
    """Print what was certified, proved and hunted, and how the search ended."""
    console = output()
    if search.certified_points is not None:
        console.print(f"certified: all {search.certified_points} points that were visited, by Theorem 1")
    aimed = search.aimed
    if aimed is not None:
        meaning = aim_quantity(study).meaning
        console.print(f"{meaning}: {aimed.start:.4g} at the start, {aimed.result:.4g} at the result", markup=False)
    if search.proved_points is not None:
        console.print(f"proved: all {search.proved_points} points that were accepted, with lag and sampling")
    if search.proof is not None:
        console.print(search.proof, markup=False, soft_wrap=True)
    for number, hunt in enumerate(search.counterexamples, start=1):
        slack = number_text(hunt.worst.slack, ".4g", ENDED)
        console.print(f"hunt {number}: worst slack {slack} in {hunt.simulations} simulations")
    if not search.feasible:
        missed = number_text(search.violation, ".2%", "draws that end early")
        draws = tuned_table(study).validation
        console.print(f"no point met every limit on the {draws:,} validation draws; the nearest misses by {missed}")
        for bound in search.missed:
            console.print(f"  {missed_text(bound, draws)}", markup=False)
    console.print(f"{search.method}, {search.stopped}; {search.seconds:.1f} s")


def missed_text(bound: MissedBound, draws: int) -> str:
    """A bound that a tuned loop misses, and by how much."""
    excess = number_text(bound.excess, ".4g", "an infinite amount")
    if math.isfinite(bound.excess):
        excess = f"{excess} {bound.unit}".removesuffix(" 1")
    if bound.draws is None:
        return f"{bound.text}: missed by {excess}"
    has_no_amount = bound.unit == "" and not math.isfinite(bound.excess)  # such as "runs to its end"
    if has_no_amount:
        return f"{bound.text}: missed by {bound.draws:,} of {draws:,} draws"
    return f"{bound.text}: missed by {bound.draws:,} of {draws:,} draws, by at most {excess}"


def likelihood_text(likelihood: LikelihoodAnswer) -> str:
    """How likely a draw is, in words."""
    return (
        f"at {likelihood.distance:.3g} sigma: log density {likelihood.log_density:.4g} relative to the mode; "
        f"{likelihood.mass:.5g} of all draws lie nearer"
    )


def show_falsification(falsified: Falsified, files: list[Path]) -> None:
    """Print the worst draw found and the likeliest failure, with their likelihoods."""
    answer = falsified.answer
    console = output()
    required = escape("; ".join(answer.requirements))
    console.print(f"[bold]{escape(falsified.study.name)}[/bold]  required: {required}")
    within = answer.within
    if within:
        console.print(f"searched: within {within.distance:.4g} sigma, which holds {within.mass:.5g} of all draws")
    nearest = answer.nearest_failure
    columns = {"worst draw": answer.worst.witness}
    if nearest:
        columns["likeliest failure"] = nearest.witness
    rows = []
    for name, unit in answer.units.items():
        values = [f"{column[name]:.6g}" for column in columns.values()]
        rows.append((name, *values, "" if unit == "1" else unit))
    show_table(("number", *columns, ""), rows)
    worst = answer.worst
    result = ENDED if worst.ending is None else f"it {worst.ending}"
    if worst.worst_value is not None:
        result = f"{worst.worst_value} where {worst.worst_requirement} is required"
    cost = f"{answer.simulations} simulations, {answer.seconds:.1f} s"
    if answer.failed:
        console.print(f"it fails: {result}; the first failure came after {answer.first_failure} of {cost}")
    else:
        console.print(f"no failure was found, which proves nothing; the worst of {cost}: {result}")
    if len(answer.worst_seen) > 1:
        values = ", ".join(f"{name}: {value}" for name, value in answer.worst_seen.items())
        console.print(f"worst seen of each requirement, in different draws: {values}", markup=False, soft_wrap=True)
    course = falsified.course_at(falsified.worst)
    if course:
        console.print(f"worst draw: {course}", markup=False, soft_wrap=True)
    if falsified.nearest_failure is not None and falsified.nearest_failure != falsified.worst:
        console.print(f"likeliest failure: {falsified.course_at(falsified.nearest_failure)}", markup=False)
    console.print(f"worst draw {likelihood_text(worst.likelihood)}", soft_wrap=True)
    if nearest:
        console.print(f"likeliest failure found {likelihood_text(nearest.likelihood)}", soft_wrap=True)
    show_files(files)
