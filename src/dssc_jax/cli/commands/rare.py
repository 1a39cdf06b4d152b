"""dssc-jax rare: a failure probability too small for plain draws."""

from dssc_jax.analyses.defaults import FEWER_PLAIN, PLAIN
from dssc_jax.analyses.rare_events.importance import ImportanceSampling
from dssc_jax.analyses.rare_events.rare import rare
from dssc_jax.analyses.rare_events.splitting import Splitting
from dssc_jax.cli.analysing import finish, free_folder
from dssc_jax.cli.declarations.statistics import Rare
from dssc_jax.cli.declarations.types import RareMethod
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.console.analyses import show_rare
from dssc_jax.console.terminal import progress_bar


def run(options: Rare) -> int:
    """Estimate the probability, save and print it."""
    study = study_of(options).without_sweep()
    killed = options.particles // 2 if options.killed is None else options.killed
    splitting = Splitting(options.particles, killed, options.moves, options.repeats, plain=options.plain or PLAIN)
    importance = ImportanceSampling(options.variation, plain=options.plain or FEWER_PLAIN)
    folder = free_folder(study, "rare", options.out, options.settings, options.seed)
    with progress_bar(study, quiet=options.as_json, unit="simulations") as advance:
        event = rare(
            study,
            None if options.method is RareMethod.SPLITTING else importance,
            None if options.method is RareMethod.IMPORTANCE else splitting,
            progress=advance,
        )
    finish(event, folder, options, show_rare)
    return DONE
