"""Print the failure probability over ranges of laws."""

from pathlib import Path

from rich.markup import escape

from dssc_jax.analyses.laws.law_ranges import LawRanges
from dssc_jax.console.stated import interval_text
from dssc_jax.console.terminal import output, show_files, show_table


def show_ranges(ranges: LawRanges, files: list[Path]) -> None:
    """Print the interval over all laws, and the best and the worst of them."""
    answer = ranges.answer
    console = output()
    console.print(f"[bold]{escape(ranges.study.name)}[/bold]  required: {escape('; '.join(answer.requirements))}")
    console.print(ranges.headline, markup=False, soft_wrap=True)
    console.print(
        f"{answer.draws} draws of a mixture, worth at least {answer.least_effective:.0f} of every law", markup=False
    )
    rows = []
    for title, extreme in (("best", answer.lowest), ("worst", answer.highest)):
        weighted = f"{extreme.probability:.4g}", interval_text(extreme.interval)
        fresh = f"{extreme.fresh_failures}/{answer.fresh_draws}", interval_text(extreme.fresh_interval)
        rows.append((title, *weighted, *fresh))
    show_table(("law", "by the weights", "95 % interval", "new draws", "exact interval"), rows)
    rows = []
    data = ranges.dataset
    for argument in data["argument"].values:
        row = data.sel(argument=argument)
        texts = [f"{float(row[name]):.5g}" for name in ("low", "high", "at_lowest", "at_highest")]
        rows.append((str(argument), *texts))
    show_table(("argument", "low", "high", "best law", "worst law"), rows)
    show_files(files)
