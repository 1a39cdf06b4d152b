"""dssc-jax worst-wind: the wind within bounds that drives each signal to its worst value."""

from pathlib import Path

from dssc_jax.analyses.worst_wind.worst_wind import WorstWind, worst_wind
from dssc_jax.cli.analysing import free_folder, print_analysis, save_analysis, save_text
from dssc_jax.cli.declarations.searches import WorstWind as WorstWindOptions
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.console.terminal import progress_bar
from dssc_jax.console.winds import show_worst_wind
from dssc_jax.core import files
from dssc_jax.study.tables import to_toml


def run(options: WorstWindOptions) -> int:
    """Search, save the analysis and a study of each worst flight, and print it."""
    study = study_of(options).without_sweep()
    folder = free_folder(study, "worst-wind", options.out, options.settings, options.seed, options.signal)
    with progress_bar(study, quiet=options.as_json, unit="steps", early="nothing worse came") as advance:
        worst = worst_wind(
            study,
            signals=options.signal,
            segments=options.segments,
            rounds=options.rounds,
            seed=options.search_seed,
            progress=advance,
        )
    figures = save_analysis(worst, folder, options)
    flights = folder / "flights"
    files.make_folder(flights, folder)
    for signal in worst.signals:
        write_flight(worst, signal, flights)
    print_analysis(worst, figures, options, show_worst_wind, {"result": folder, "worst_flights": flights})
    return DONE


def write_flight(worst: WorstWind, signal: str, folder: Path) -> None:
    """Write the study of a signal's worst flight as TOML, and its wind as CSV.

    The wind is in m/s along the axes x, y, z, and the time t in s.

    Args:
        worst: The analysis.
        signal: Name of the signal, and of both files.
        folder: The folder to write to.
    """
    save_text(folder / f"{signal}.toml", to_toml(worst.flight(signal).table))
    rows = ["t,x,y,z"]
    for time, wind in zip(worst.grid.times.tolist(), worst.wind(signal).tolist(), strict=True):
        rows.append(",".join(map(repr, (time, *wind))))
    save_text(folder / f"{signal}.csv", "\n".join(rows) + "\n")
