"""Commands that search: tune, falsify."""

from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.analyses.defaults import BUDGET, ROUNDS
from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, FAILS, app, attempt, default_out, load_study, output_analysis, save_analysis
from dssc_jax.core import files

BudgetOption = Annotated[
    int, typer.Option("--budget", metavar="N", help="Simulations of a hunt; one with derivatives counts for several.")
]


EARLY = "a draw ended early, or too few simulations are left for another generation"


@app.command()
def tune(
    study: opt.StudyArgument,
    robust: Annotated[
        bool, typer.Option("--robust", help="Hunt the result's worst case, add it to the draws, tune again.")
    ] = False,
    rounds: Annotated[int, typer.Option("--rounds", metavar="N", help="Rounds of --robust at most.")] = ROUNDS,
    budget: BudgetOption = BUDGET,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE", help="The tuned study [results/NAME-tune/tuned.toml].")
    ] = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Tune what the study's [tune] names, by gradient.

    Training draws are descended on, validation draws choose, and the study's own draws, on which nothing was tuned,
    decide: exit 1 where a limit or requirement is not met on the validation draws, or a hunt still finds a failure.
    Where [tune] asks for a proof, the folder holds the result's certificate, proof.json, which `prove` verifies.
    """
    from dssc_jax.analyses.tuning import tune as search
    from dssc_jax.analyses.tuning.result import PROOF_FILE
    from dssc_jax.console.searches import show_tuning
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.results.analysis_folder import require_free
    from dssc_jax.study.tables import to_toml

    loaded = load_study(study, settings, draws, seed, allow_local).without_sweep()
    folder = default_out(loaded, "tune", settings, draws, seed)
    require_free(folder, "tune", loaded)
    with progress_bar(loaded, quiet=as_json, of="steps", early="nothing better came") as advance:
        tuned = search(loaded, robust=robust, rounds=rounds, budget=budget, progress=advance)
    figures = save_analysis(tuned, folder, check=not no_check)
    file = out or folder / "tuned.toml"
    attempt(file, lambda: files.write_text(file, to_toml(tuned.tuned_study.table)))
    written = {"tuned_study": file, "result": folder}
    if tuned.certificate is not None:
        written["certificate"] = folder / PROOF_FILE
    output_analysis(tuned, written, figures, as_json, show_tuning)
    return DONE if tuned.met else FAILS


@app.command()
def falsify(
    study: opt.StudyArgument,
    budget: BudgetOption = BUDGET,
    within_sigma: Annotated[
        float | None,
        typer.Option("--within-sigma", metavar="K", help="Only draws within K sigma: |z| <= K, z the laws' scores."),
    ] = None,
    within_mass: Annotated[
        float | None,
        typer.Option("--within-mass", metavar="P", help="Only the likeliest draws that have the probability P."),
    ] = None,
    search_seed: Annotated[int, typer.Option("--search-seed", metavar="S", min=0, help="Seed of the search.")] = 0,
    settings: opt.Set = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Hunt the worst draw: within the support of the laws, within K sigma, or within the likeliest share P.

    The distance of a draw in sigma is that of its standard normal scores z from 0, over all uncertain numbers together;
    scores of correlated numbers are made independent. The worst draw and the likeliest failure found are printed with
    their distance, relative log density, and the probability of draws at most that far.

    Exit 1 where one fails. The witness is written as a study (witness.toml, for `simulate`) and as a result of that one
    draw (the folder witness, for `replay`).
    """
    from dssc_jax.analyses.falsification.falsify import falsify as hunt
    from dssc_jax.console.searches import show_falsification
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.results.analysis_folder import require_free
    from dssc_jax.runs.run import run
    from dssc_jax.study.tables import to_toml

    loaded = load_study(study, settings, None, seed, allow_local).without_sweep()
    folder = out or default_out(loaded, "falsify", settings, seed, within_sigma, within_mass)
    require_free(folder, "falsify", loaded)
    with progress_bar(loaded, quiet=as_json, of="simulations", early=EARLY) as advance:
        falsified = hunt(
            loaded,
            budget=budget,
            seed=search_seed,
            within_sigma=within_sigma,
            within_mass=within_mass,
            progress=advance,
        )
    figures = save_analysis(falsified, folder, check=not no_check)
    file, witness = folder / "witness.toml", folder / "witness"
    attempt(file, lambda: files.write_text(file, to_toml(falsified.witness_study.table)))
    attempt(witness, lambda: files.delete_tree(witness, folder))
    run(falsified.witness_study, witness)
    written = {"result": folder, "witness_study": file, "replay": witness}
    output_analysis(falsified, written, figures, as_json, show_falsification)
    return FAILS if falsified.slack < 0.0 else DONE
