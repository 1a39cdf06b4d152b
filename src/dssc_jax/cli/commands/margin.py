"""dssc-jax margin: every draw's critical value of one number, of one or several controllers."""

from dssc_jax.analyses.comparison import compare_margins, with_own_controllers
from dssc_jax.analyses.margins import margin
from dssc_jax.cli.analysing import finish, free_folder
from dssc_jax.cli.declarations.robustness import Margin
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import controller_names, study_of
from dssc_jax.cli.parsing import parse_walk
from dssc_jax.cli.proving import require_proofs
from dssc_jax.console.margins import show_margin_contest, show_margins
from dssc_jax.console.terminal import progress_bar
from dssc_jax.core.errors import ConfigError

EARLY = "every critical value is found"
"""Reason why fewer simulations than the largest number are needed."""


def run(options: Margin) -> int:
    """Find the margins, save and print them."""
    if options.prove:
        require_proofs()
        if options.controllers is not None:
            raise ConfigError("--prove", "is not for --controllers: prove each with `dssc-jax prove --over`")
    walk = parse_walk(options.over)
    study = study_of(options).without_sweep()
    names = [] if options.controllers is None else controller_names(options.controllers)
    study = with_own_controllers(study, names)
    kind = "margin" if options.controllers is None else "margins"
    folder = free_folder(
        study, kind, options.out, options.settings, options.draws, options.seed, ending=f"{kind}-{walk.name}"
    )
    settings = {"bounds": walk.bounds, "log": options.log, "points": options.points, "bisections": options.bisections}
    progress = progress_bar(study, quiet=options.as_json, unit="simulations", early=EARLY)
    if options.controllers is None:
        with progress as advance:
            margins = margin(study, over=walk.name, **settings, prove=options.prove, progress=advance)
        finish(margins, folder, options, show_margins)
    else:
        with progress as advance:
            contest = compare_margins(study, names, over=walk.name, **settings, progress=advance)
        finish(contest, folder, options, show_margin_contest)
    return DONE
