"""dssc-jax simulate: one draw and its trajectory."""

from dssc_jax.cli.declarations.simulation import Simulate
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.cli.trajectories import print_trajectory, require_writable
from dssc_jax.cli.warnings import checked_integration, warn_of_integration, warn_of_study
from dssc_jax.console.terminal import announce_compiling
from dssc_jax.runs import trajectory as trajectories


def run(options: Simulate) -> int:
    """Simulate the draw, write its files and print how it ended."""
    study = study_of(options)
    warn_of_study(study)
    require_writable(options)
    fixed = study.without_sweep()
    trajectories.lane_values(fixed, options.draw, {})  # bad input is reported before anything is compiled
    announce_compiling(study, quiet=options.as_json)
    trajectory = trajectories.simulate(study, options.draw, every=options.every)
    if not options.no_check:
        warn_of_integration(checked_integration(fixed))
    print_trajectory(trajectory, options)
    return DONE
