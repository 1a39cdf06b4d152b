"""Commands on a loop's robustness: margin, theory, compare."""

import re
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dssc_jax.analyses.defaults import BISECTIONS, CANDIDATES, POINTS
from dssc_jax.cli import options as opt
from dssc_jax.cli.common import (
    DONE,
    app,
    default_out,
    load_study,
    output_analysis,
    parse_bounds,
    require_proofs,
    save_analysis,
    show_code,
)
from dssc_jax.core.errors import ConfigError

if TYPE_CHECKING:
    from dssc_jax.study import Study

WalkOption = Annotated[
    str, typer.Option("--over", metavar="NAME=LO:HI", help="The number to walk, from its safe end to the other.")
]
LogOption = Annotated[bool, typer.Option("--log", help="Walk evenly in the logarithm.")]
PointsOption = Annotated[int, typer.Option("--points", metavar="N", help="Values of the bracketing grid.")]
ProveOption = Annotated[
    bool, typer.Option("--prove", help="Also prove the sampled loop, as far along the walk as a proof is found.")
]
BisectionsOption = Annotated[int, typer.Option("--bisections", metavar="N", help="Halvings of a grid's cell.")]
WALKED: dict[str, Any] = {"of": "simulations", "early": "every critical value is found"}


@app.command()
def margin(
    study: opt.StudyArgument,
    over: WalkOption,
    log: LogOption = False,
    points: PointsOption = POINTS,
    bisections: BisectionsOption = BISECTIONS,
    controllers: Annotated[
        str | None, typer.Option("--controllers", metavar="A,B,..", help="Of each of these, on the same draws.")
    ] = None,
    prove: ProveOption = False,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Find every draw's critical value of one number.

    The walk starts at LO, where draws are expected to pass; HI may be the lower end. `spread` in the place of a name
    widens all laws together.

    Prints the median, the value up to which 95 % of all draws pass with 95 % confidence (Wilks), the share of draws
    without a critical value between the bounds, the share that passes again beyond a failure, and what Theorem 1 says.
    With --prove, it also tells how far the sampled loop is proved, for all plants of the laws at once.
    """
    if prove:
        require_proofs()
    if prove and controllers is not None:
        raise ConfigError("--prove", "is not for --controllers: prove each with `dssc-jax prove --over`")
    from dssc_jax.analyses.comparison import compare_margins, with_own_controllers
    from dssc_jax.analyses.margins import margin as find
    from dssc_jax.console.margins import show_margin_contest, show_margins
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.results.analysis_folder import require_free

    name, bounds = parse_bounds(over)
    walk: dict[str, Any] = {"over": name, "bounds": bounds, "log": log, "points": points, "bisections": bisections}
    loaded = load_study(study, settings, draws, seed, allow_local).without_sweep()
    names = [] if controllers is None else named(controllers)
    loaded = with_own_controllers(loaded, names)
    kind = "margin" if controllers is None else "margins"
    folder = out or default_out(loaded, f"{kind}-{name}", settings, draws, seed)
    require_free(folder, kind, loaded)
    with progress_bar(loaded, quiet=as_json, **WALKED) as advance:
        if controllers is None:
            margins, show = find(loaded, **walk, prove=prove, progress=advance), show_margins
        else:
            margins, show = compare_margins(loaded, names, **walk, progress=advance), show_margin_contest
    output_analysis(margins, {"result": folder}, save_analysis(margins, folder, check=not no_check), as_json, show)
    return DONE


def named(text: str) -> list[str]:
    """Parse the names of ``A,B,..``, and show which code is about to run if some are of one's own."""
    names = [name.strip() for name in text.split(",")]
    if any(set(name) & set("; +&") for name in names):
        wanted = ",".join(re.split(r"[\s,;+&]+", text.strip()))
        raise ConfigError("--controllers", f"takes names separated by commas; did you mean '{wanted}'?")
    show_code("command", {"names": names})
    return names


@app.command()
def theory(
    study: opt.StudyArgument,
    over: WalkOption,
    log: LogOption = False,
    points: PointsOption = POINTS,
    bisections: BisectionsOption = BISECTIONS,
    prove: ProveOption = False,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Say what theory and simulation have to say of one number, side by side.

    Theorem 1 where it speaks, the linearised loop's local margin, describing functions (over unmodelled.mu), and the
    simulated margin. They answer different questions; where one of them does not apply, the answer says why. With
    --prove, also how far the sampled loop is proved, for all plants of the laws at once.
    """
    if prove:
        require_proofs()
    from dssc_jax.analyses.theory import assess
    from dssc_jax.console.margins import show_theory
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.results.analysis_folder import require_free

    name, bounds = parse_bounds(over)
    walk: dict[str, Any] = {"over": name, "bounds": bounds, "log": log, "points": points, "bisections": bisections}
    loaded = load_study(study, settings, draws, seed, allow_local).without_sweep()
    folder = out or default_out(loaded, f"theory-{name}", settings, draws, seed)
    require_free(folder, "theory", loaded)
    rivals = switching_rivals(loaded)
    with progress_bar(loaded, quiet=as_json, **WALKED) as advance:
        assessment = assess(loaded, **walk, rivals=rivals, prove=prove, progress=advance)
    output_analysis(
        assessment, {"result": folder}, save_analysis(assessment, folder, check=not no_check), as_json, show_theory
    )
    return DONE


def switching_rivals(study: "Study") -> dict[str, "Study"]:
    """The study with each controller that has a describing function, if its gains follow from the study."""
    from dssc_jax.analyses.comparison import controller_table, switching_kinds, with_controller

    rivals = {}
    for name in switching_kinds():
        try:
            rivals[name] = with_controller(study, name, controller_table(study, name))
        except ConfigError:
            continue
    return rivals


@app.command()
def compare(
    study: opt.StudyArgument,
    controllers: Annotated[
        str,
        typer.Option(
            "--controllers", metavar="A,B,..", help="Kinds, names of [compare.NAME], or your own module:OBJECT."
        ),
    ],
    tune: Annotated[
        int | None,
        typer.Option("--tune", metavar="N", help=f"Candidates tried for each controller; 0: none [{CANDIDATES}]."),
    ] = None,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Compare controllers on the same draws and noise.

    Gains that the study does not give follow from DSSC's; --tune also tunes all on equal budgets.

    Prints failure probabilities, and for every pair the difference with its interval and an exact paired test. What is
    tuned is tuned on draws of its own. Plants of several channels are not tuned.
    """
    from dssc_jax.analyses.comparison import compare as contest
    from dssc_jax.analyses.comparison import with_own_controllers
    from dssc_jax.console.analyses import show_comparison
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.results.analysis_folder import require_free

    loaded = load_study(study, settings, draws, seed, allow_local).without_sweep()
    loaded = with_own_controllers(loaded, names := named(controllers))
    folder = out or default_out(loaded, "compare", settings, draws, seed)
    require_free(folder, "compare", loaded)
    usual = CANDIDATES if len(loaded.loop.channels) == 1 else 0
    candidates = usual if tune is None else tune
    with progress_bar(loaded, quiet=as_json, of="runs") as advance:
        comparison = contest(loaded, names, candidates=candidates, progress=advance)
    output_analysis(
        comparison, {"result": folder}, save_analysis(comparison, folder, check=not no_check), as_json, show_comparison
    )
    return DONE
