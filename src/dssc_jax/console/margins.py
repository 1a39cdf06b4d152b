"""Print the critical values of one number: for one loop, for several controllers, and beside theory."""

from collections.abc import Mapping
from pathlib import Path

from dssc_jax.analyses.comparison import MarginContest
from dssc_jax.analyses.margins.result import CONTENT, MarginAnswer, Margins
from dssc_jax.analyses.theory import Assessment
from dssc_jax.console.terminal import (
    number_text,
    show_files,
    show_head,
    show_line,
    show_pairs,
    show_paragraph,
    show_required,
    show_table,
)
from dssc_jax.statistics import CONFIDENCE, wilks_draws

SHARES = ("fail at the start already", "pass the whole way", "pass again beyond a failure")
"""Titles of the shares of draws that have no critical value on the walk, or more than one."""
MOST_DRAWS = 0.5
"""If more than this share of the draws fails at the start and passes later, the walk may begin at the wrong end."""


def value_text(value: float | None, end: float, unit: str = "") -> str:
    """Format a quantile of the critical values, and say so if it lies outside the walk.

    Args:
        value: The quantile; None: it lies before the start of the walk; equal to ``end``: it lies there or beyond.
        end: End of the walk.
        unit: Unit of the quantile and of the end.
    """
    if value is None:
        return "before the start"
    text = f"{value:.4g}" if unit in ("", "1") else f"{value:.4g} {unit}"
    return f"{text} or beyond" if value == end else text


def tolerance_text(limit: float | None, draws: int, end: float, unit: str = "") -> str:
    """Format the lower tolerance limit of the critical values.

    With too few draws there is no limit, and the text tells how many draws are needed.

    Args:
        limit: The limit; None: before the start of the walk.
        draws: Number of draws.
        end: End of the walk.
        unit: Unit of the limit and of the end.
    """
    least_draws = wilks_draws(CONTENT, CONFIDENCE)
    if draws < least_draws:
        return f"none of {draws} draws, {least_draws} are needed"
    return value_text(limit, end, unit)


def show_margins(margins: Margins, files: list[Path]) -> None:
    """Print statistics of the critical values, what Theorem 1 certifies, and how far the loop is proved.

    Args:
        margins: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = margins.answer
    start, end = answer.bounds
    show_required(margins.study.name, answer.criterion)
    limit = tolerance_text(answer.lower_tolerance, answer.draws, end, answer.unit)
    walk = f"{start:g} to {end:g}"
    if answer.unit != "1":
        walk += f" {answer.unit}"
    rows = [
        ("draws", str(answer.draws)),
        ("walk", walk),
        ("median critical value", value_text(answer.median, end, answer.unit)),
        ("95 % of all draws pass up to (confidence 95 %, Wilks)", limit),
        *zip(SHARES, share_texts(answer), strict=True),
    ]
    for text, count in answer.first_violated.items():
        rows.append((f"first violated: {text}", f"{count} of {answer.draws} draws"))
    rows.append(("seconds", f"{answer.seconds:.1f}, of which {answer.compile_seconds:.1f} compiling"))
    show_table((answer.parameter, ""), rows)
    show_line(answer.certificate)
    show_proof_statement(answer.proof)
    if min(answer.fail_at_start, answer.non_monotone) > MOST_DRAWS:
        show_paragraph(f"most draws fail at {start:g} and pass further on: is {start:g} the safe end of the walk?")
    show_files(files)


def share_texts(answer: MarginAnswer) -> list[str]:
    """Format the shares of draws that :data:`SHARES` names, in per cent."""
    return [f"{100 * share:.3g} %" for share in (answer.fail_at_start, answer.pass_to_end, answer.non_monotone)]


def show_proof_statement(proof: Mapping[str, object] | None) -> None:
    """Print how far the sampled loop is proved, if a proof was requested."""
    if proof is not None:
        show_line(str(proof["statement"]))


def show_margin_contest(contest: MarginContest, files: list[Path]) -> None:
    """Print the margins of each controller on the same draws, and the paired differences.

    Args:
        contest: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = contest.answer
    start, end = answer.bounds
    show_head(contest.study.name, f"{answer.draws} draws; required: {'; '.join(answer.criterion)}")
    rows = []
    names_by_certificate: dict[str, list[str]] = {}
    for name, controller in answer.controllers.items():
        margins = controller.margins
        limit = tolerance_text(margins.lower_tolerance, answer.draws, end)
        rows.append((name, value_text(margins.median, end), limit, *share_texts(margins), f"{margins.seconds:.1f}"))
        names_by_certificate.setdefault(margins.certificate, []).append(name)
    head = ("controller", "median", "95 % of draws pass up to", *SHARES, "seconds")
    show_table(head, rows, f"{answer.parameter} [{answer.unit}] from {start:g} to {end:g}")
    show_pairs(answer.pairs, "share of draws that go further", "exact, paired")
    for certificate, names in sorted(names_by_certificate.items()):
        show_line(f"{', '.join(names)}: {certificate}")
    show_paragraph(f"{answer.seconds:.1f} s in all")
    show_files(files)


def show_theory(assessment: Assessment, files: list[Path]) -> None:
    """Print local and simulated margins, predicted and simulated oscillations, and what Theorem 1 certifies.

    An oscillation is predicted at several values of mu; only the first, the middle and the last value are printed.

    Args:
        assessment: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = assessment.answer
    start, end = answer.bounds
    show_head(assessment.study.name, f"{answer.draws} draws, {answer.parameter}")
    rows = []
    for name, margin in {**answer.local, "simulated": answer.performance}.items():
        limit = tolerance_text(margin.lower_tolerance, answer.draws, end)
        rows.append((name, value_text(margin.median, end), limit, "; ".join(margin.criterion)))
    head = ("margin", f"median [{answer.unit}]", "95 % of draws pass up to", "criterion")
    show_table(head, rows, f"walk from {start:g} to {end:g}")
    rows = []
    for name, oscillation in answer.oscillations.items():
        middle = len(oscillation.mu) // 2
        for index in (0, middle, -1):
            predicted = number_text(oscillation.predicted[index])
            simulated = f"{oscillation.amplitude[index]:.3g}"
            rows.append((name, f"{oscillation.mu[index]:.3g}", simulated, predicted))
    if rows:
        unit = next(iter(assessment.oscillations.values()))["amplitude"].attrs["units"]
        show_table(("oscillation", "mu [s]", f"amplitude of sigma [{unit}]", "by describing function"), rows)
    show_line(answer.certificate.text)
    show_proof_statement(answer.proof)
    for name, reason in answer.not_covered.items():
        show_line(f"{name}: {reason}")
    show_files(files)
