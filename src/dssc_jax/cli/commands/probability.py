"""dssc-jax probability: a failure probability to a width by few simulations."""

from dssc_jax.analyses.probability import probability
from dssc_jax.cli.analysing import finish, free_folder
from dssc_jax.cli.declarations.statistics import Probability
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.console.analyses import show_probability
from dssc_jax.console.terminal import progress_bar


def run(options: Probability) -> int:
    """Estimate the probability, save and print it."""
    study = study_of(options).without_sweep()
    question = (options.width, options.most)
    folder = free_folder(study, "probability", options.out, options.settings, options.seed, *question)
    with progress_bar(study, quiet=options.as_json, unit="simulations") as advance:
        estimate = probability(study, options.width, options.most, progress=advance)
    finish(estimate, folder, options, show_probability)
    return DONE
