"""dssc-jax falsify: the worst draw."""

from dssc_jax.analyses.falsification.falsify import falsify
from dssc_jax.cli.analysing import write_or_refuse, free_folder, print_analysis, save_analysis, save_text
from dssc_jax.cli.declarations.searches import Falsify
from dssc_jax.cli.exit_codes import DONE, FAILS
from dssc_jax.cli.loading import study_of
from dssc_jax.console.searches import show_falsification
from dssc_jax.console.terminal import progress_bar
from dssc_jax.core import files
from dssc_jax.runs import run as runs
from dssc_jax.study.tables import to_toml


def run(options: Falsify) -> int:
    """Hunt the worst draw, save it as an analysis, a study and a result, and print it."""
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
    with progress_bar(study, quiet=options.as_json, of="simulations", early=lambda: falsified.stopped) as advance:
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
    file = folder / "witness.toml"
    witness = folder / "witness"
    save_text(file, to_toml(falsified.witness_study.table))
    write_or_refuse(witness, lambda: files.delete_tree(witness, folder))
    runs.run(falsified.witness_study, witness)
    paths = {"result": folder, "witness_study": file, "replay": witness}
    print_analysis(falsified, figures, options, show_falsification, paths)
    return FAILS if falsified.slack < 0.0 else DONE
