"""dssc-jax simulate: one draw and its trajectory."""

from dssc_jax.cli.analysing import save_text
from dssc_jax.cli.declarations.simulation import Simulate
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.cli.trajectories import print_trajectory, require_writable
from dssc_jax.cli.warnings import checked_integration, warn_of_integration, warn_of_study
from dssc_jax.console.terminal import announce_compiling
from dssc_jax.core.errors import ConfigError
from dssc_jax.exploration import require_panel
from dssc_jax.results.schema import units_of
from dssc_jax.runs import trajectory as trajectories
from dssc_jax.study import Study


def run(options: Simulate) -> int:
    """Simulate the draw, write its files and print how it ended."""
    study = study_of(options)
    warn_of_study(study)
    require_writable(options)
    if options.ghosts is not None and options.flight is None:
        raise ConfigError("--ghosts", "is a number of flights to show, and needs --flight")
    fixed = study.without_sweep()
    trajectories.lane_values(fixed, options.draw, {})  # bad input is reported before anything is compiled
    announce_compiling(study, quiet=options.as_json)
    trajectory = trajectories.simulate(study, options.draw, every=options.every)
    if not options.no_check:
        warn_of_integration(checked_integration(fixed))
    flight_files = []
    if options.flight is not None:
        text = flight_html(study, options)
        save_text(options.flight, text)
        flight_files.append(options.flight)
    print_trajectory(trajectory, options, units_of(fixed), flight_files)
    return DONE


def flight_html(study: Study, options: Simulate) -> str:
    """Return the HTML page that shows the flight of the draw.

    Args:
        study: The study.
        options: Options of the command: the draw, and the number of other draws to show.

    Raises:
        ConfigError: A package is missing, or the plant is not a vehicle.
    """
    require_panel()
    from dssc_jax.exploration import flight_page  # needs an optional package

    ghosts = flight_page.GHOSTS if options.ghosts is None else options.ghosts
    return flight_page.flight_html(study, options.draw, ghosts)
