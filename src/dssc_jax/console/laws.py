"""Print how far the laws may be wrong before too many draws fail."""

import math
from pathlib import Path

from dssc_jax.analyses.laws.answer import LawError, LawErrorsAnswer
from dssc_jax.analyses.laws.law_errors import LawErrors
from dssc_jax.console.stated import interval_text, show_stated
from dssc_jax.console.terminal import show_files, show_line, show_required, show_table
from dssc_jax.statistics.divergence_balls import BALLS


def show_laws(errors: LawErrors, files: list[Path]) -> None:
    """Print how far all laws together and each law alone may be wrong, and what follows from stated amounts.

    Args:
        errors: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = errors.answer
    show_required(errors.study.name, answer.requirements)
    failure = answer.failure
    interval = interval_text(failure.interval)
    show_line(
        f"{failure.failures} failures in {answer.draws} draws: failure probability in {interval} "
        f"({100 * answer.confidence:g} % {failure.interval_method})"
    )
    show_all_laws(answer)
    for name, weights in answer.weights.items():
        if weights.reason:
            show_line(f"weights for {name.replace('_', ' ')}: {weights.reason}")
    show_each_law(errors)
    show_value_of_knowledge(errors)
    show_stated(answer.stated)
    show_fresh_draws(answer)
    show_files(files)


def show_all_laws(answer: LawErrorsAnswer) -> None:
    """Print how far all laws together may be wrong: as a divergence, a shift of all means, and a relative width."""
    rows = []
    for name, ball in BALLS.items():
        estimate = getattr(answer.estimates, name)
        rows.append((ball.title, f"{getattr(answer, name):.4g}", f"{estimate:.4g}", ""))
    estimates = answer.estimates
    guaranteed = answer.guaranteed
    rows.append(
        (
            "shift of all means [standard deviations]",
            f"{answer.mean_shift:.3g}",
            amount_text(estimates.mean_shift),
            f"{guaranteed.mean_shift:.3g}",
        )
    )
    rows.append(
        (
            "relative width of all laws",
            f"{answer.widening:.3g}",
            amount_text(estimates.widening),
            "none, correlated" if guaranteed.widening is None else f"{guaranteed.widening:.3g}",
        )
    )
    head = (
        f"at most {100 * answer.limit:g} % fail up to",
        f"{100 * answer.confidence:g} % confidence",
        "estimate",
        "whatever draws fail",
    )
    show_table(head, rows)


def show_each_law(errors: LawErrors) -> None:
    """Print how far each law alone may be wrong; the law with the smallest admissible shift comes first."""
    laws = sorted(errors.answer.by_law.items(), key=lambda item: least_shift_first(item[1]))
    quantities = errors.study.quantities
    rows = []
    for name, law in laws:
        unit = "" if quantities[name].unit in ("", "1") else f" {quantities[name].unit}"
        median = "" if law.shifted_median is None else f"{law.median:.4g} to {law.shifted_median:.4g}{unit}"
        shift = (f"{law.mean_shift:.3g}", amount_text(law.mean_shift_estimate), median, law.towards)
        rows.append((name, *shift, f"{law.widening:.3g}", amount_text(law.widening_estimate)))
    head = ("shift of its mean", "estimate", "its median", "failing values", "relative width", "estimate")
    show_table(("one law alone", *head), rows)


def show_value_of_knowledge(errors: LawErrors) -> None:
    """Print the value of knowing each number better, and the number's quantiles in draws that fail.

    The value is the share of the variance of failure that the knowledge removes, and the probability that the knowledge
    changes the decision.
    """
    laws = sorted(errors.answer.by_law.items(), key=lambda item: removed_variance(item[1]), reverse=True)
    parts = 0
    rows = []
    for name, law in laws:
        knowledge = law.knowledge
        if knowledge is None or law.failing is None:
            continue
        parts = max(parts, knowledge.parts)
        low, median, high = law.failing
        median_text = f"{median:.4g}"
        if law.failing_median_interval is not None:
            median_low, median_high = law.failing_median_interval
            median_text += f" [{median_low:.4g}, {median_high:.4g}]"
        removed = share_text(knowledge.removed, knowledge.removed_interval)
        changes = share_text(knowledge.changes, knowledge.changes_interval)
        rows.append((name, removed, changes, f"{low:.4g}", median_text, f"{high:.4g}"))
    if rows:
        head = (
            f"known to 1/{parts} of its law",
            "variance removed",
            "another decision",
            "failing: 5 %",
            "median",
            "95 %",
        )
        show_table(head, rows)


def removed_variance(law: LawError) -> float:
    """Return the share of the variance that knowledge of the number removes; 0 if it was not computed."""
    return law.knowledge.removed if law.knowledge else 0.0


def share_text(value: float, interval: tuple[float, float]) -> str:
    """Format a share and its interval in per cent.

    Args:
        value: The share, of 1.
        interval: Lower and upper bound of the share, of 1.
    """
    low, high = interval
    return f"{100 * value:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"


def show_fresh_draws(answer: LawErrorsAnswer) -> None:
    """Print how far the laws may be wrong by new draws under changed laws, if such draws were simulated."""
    if answer.fresh is None:
        return
    rows = []
    for name, limit in answer.fresh.changes.items():
        change = name.replace("_", " ")
        rows.append((change, f"{limit.bound:.3g}", amount_text(limit.estimate), interval_text(limit.interval)))
    head = (f"{answer.fresh.draws} new draws", "with confidence", "estimate", "failure probability there")
    show_table(head, rows, "along the worst direction")


def least_shift_first(law: LawError) -> tuple[float, float]:
    """Return a law's key for sorting: the admissible shift of its mean, first as estimated, then with confidence.

    An estimate of None means that no shift reaches the limit; such laws come last.
    """
    estimate = law.mean_shift_estimate
    return (math.inf if estimate is None else estimate, law.mean_shift)


def amount_text(value: float | None) -> str:
    """Format the amount at which the limit is reached; "not reached" for None."""
    return "not reached" if value is None else f"{value:.3g}"
