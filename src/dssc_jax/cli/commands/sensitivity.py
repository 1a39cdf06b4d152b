"""dssc-jax sensitivity: which uncertain numbers matter."""

from dssc_jax.analyses.sensitivity import sensitivity
from dssc_jax.cli.analysing import finish, free_folder
from dssc_jax.cli.declarations.statistics import Sensitivity
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.console.analyses import show_sensitivity
from dssc_jax.console.terminal import progress_bar


def run(options: Sensitivity) -> int:
    """Compute the indices, save and print them."""
    study = study_of(options).without_sweep()
    folder = free_folder(
        study, "sensitivity", options.out, options.method, options.settings, options.draws, options.seed
    )
    with progress_bar(study, quiet=options.as_json) as advance:
        indices = sensitivity(study, options.method, progress=advance)
    finish(indices, folder, options, show_sensitivity)
    return DONE
