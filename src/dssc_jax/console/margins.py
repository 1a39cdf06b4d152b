"""Print margins: of one loop, of several controllers, and with theory."""

from collections.abc import Mapping
from pathlib import Path

from rich.markup import escape

from dssc_jax.analyses.comparison import MarginContest
from dssc_jax.analyses.margins.result import CONTENT, MarginAnswer, Margins
from dssc_jax.analyses.theory import Assessment
from dssc_jax.console.terminal import number_text, output, show_files, show_pairs, show_table
from dssc_jax.statistics import CONFIDENCE, wilks_draws

BEFORE = "before the start"
SHARES = ("fail at the start already", "pass the whole way", "pass again beyond a failure")
TURNED = 0.5  # share of draws that fail at the start and pass further on: the walk may be the wrong way round


def value_text(value: float | None, end: float, unit: str = "") -> str:
    """A critical value of some rank as text; marked if it lies outside the walk."""
    if value is None:
        return BEFORE
    return f"{value:.4g}{'' if unit in ('', '1') else f' {unit}'}{' or beyond' if value == end else ''}"


def tolerance_text(limit: float | None, draws: int, end: float, unit: str = "") -> str:
    """The lower tolerance limit, or the reason why there is none."""
    least_draws = wilks_draws(CONTENT, CONFIDENCE)
    if draws < least_draws:
        return f"none of {draws} draws, {least_draws} are needed"
    return value_text(limit, end, unit)


def show_margins(margins: Margins, files: list[Path]) -> None:
    """Print the statistics of the critical values."""
    answer = margins.answer
    console = output()
    start, end = answer.bounds
    required = escape("; ".join(answer.criterion))
    console.print(f"[bold]{escape(margins.study.name)}[/bold]  required: {required}")
    limit = tolerance_text(answer.lower_tolerance, answer.draws, end, answer.unit)
    rows = [
        ("draws", str(answer.draws)),
        ("walk", f"{start:g} to {end:g}{'' if answer.unit == '1' else f' {answer.unit}'}"),
        ("median critical value", value_text(answer.median, end, answer.unit)),
        ("95 % of all draws pass up to (confidence 95 %, Wilks)", limit),
        *zip(SHARES, share_texts(answer), strict=True),
    ]
    for text, count in answer.first_violated.items():
        rows.append((f"first violated: {text}", f"{count} of {answer.draws} draws"))
    rows.append(("seconds", f"{answer.seconds:.1f}, of which {answer.compile_seconds:.1f} compiling"))
    show_table((answer.parameter, ""), rows)
    console.print(answer.certificate, markup=False, soft_wrap=True)
    show_reach(answer.proof)
    if min(answer.fail_at_start, answer.non_monotone) > TURNED:
        console.print(f"most draws fail at {start:g} and pass further on: is {start:g} the safe end of the walk?")
    show_files(files)


def share_texts(answer: MarginAnswer) -> list[str]:
    """The shares named by ``SHARES``, in per cent."""
    return [f"{100 * share:.3g} %" for share in (answer.fail_at_start, answer.pass_to_end, answer.non_monotone)]


def show_reach(proof: Mapping[str, object] | None) -> None:
    """Print how far the sampled loop is proved, if a proof was requested."""
    if proof is not None:
        output().print(proof["statement"], markup=False, soft_wrap=True)


def show_margin_contest(contest: MarginContest, files: list[Path]) -> None:
    """Print the margins of each controller on the same draws, and the pairs' differences."""
    answer = contest.answer
    console = output()
    start, end = answer.bounds
    required = escape("; ".join(answer.criterion))
    console.print(f"[bold]{escape(contest.study.name)}[/bold]  {answer.draws} draws; required: {required}")
    rows = []
    certificates: dict[str, list[str]] = {}
    for name, controller in answer.controllers.items():
        margins = controller.margins
        limit = tolerance_text(margins.lower_tolerance, answer.draws, end)
        rows.append((name, value_text(margins.median, end), limit, *share_texts(margins), f"{margins.seconds:.1f}"))
        certificates.setdefault(margins.certificate, []).append(name)
    head = ("controller", "median", "95 % of draws pass up to", *SHARES, "seconds")
    show_table(head, rows, f"{answer.parameter} [{answer.unit}] from {start:g} to {end:g}")
    show_pairs(answer.pairs, "share of draws that go further", "exact, paired")
    for text in sorted(certificates):
        console.print(f"{', '.join(certificates[text])}: {text}", markup=False, soft_wrap=True)
    console.print(f"{answer.seconds:.1f} s in all")
    show_files(files)


def show_theory(assessment: Assessment, files: list[Path]) -> None:
    """Print the answers of theory and simulation, one row each, with the question that each one answers."""
    answer = assessment.answer
    console = output()
    start, end = answer.bounds
    console.print(f"[bold]{escape(assessment.study.name)}[/bold]  {answer.draws} draws, {escape(answer.parameter)}")
    rows = []
    for name, margin in {**answer.local, "simulated": answer.performance}.items():
        limit = tolerance_text(margin.lower_tolerance, answer.draws, end)
        rows.append((name, value_text(margin.median, end), limit, "; ".join(margin.criterion)))
    head = ("margin", f"median [{answer.unit}]", "95 % of draws pass up to", "criterion")
    show_table(head, rows, f"walk from {start:g} to {end:g}")
    rows = []
    for name, oscillation in answer.oscillations.items():
        for k in (0, len(oscillation.mu) // 2, -1):
            text = number_text(oscillation.predicted[k])
            rows.append((name, f"{oscillation.mu[k]:.3g}", f"{oscillation.amplitude[k]:.3g}", text))
    if rows:
        show_table(("oscillation", "mu [s]", "amplitude of sigma [output/s]", "by describing function"), rows)
    console.print(answer.certificate.text, markup=False, soft_wrap=True)
    show_reach(answer.proof)
    for name, reason in answer.not_covered.items():
        console.print(f"{name}: {reason}", markup=False, soft_wrap=True)
    show_files(files)
