"""dssc-jax tune: gains by gradient."""

from dssc_jax.analyses.tuning import tune
from dssc_jax.analyses.tuning.result import PROOF_FILE
from dssc_jax.cli.analysing import free_folder, print_analysis, save_analysis, save_text
from dssc_jax.cli.declarations.searches import Tune
from dssc_jax.cli.exit_codes import DONE, FAILS
from dssc_jax.cli.loading import study_of
from dssc_jax.console.searches import show_tuning
from dssc_jax.console.terminal import progress_bar
from dssc_jax.study.tables import to_toml


def run(options: Tune) -> int:
    """Tune, save the result and the tuned study, and print them."""
    study = study_of(options).without_sweep()
    folder = free_folder(study, "tune", None, options.settings, options.draws, options.seed)
    with progress_bar(study, quiet=options.as_json, unit="steps", early="nothing better came") as advance:
        tuned = tune(study, robust=options.robust, rounds=options.rounds, budget=options.budget, progress=advance)
    figures = save_analysis(tuned, folder, options)
    file = options.out or folder / "tuned.toml"
    save_text(file, to_toml(tuned.tuned_study.table))
    paths = {"tuned_study": file, "result": folder}
    if tuned.certificate is not None:
        paths["certificate"] = folder / PROOF_FILE
    print_analysis(tuned, figures, options, show_tuning, paths)
    return DONE if tuned.met else FAILS
