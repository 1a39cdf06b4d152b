"""dssc-jax region: where two numbers are safe."""

from dssc_jax.analyses.region.safe_region import RegionAxis, region
from dssc_jax.cli.analysing import finish, free_folder
from dssc_jax.cli.declarations.robustness import Region
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.cli.loading import study_of
from dssc_jax.cli.parsing import parse_assignment
from dssc_jax.console.regions import show_region
from dssc_jax.console.terminal import progress_bar
from dssc_jax.core.errors import ConfigError


def run(options: Region) -> int:
    """Follow the boundary of the region, save and print it."""
    if len(options.over) != 2:
        raise ConfigError("--over", f"must be given twice, got {len(options.over)}")
    first, second = map(parse_axis, options.over)
    study = study_of(options).without_sweep()
    name = f"region-{first.name}-{second.name}"
    folder = free_folder(study, "region", options.out, options.settings, options.draws, options.seed, ending=name)
    with progress_bar(study, quiet=options.as_json, unit="simulations") as advance:
        safe = region(study, over=(first, second), halvings=options.halvings, progress=advance)
    finish(safe, folder, options, show_region)
    return DONE


def parse_axis(text: str) -> RegionAxis:
    """Parse ``NAME=LO:HI[:log]`` to a number and its range.

    Raises:
        ConfigError: The text has another form, or the range is not valid.
    """
    name, value = parse_assignment(text, "--over")
    low, colon, remainder = value.partition(":")
    high, _, scale = remainder.partition(":")
    try:
        if not colon or scale not in ("", "log"):
            raise ValueError
        return RegionAxis(name, float(low), float(high), scale == "log")
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI[:log], got '{text}'") from None
