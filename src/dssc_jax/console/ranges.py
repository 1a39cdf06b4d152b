"""Print the failure probability over all laws whose arguments lie within ranges."""

from pathlib import Path

from dssc_jax.analyses.laws.law_ranges import LawRanges
from dssc_jax.console.stated import interval_text
from dssc_jax.console.terminal import show_files, show_line, show_paragraph, show_required, show_table


def show_ranges(ranges: LawRanges, files: list[Path]) -> None:
    """Print the interval of the failure probability over all laws, and the laws with its lowest and its highest value.

    Args:
        ranges: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = ranges.answer
    show_required(ranges.study.name, answer.requirements)
    show_line(ranges.headline)
    show_paragraph(f"{answer.draws} draws of a mixture, worth at least {answer.least_effective:.0f} of every law")
    rows = []
    for title, extreme in (("best", answer.lowest), ("worst", answer.highest)):
        interval = interval_text(extreme.interval)
        fresh_share = f"{extreme.fresh_failures}/{answer.fresh_draws}"
        fresh_interval = interval_text(extreme.fresh_interval)
        rows.append((title, f"{extreme.probability:.4g}", interval, fresh_share, fresh_interval))
    show_table(("law", "by the weights", "95 % interval", "new draws", "exact interval"), rows)
    rows = []
    for argument in ranges.dataset["argument"].values:
        values = ranges.dataset.sel(argument=argument)
        texts = [f"{float(values[name]):.5g}" for name in ("low", "high", "at_lowest", "at_highest")]
        rows.append((str(argument), *texts))
    show_table(("argument", "low", "high", "best law", "worst law"), rows)
    show_files(files)
