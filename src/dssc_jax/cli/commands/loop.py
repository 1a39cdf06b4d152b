"""dssc-jax loop: classical margins of the linearised loop."""

from dssc_jax.analyses.loop_margins import loop_margins
from dssc_jax.cli.analysing import finish, free_folder
from dssc_jax.cli.declarations.robustness import Loop
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.cli.parsing import parse_times
from dssc_jax.console.loops import show_loop
from dssc_jax.console.terminal import progress_bar


def run(options: Loop) -> int:
    """Find the margins, save and print them."""
    times = parse_times(options.at)
    study = study_of(options).without_sweep()
    folder = free_folder(study, "loop", options.out, options.settings, options.draws, options.seed, options.at)
    with progress_bar(study, quiet=options.as_json) as advance:
        margins = loop_margins(study, times=times, progress=advance)
    finish(margins, folder, options, show_loop)
    return DONE
