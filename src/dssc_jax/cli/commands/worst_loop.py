"""dssc-jax worst-loop: worst margins of the linearised loop over the box of the laws."""

from dssc_jax.analyses.worst_loop import worst_loop
from dssc_jax.cli.analysing import free_folder, print_analysis, save_analysis, save_text, write_or_refuse
from dssc_jax.cli.declarations.robustness import WorstLoop
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.console.loops import show_worst_loop
from dssc_jax.console.terminal import progress_bar
from dssc_jax.core import files
from dssc_jax.study.tables import to_toml

EARLY = "the searches and the bounds have ended"
"""Reason why fewer points than the largest number are needed."""


def run(options: WorstLoop) -> int:
    """Find the worst case, save it with its witnesses, and print it."""
    study = study_of(options).without_sweep()
    folder = free_folder(
        study,
        "worst-loop",
        options.out,
        options.settings,
        options.draws,
        options.seed,
        options.broken_at,
        None if options.sigma == WorstLoop.sigma else options.sigma,
        None if options.cells == WorstLoop.cells else options.cells,
        options.points,
    )
    with progress_bar(study, quiet=options.as_json, unit="points", early=EARLY) as advance:
        worst = worst_loop(
            study,
            broken_at=options.broken_at or (),
            sigma=options.sigma,
            cells=options.cells,
            points=options.points,
            progress=advance,
        )
    figures = save_analysis(worst, folder, options)
    witnesses = folder / "witnesses"
    write_or_refuse(witnesses, lambda: files.delete_tree(witnesses, folder))
    files.make_folder(witnesses, folder)
    for name, witness in worst.witnesses().items():
        save_text(witnesses / f"{name}.toml", to_toml(witness.table))
    print_analysis(worst, figures, options, show_worst_loop, {"result": folder, "witnesses": witnesses})
    return DONE
