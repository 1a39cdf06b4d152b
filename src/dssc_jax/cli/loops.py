"""Commands on the linearised loop: loop."""

from typing import Annotated

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app, default_out, load_study, output_analysis, save_analysis
from dssc_jax.core.errors import ConfigError


def parse_times(text: str | None) -> tuple[float, ...]:
    """Parse the times of ``T1,T2,..``."""
    try:
        return tuple(float(part) for part in text.split(",")) if text else ()
    except ValueError:
        raise ConfigError("--at", f"must be times in seconds, T1,T2,.., got '{text}'") from None


@app.command()
def loop(
    study: opt.StudyArgument,
    at: Annotated[
        str | None,
        typer.Option("--at", metavar="T1,T2,..", help="Linearise along the flight, at these times [the equilibrium]."),
    ] = None,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Gain, phase, delay and disk margins of the linearised loop, over all draws.

    The sampled loop is linearised as it is simulated, and broken at the command of each channel and at each
    measurement. Also prints peak sensitivities, crossover and bandwidth, each with its median and the limit that 95 %
    of all draws meet with 95 % confidence (Wilks); draws Bode, Nyquist and sensitivity fans. A vehicle hovers, or is
    linearised along its flight with --at. The study's [sweep] is ignored.
    """
    from dssc_jax.analyses.loop_margins import loop_margins
    from dssc_jax.console.loops import show_loop
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.results.analysis_folder import require_free

    times = parse_times(at)
    loaded = load_study(study, settings, draws, seed, allow_local).without_sweep()
    folder = out or default_out(loaded, "loop", settings, draws, seed, at)
    require_free(folder, "loop", loaded)
    with progress_bar(loaded, quiet=as_json) as advance:
        margins = loop_margins(loaded, times=times, progress=advance)
    output_analysis(margins, {"result": folder}, save_analysis(margins, folder, check=not no_check), as_json, show_loop)
    return DONE
