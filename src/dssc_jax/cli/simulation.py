"""Commands that simulate: run, sweep, simulate, replay."""

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dssc_jax.cli.shared import (
    DONE,
    ClusterOption,
    CsvOption,
    DrawsOption,
    EveryOption,
    FigureOption,
    JsonOption,
    LocalOption,
    OutOption,
    OverOption,
    PointOption,
    ResumeOption,
    SeedOption,
    SetOption,
    StudyArgument,
    app,
    assignment,
    attempt,
    default_out,
    load_result,
    load_study,
    parse_overs,
)
from dssc_jax.errors import ConfigError

if TYPE_CHECKING:
    from dssc_jax.results import Result
    from dssc_jax.study import Study

FIGURES = (".png", ".svg", ".pdf")


@app.command()
def run(
    study: StudyArgument,
    settings: SetOption = None,
    draws: DrawsOption = None,
    seed: SeedOption = None,
    out: OutOption = None,
    resume: ResumeOption = False,
    cluster: ClusterOption = None,
    as_json: JsonOption = False,
    allow_local: LocalOption = False,
) -> int:
    """Simulate every draw at the study's own values.

    The study's [sweep] is left aside.

    Prints the failure probability with its exact (Clopper-Pearson) interval, and writes a results folder. Draws that
    fail are outcomes: the exit code is 0.
    """
    found = load_study(study, settings, draws, seed, allow_local, cluster).without_sweep()
    altered = bool(settings or draws is not None or seed is not None)
    return finish(found, out or default_out(found, "run", altered), resume, as_json, cluster, allow_local)


@app.command()
def sweep(
    study: StudyArgument,
    over: OverOption = None,
    settings: SetOption = None,
    draws: DrawsOption = None,
    seed: SeedOption = None,
    out: OutOption = None,
    resume: ResumeOption = False,
    cluster: ClusterOption = None,
    as_json: JsonOption = False,
    allow_local: LocalOption = False,
) -> int:
    """Simulate every draw at every point of a sweep.

    The axes are those of the study's [sweep], or those given by --over.

    All points see the same draws. A swept value takes the place of the law of that parameter. Running the same study
    into the same folder again starts over, unless --resume is given; another study's folder is never touched.
    """
    found = load_study(study, settings, draws, seed, allow_local, cluster)
    if over:
        found = found.override({"sweep": parse_overs(over)})
    if not found.axes:
        raise ConfigError(found.source, "has no [sweep]; add one, or --over NAME=LO:HI:COUNT")
    altered = bool(over or settings or draws is not None or seed is not None)
    return finish(found, out or default_out(found, "sweep", altered), resume, as_json, cluster, allow_local)


@app.command()
def simulate(
    study: StudyArgument,
    draw: Annotated[int, typer.Option("--draw", metavar="I", help="Index of the draw.")] = 0,
    csv: CsvOption = None,
    figure: FigureOption = None,
    every: EveryOption = 1,
    settings: SetOption = None,
    seed: SeedOption = None,
    as_json: JsonOption = False,
    allow_local: LocalOption = False,
) -> int:
    """Simulate one draw and keep its trajectory.

    Values are the study's own. Tells how the draw ended; --csv and --figure keep the trajectory.
    """
    from dssc_jax import api

    found = load_study(study, settings, None, seed, allow_local)
    return tell_trajectory(api.simulate(found, draw, every=every), csv, figure, as_json)


@app.command()
def replay(
    result: Annotated[Path, typer.Argument(metavar="RESULT", help="A results folder.")],
    draw: Annotated[int, typer.Option("--draw", metavar="I", help="Index of the draw.")],
    at: PointOption = None,
    csv: CsvOption = None,
    figure: FigureOption = None,
    every: EveryOption = 1,
    as_json: JsonOption = False,
    allow_local: LocalOption = False,
) -> int:
    """Simulate one draw of a result again.

    Its metrics are compared with the stored ones.

    In a sweep, --at picks the point (the nearest one); without it, the point where the draw's margin is smallest.
    """
    from dssc_jax import api

    point = {}
    for text in at or []:
        name, value = assignment(text, "--at")
        try:
            point[name] = float(value)
        except ValueError:
            point[name] = math.nan
        if not math.isfinite(point[name]):
            raise ConfigError("--at", f"must be NAME=NUMBER, got '{text}'")
    return tell_trajectory(
        api.replay(load_result(result, allow_local), draw, point=point or None, every=every), csv, figure, as_json
    )


def finish(
    study: "Study", out: Path, resume: bool, as_json: bool, cluster: str | None = None, local: bool = False
) -> int:
    """Run, draw the figures, tell the result."""
    from dssc_jax import api
    from dssc_jax.console import progress_bar, show_result, tell

    folder = str(Path(study.source).resolve().parent) if local else None
    with progress_bar(study, quiet=as_json) as advance:
        result = api.run(study, out, resume=resume, progress=advance, cluster=cluster, tell=tell, local=folder)
    figures = draw_figures(result, out)
    if as_json:
        print(json.dumps(result.summary()))
    else:
        show_result(result, figures)
    return DONE


def draw_figures(result: "Result", out: Path) -> list[Path]:
    """The figures of a results folder."""
    from dssc_jax import plotting
    from dssc_jax.chunks import told

    with told(out):
        return plotting.save_all(result, out / "figures")


def tell_trajectory(found: Any, csv: Path | None, figure: Path | None, as_json: bool) -> int:
    """Keep a trajectory as asked, and tell how the draw ended."""
    from dssc_jax.console import show_draw

    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise ConfigError(str(figure), f"cannot be written: the name must end in one of {', '.join(FIGURES)}")
    if csv is not None:
        attempt(csv, lambda: found.to_dataframe().to_csv(csv, index_label="t"))
    if figure is not None:
        from dssc_jax import plotting

        attempt(figure, lambda: plotting.write(plotting.trajectory(found), figure))
    if as_json:
        from dssc_jax.console import jsonable

        print(json.dumps(jsonable(found.attrs), allow_nan=False))
    else:
        show_draw(found.attrs, [path for path in (csv, figure) if path is not None])
    return DONE
