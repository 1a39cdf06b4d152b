"""dssc-jax replay: one draw of a result again, compared with what is stored."""

from dssc_jax.cli.declarations.simulation import Replay
from dssc_jax.cli.exit_codes import DONE, FAILS
from dssc_jax.cli.loading import stored_result
from dssc_jax.cli.parsing import parse_point
from dssc_jax.cli.trajectories import print_trajectory, require_writable
from dssc_jax.console.terminal import announce_compiling
from dssc_jax.results.schema import units_of
from dssc_jax.runs import trajectory as trajectories
from dssc_jax.study import Described


def run(options: Replay) -> int:
    """Simulate the draw, write its files and print how it ended and whether it agrees."""
    point = parse_point(options.at)
    result = stored_result(options.result, options.trust_code, options.allow_local, options.allow_native)
    require_writable(options)
    trajectories.point_of(result, options.draw, point)  # bad input is reported before anything is compiled
    announce_compiling(result.study, quiet=options.as_json or isinstance(result.study, Described))
    trajectory = trajectories.replay(result, options.draw, point=point or None, every=options.every)
    print_trajectory(trajectory, options, units_of(result.study))
    return FAILS if trajectory.attrs["agreement"] == "differs" else DONE
