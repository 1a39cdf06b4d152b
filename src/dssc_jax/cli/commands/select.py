"""dssc-jax select: the candidates among many that fail least often."""

from dssc_jax.analyses.selection import select
from dssc_jax.cli.analysing import finish, free_folder
from dssc_jax.cli.declarations.searches import Select
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.cli.parsing import parse_walk
from dssc_jax.console.searches import show_selection
from dssc_jax.console.terminal import progress_bar
from dssc_jax.core.errors import ConfigError


def run(options: Select) -> int:
    """Race the candidates, save and print the best."""
    walks = [parse_walk(text) for text in options.over or []]
    over = {walk.name: walk.bounds for walk in walks}
    if len(over) < len(walks):
        raise ConfigError("--over", "gives a number twice")
    study = study_of(options).without_sweep()
    question = (options.over, options.candidates, options.keep, options.within, options.most)
    folder = free_folder(study, "select", options.out, options.settings, options.seed, *question)
    with progress_bar(study, quiet=options.as_json, unit="simulations") as advance:
        selection = select(
            study,
            over=over or None,
            candidates=options.candidates,
            keep=options.keep,
            within=options.within,
            most=options.most,
            progress=advance,
        )
    finish(selection, folder, options, show_selection)
    return DONE
