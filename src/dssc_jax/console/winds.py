"""Print the worst values that a search for winds found."""

from pathlib import Path

from dssc_jax.analyses.worst_wind.worst_wind import WorstWind
from dssc_jax.console.terminal import number_text, show_files, show_head, show_line, show_table, values_text


def show_worst_wind(worst_wind: WorstWind, files: list[Path]) -> None:
    """Print the bounds of the wind, the worst value of each signal, and the cost of the search.

    Args:
        worst_wind: The analysis.
        files: Files that were written, whose paths are printed.
    """
    answer = worst_wind.answer
    rate = "it may jump" if answer.rate is None else f"|w'| <= {answer.rate:g} m/s^2"
    bounds = f"|w_h| <= {answer.speed:g} m/s, |w_z| <= {answer.vertical:g} m/s, {rate}"
    show_head(worst_wind.study.name, f"wind: {bounds}")
    has_laws = bool(worst_wind.study.laws)
    rows = []
    for signal in answer.signals:
        worst = number_text(signal.worst, ".4g", missing="ends early")
        candidate = number_text(signal.candidate, ".4g", missing="ends early")
        row = [signal.signal, worst, candidate, "" if signal.unit == "1" else signal.unit]
        if has_laws:
            row.append(values_text(signal.numbers, ".4g"))
        rows.append(row)
    head = ["signal", "worst found", "of candidates", "unit"]
    if has_laws:
        head.append("with")
    show_table(head, rows)
    show_line(
        f"{answer.flights:,} flights and {answer.slopes:,} with a derivative in {answer.seconds:.3g} s; "
        "winds that were not tried may be worse"
    )
    show_files(files)
