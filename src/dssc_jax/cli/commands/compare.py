"""dssc-jax compare: controllers on the same draws and noise."""

from dssc_jax.analyses.comparison import compare, with_own_controllers
from dssc_jax.analyses.defaults import CANDIDATES
from dssc_jax.cli.analysing import finish, free_folder
from dssc_jax.cli.declarations.robustness import Compare
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import controller_names, study_of
from dssc_jax.console.analyses import show_comparison
from dssc_jax.console.terminal import progress_bar


def run(options: Compare) -> int:
    """Compare the controllers, save and print the comparison."""
    study = study_of(options).without_sweep()
    names = controller_names(options.controllers)
    study = with_own_controllers(study, names)
    folder = free_folder(study, "compare", options.out, options.settings, options.draws, options.seed)
    candidates = options.tune
    if candidates is None:
        has_one_channel = len(study.loop.channels) == 1  # others cannot be tuned
        candidates = CANDIDATES if has_one_channel else 0
    with progress_bar(study, quiet=options.as_json, unit="runs") as advance:
        comparison = compare(study, names, candidates=candidates, progress=advance)
    finish(comparison, folder, options, show_comparison)
    return DONE
