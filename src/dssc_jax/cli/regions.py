"""Commands on two numbers at once: region."""

from typing import TYPE_CHECKING, Annotated

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app, assignment, default_out, load_study, output_analysis, save_analysis
from dssc_jax.core.errors import ConfigError

if TYPE_CHECKING:
    from dssc_jax.analyses.region.safe_region import RegionAxis


def parse_axis(text: str) -> "RegionAxis":
    """Parse a number and its range from ``NAME=LO:HI[:log]``."""
    from dssc_jax.analyses.region.safe_region import RegionAxis

    name, value = assignment(text, "--over")
    low, colon, rest = value.partition(":")
    high, _, scale = rest.partition(":")
    try:
        if not colon or scale not in ("", "log"):
            raise ValueError
        return RegionAxis(name, float(low), float(high), scale == "log")
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI[:log], got '{text}'") from None


@app.command()
def region(
    study: opt.StudyArgument,
    over: Annotated[
        list[str], typer.Option("--over", metavar="NAME=LO:HI[:log]", help="A number and its range; give two.")
    ],
    halvings: Annotated[int, typer.Option("--halvings", metavar="N", help="Halvings of the coarse cells.")] = 3,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Over two numbers, where do at least 95 % of all plants meet the requirements, with 95 % confidence?

    Follows the boundary of the region on a lattice, with the same draws at every point, instead of simulating it all.
    The confidence holds for all points together. The figure also has the points that Theorem 1 certifies. The
    study's [sweep] is ignored.
    """
    from dssc_jax.analyses.region.safe_region import region as search
    from dssc_jax.console.regions import show_region
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.results.analysis_folder import require_free

    if len(over) != 2:
        raise ConfigError("--over", f"must be given twice, got {len(over)}")
    one, other = map(parse_axis, over)
    loaded = load_study(study, settings, draws, seed, allow_local).without_sweep()
    folder = out or default_out(loaded, f"region-{one.name}-{other.name}", settings, draws, seed)
    require_free(folder, "region", loaded)
    with progress_bar(loaded, quiet=as_json, of="simulations") as advance:
        answer = search(loaded, over=(one, other), halvings=halvings, progress=advance)
    output_analysis(answer, {"result": folder}, save_analysis(answer, folder, check=not no_check), as_json, show_region)
    return DONE
