"""dssc-jax theory: Theorem 1, linearisation, describing functions and simulation for one number."""

from dssc_jax.analyses.comparison import controller_table, switching_kinds, with_controller
from dssc_jax.analyses.theory import assess
from dssc_jax.cli.analysing import finish, free_folder
from dssc_jax.cli.declarations.robustness import Theory
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.cli.parsing import parse_walk
from dssc_jax.cli.proving import require_proofs
from dssc_jax.console.margins import show_theory
from dssc_jax.console.terminal import progress_bar
from dssc_jax.core.errors import ConfigError
from dssc_jax.study import Study

EARLY = "every critical value is found"
"""Reason why fewer simulations than the largest number are needed."""


def run(options: Theory) -> int:
    """Compare theory with simulation for a number, save and print the comparison."""
    if options.prove:
        require_proofs()
    walk = parse_walk(options.over)
    study = study_of(options).without_sweep()
    folder = free_folder(
        study, "theory", options.out, options.settings, options.draws, options.seed, ending=f"theory-{walk.name}"
    )
    rivals = switching_rivals(study)
    with progress_bar(study, quiet=options.as_json, unit="simulations", early=EARLY) as advance:
        assessment = assess(
            study,
            over=walk.name,
            bounds=walk.bounds,
            log=options.log,
            points=options.points,
            bisections=options.bisections,
            rivals=rivals,
            prove=options.prove,
            progress=advance,
        )
    finish(assessment, folder, options, show_theory)
    return DONE


def switching_rivals(study: Study) -> dict[str, Study]:
    """Return the study with each controller whose oscillation can be predicted, by the controller's kind.

    Such a controller has a describing function, and gains that follow from those of the study.
    """
    rivals = {}
    for name in switching_kinds():
        try:
            rivals[name] = with_controller(study, name, controller_table(study, name))
        except ConfigError:
            continue
    return rivals
