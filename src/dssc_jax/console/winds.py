"""Print the worst winds found."""

from pathlib import Path

from rich.markup import escape

from dssc_jax.analyses.worst_wind.worst_wind import WorstWind
from dssc_jax.console.terminal import number_text, output, show_files, show_table


def show_worst_wind(worst_wind: WorstWind, files: list[Path]) -> None:
    """Print the worst value of each signal, and the cost of the search."""
    answer = worst_wind.answer
    console = output()
    rate = "it may jump" if answer.rate is None else f"|w'| <= {answer.rate:g} m/s^2"
    bounds = f"|w_h| <= {answer.speed:g} m/s, |w_z| <= {answer.vertical:g} m/s, {rate}"
    console.print(f"[bold]{escape(worst_wind.study.name)}[/bold]  wind: {escape(bounds)}", soft_wrap=True)
    rows = []
    for signal in answer.signals:
        worst = number_text(signal.worst, ".4g", missing="ends early")
        candidate = number_text(signal.candidate, ".4g", missing="ends early")
        numbers = ", ".join(f"{name} = {value:.4g}" for name, value in signal.numbers.items())
        rows.append((signal.signal, worst, candidate, "" if signal.unit == "1" else signal.unit, numbers))
    head = ("signal", "worst found", "of candidates", "unit", "with")
    if not worst_wind.study.laws:
        rows = [row[:-1] for row in rows]
        head = head[:-1]
    show_table(head, rows)
    console.print(
        f"{answer.flights:,} flights and {answer.slopes:,} with a derivative in {answer.seconds:.3g} s; "
        "winds that were not tried may be worse",
        markup=False,
        soft_wrap=True,
    )
    show_files(files)
