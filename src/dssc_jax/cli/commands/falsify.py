"""dssc-jax falsify: the worst draw."""

from dssc_jax.analyses.falsification.falsify import falsify
from dssc_jax.cli.analysing import free_folder, print_analysis, save_analysis, save_text, write_or_refuse
from dssc_jax.cli.declarations.searches import Falsify
from dssc_jax.cli.exit_codes import DONE, FAILS
from dssc_jax.cli.loading import study_of
from dssc_jax.console.searches import show_falsification
from dssc_jax.console.terminal import progress_bar
from dssc_jax.core import files
from dssc_jax.runs import run as runs
from dssc_jax.study.tables import to_toml


def run(options: Falsify) -> int:
    """Search for the worst draw, save it as an analysis, a study and a result, and print it."""
    study = study_of(options).without_sweep()
    folder = free_folder(
        study,
        "falsify",
        options.out,
        options.settings,
        options.seed,
        options.within_sigma,
        options.within_mass,
        options.requirement,
    )
    with progress_bar(study, quiet=options.as_json, unit="simulations", early=lambda: falsified.stopped) as advance:
        falsified = falsify(
            study,
            budget=options.budget,
            seed=options.search_seed,
            within_sigma=options.within_sigma,
            within_mass=options.within_mass,
            requirement=options.requirement or "",
            progress=advance,
        )
    figures = save_analysis(falsified, folder, options)
    study_file = folder / "witness.toml"
    result_folder = folder / "witness"
    save_text(study_file, to_toml(falsified.witness_study.table))
    write_or_refuse(result_folder, lambda: files.delete_tree(result_folder, folder))  # that of an earlier search
    runs.run(falsified.witness_study, result_folder)
    paths = {"result": folder, "witness_study": study_file, "replay": result_folder}
    print_analysis(falsified, figures, options, show_falsification, paths)
    return FAILS if falsified.slack < 0.0 else DONE
