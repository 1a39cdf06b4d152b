"""Commands on how robust a loop is: margin, theory, compare."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import DONE, app, default_out, load_study
from dssc_jax.core.errors import ConfigError

if TYPE_CHECKING:
    from dssc_jax.analyses.comparison import MarginContest
    from dssc_jax.study import Study

WalkOption = Annotated[
    str, typer.Option("--over", metavar="NAME=LO:HI", help="The number to walk, from its safe end to the other.")
]
LogOption = Annotated[bool, typer.Option("--log", help="Walk evenly in the logarithm.")]
PointsOption = Annotated[int, typer.Option("--points", metavar="N", help="Values of the bracketing grid.")]
BisectionsOption = Annotated[int, typer.Option("--bisections", metavar="N", help="Halvings of a grid's cell.")]
SWITCHING = ("sta", "smc")
WALKED = {"of": "simulations", "early": "every critical value is found"}


def parse_bounds(text: str) -> tuple[str, tuple[float, float]]:
    """Name and bounds of ``NAME=LO:HI``."""
    try:
        name, value = text.split("=")
        start, end = map(float, value.split(":"))
    except ValueError:
        raise ConfigError("--over", f"must be NAME=LO:HI, got '{text}'") from None
    return name, (start, end)


@app.command()
def margin(
    study: opt.Study,
    over: WalkOption,
    log: LogOption = False,
    points: PointsOption = 17,
    bisections: BisectionsOption = 14,
    controllers: Annotated[
        str | None, typer.Option("--controllers", metavar="A,B,..", help="Of each of these, on the same draws.")
    ] = None,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Find every draw's critical value of one number.

    The walk starts at LO, where draws are expected to pass; HI may be the lower end. `spread` in the place of a name
    widens all laws together.

    Prints the median, the value up to which 95 % of all draws pass with 95 % confidence (Wilks), the share of draws
    without a critical value between the bounds, the share that passes again beyond a failure, and what Theorem 1 says.
    """
    from dssc_jax import plotting
    from dssc_jax.analyses.margins import margin as find
    from dssc_jax.console import jsonable, progress_bar, show_margin_contest, show_margins
    from dssc_jax.results.analysis_folder import require_free

    name, bounds = parse_bounds(over)
    walk = {"over": name, "bounds": bounds, "log": log, "points": points, "bisections": bisections}
    loaded = load_study(study, settings, draws, seed, allow_local)
    command = f"margin-{name}" if controllers is None else f"margins-{name}"
    folder = out or default_out(loaded, command, settings, draws, seed)
    with progress_bar(loaded, quiet=as_json, **WALKED) as advance:
        if controllers is None:
            require_free(folder, "margin")
            found = find(loaded, **walk, progress=advance)
            figure, show = plotting.margin(found), show_margins
        else:
            found = compare_margins_of(loaded, controllers, folder, walk, advance)
            figure, show = plotting.theory(found.margins), show_margin_contest
    found.save(folder)
    figures = plotting.save_figure(figure, folder / "figures", "margin")
    summary = found.summary() | {"result": str(folder)}
    if as_json:
        print(json.dumps(jsonable(summary), allow_nan=False))
    else:
        show(summary, [folder, *figures])
    return DONE


def compare_margins_of(
    study: "Study", controllers: str, folder: Path, walk: dict[str, Any], progress: Callable[..., None]
) -> "MarginContest":
    """Margins of several controllers; their folder is checked before anything is simulated."""
    from dssc_jax.analyses.comparison import compare_margins
    from dssc_jax.results.analysis_folder import require_free

    names = split_names(controllers)
    for name in names:
        require_free(folder / name, "margin")
    return compare_margins(study, names, **walk, progress=progress)


def split_names(text: str) -> list[str]:
    """The names of ``A,B,..``."""
    return [name.strip() for name in text.split(",")]


@app.command()
def theory(
    study: opt.Study,
    over: WalkOption,
    log: LogOption = False,
    points: PointsOption = 17,
    bisections: BisectionsOption = 14,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Say what theory and simulation have to say of one number, side by side.

    Theorem 1 where it speaks, the linearised loop's local margin, describing functions (over unmodelled.mu), and the
    simulated margin. They answer different questions; where one of them does not apply, the answer says why.
    """
    from dssc_jax import plotting
    from dssc_jax.analyses.theory import beside
    from dssc_jax.cli.statistics import keep, place
    from dssc_jax.console import progress_bar, show_theory

    name, bounds = parse_bounds(over)
    loaded = load_study(study, settings, draws, seed, allow_local)
    folder = out or default_out(loaded, f"theory-{name}", settings, draws, seed)
    path = place(folder, "theory.json", loaded)
    rivals = switching_rivals(loaded)
    with progress_bar(loaded, quiet=as_json, **WALKED) as advance:
        found = beside(
            loaded,
            over=name,
            bounds=bounds,
            log=log,
            points=points,
            bisections=bisections,
            rivals=rivals,
            progress=advance,
        )
    content = keep(path, found.summary(), loaded)
    figure = plotting.theory(found.margins, found.oscillations, found.edge)
    figures = plotting.save_figure(figure, folder / "figures", "theory")
    if as_json:
        print(json.dumps(content, allow_nan=False))
    else:
        show_theory(content, [path, *figures])
    return DONE


def switching_rivals(study: "Study") -> dict[str, "Study"]:
    """The study under the laws that have a describing function, where their gains follow from it."""
    from dssc_jax.analyses.comparison import controller_table, with_controller

    found = {}
    for name in SWITCHING:
        try:
            found[name] = with_controller(study, name, controller_table(study, name))
        except ConfigError:
            continue
    return found


@app.command()
def compare(
    study: opt.Study,
    controllers: Annotated[
        str, typer.Option("--controllers", metavar="A,B,..", help="Kinds, or names of the study's [compare.NAME].")
    ],
    tune: Annotated[
        int | None, typer.Option("--tune", metavar="N", help="Candidates tried for each controller; 0: none [64].")
    ] = None,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Compare controllers on the same draws and noise.

    Gains that the study does not give follow from DSSC's; --tune also tunes all on equal budgets.

    Prints failure probabilities, and for every pair the difference with its interval and an exact paired test. What is
    tuned is tuned on draws of its own. Plants of several channels are not tuned.
    """
    from dssc_jax import plotting
    from dssc_jax.analyses.comparison import compare as contest
    from dssc_jax.analyses.comparison.tuning import CANDIDATES
    from dssc_jax.console import jsonable, progress_bar, show_comparison
    from dssc_jax.results.analysis_folder import require_free

    loaded = load_study(study, settings, draws, seed, allow_local)
    folder = out or default_out(loaded, "compare", settings, draws, seed)
    require_free(folder, "compare")
    names = split_names(controllers)
    usual = CANDIDATES if len(loaded.loop.channels) == 1 else 0
    with progress_bar(loaded, quiet=as_json, of="runs") as advance:
        found = contest(loaded, names, candidates=usual if tune is None else tune, progress=advance)
    found.save(folder)
    figures = plotting.save_figure(plotting.comparison(found), folder / "figures", "compare")
    summary = found.summary() | {"result": str(folder)}
    if as_json:
        print(json.dumps(jsonable(summary), allow_nan=False))
    else:
        show_comparison(summary, [folder, *figures])
    return DONE
