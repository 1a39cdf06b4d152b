"""Print how wrong the laws may be."""

import math
from pathlib import Path

from rich.markup import escape

from dssc_jax.analyses.laws.answer import LawError, LawErrorsAnswer
from dssc_jax.analyses.laws.law_errors import LawErrors
from dssc_jax.console.stated import interval_text, show_stated
from dssc_jax.console.terminal import output, show_files, show_table
from dssc_jax.statistics.divergence_balls import BALLS

NOT_REACHED = "not reached"


def show_laws(errors: LawErrors, files: list[Path]) -> None:
    """Print how far the laws may be wrong together, each law alone, and what follows from stated amounts."""
    answer = errors.answer
    console = output()
    required = escape("; ".join(answer.requirements))
    console.print(f"[bold]{escape(errors.study.name)}[/bold]  required: {required}")
    failure = answer.failure
    interval = interval_text(failure.interval)
    console.print(
        f"{failure.failures} failures in {answer.draws} draws: failure probability in {interval} "
        f"({100 * answer.confidence:g} % {failure.interval_method})",
        markup=False,
        soft_wrap=True,
    )
    show_all_laws(answer)
    for name, weights in answer.weights.items():
        if weights.reason:
            console.print(f"weights for {name.replace('_', ' ')}: {weights.reason}", markup=False, soft_wrap=True)
    show_each_law(errors)
    show_knowledge(errors)
    show_stated(answer.stated)
    show_fresh(answer)
    show_files(files)


def show_all_laws(answer: LawErrorsAnswer) -> None:
    """Print how far all laws together may be wrong."""
    rows = []
    for name, ball in BALLS.items():
        estimate = getattr(answer.estimates, name)
        rows.append((ball.title, f"{getattr(answer, name):.4g}", f"{estimate:.4g}", ""))
    shift = answer.estimates.mean_shift
    widening = answer.estimates.widening
    wide = answer.guaranteed.widening
    shift_row = ("shift of all means [standard deviations]", f"{answer.mean_shift:.3g}", known_text(shift))
    widened = ("relative width of all laws", f"{answer.widening:.3g}", known_text(widening))
    rows.append((*shift_row, f"{answer.guaranteed.mean_shift:.3g}"))
    rows.append((*widened, "none, correlated" if wide is None else f"{wide:.3g}"))
    head = (
        f"at most {100 * answer.limit:g} % fail up to",
        f"{100 * answer.confidence:g} % confidence",
        "estimate",
        "whatever draws fail",
    )
    show_table(head, rows)


def show_each_law(errors: LawErrors) -> None:
    """Print how far each law alone may be wrong, the most important one first."""
    laws = sorted(errors.answer.by_law.items(), key=lambda entry: importance(entry[1]))
    quantities = errors.study.quantities
    rows = []
    for name, law in laws:
        unit = "" if quantities[name].unit in ("", "1") else f" {quantities[name].unit}"
        median = "" if law.shifted_median is None else f"{law.median:.4g} to {law.shifted_median:.4g}{unit}"
        shift = (f"{law.mean_shift:.3g}", known_text(law.mean_shift_estimate), median, law.towards)
        rows.append((name, *shift, f"{law.widening:.3g}", known_text(law.widening_estimate)))
    head = ("shift of its mean", "estimate", "its median", "failing values", "relative width", "estimate")
    show_table(("one law alone", *head), rows)


def show_knowledge(errors: LawErrors) -> None:
    """Print what knowing each number is worth, the most valuable one first, and where it lies in failed draws."""
    rows = []
    for name, law in sorted(errors.answer.by_law.items(), key=lambda entry: removed_by(entry[1]), reverse=True):
        knowledge = law.knowledge
        failing = law.failing
        interval = law.failing_median_interval
        if knowledge is None or failing is None:
            continue
        low, middle, high = failing
        removed = share_text(knowledge.removed, knowledge.removed_interval)
        changes = share_text(knowledge.changes, knowledge.changes_interval)
        median = f"{middle:.4g}"
        if interval is not None:
            median += f" [{interval[0]:.4g}, {interval[1]:.4g}]"
        rows.append((name, removed, changes, f"{low:.4g}", median, f"{high:.4g}"))
    if rows:
        parts = max(law.knowledge.parts for law in errors.answer.by_law.values() if law.knowledge)
        head = (
            f"known to 1/{parts} of its law",
            "variance removed",
            "another decision",
            "failing: 5 %",
            "median",
            "95 %",
        )
        show_table(head, rows)


def removed_by(law: LawError) -> float:
    """Share of the variance that knowing the number removes; 0 if it is not known."""
    return law.knowledge.removed if law.knowledge else 0.0


def share_text(value: float, interval: tuple[float, float]) -> str:
    """A share with its interval in percent."""
    low, high = interval
    return f"{100 * value:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"


def show_fresh(answer: LawErrorsAnswer) -> None:
    """Print what new draws say."""
    if answer.fresh is None:
        return
    rows = []
    for name, limit in answer.fresh.changes.items():
        row = (name.replace("_", " "), f"{limit.bound:.3g}", known_text(limit.estimate), interval_text(limit.interval))
        rows.append(row)
    head = (f"{answer.fresh.draws} new draws", "with confidence", "estimate", "failure probability there")
    show_table(head, rows, "along the worst direction")


def importance(law: LawError) -> tuple[float, float]:
    """Sort key of a law in the table: the smallest shift first."""
    estimate = law.mean_shift_estimate
    return (math.inf if estimate is None else estimate, law.mean_shift)


def known_text(value: float | None) -> str:
    """An amount as text, or that it was not reached."""
    return NOT_REACHED if value is None else f"{value:.3g}"
