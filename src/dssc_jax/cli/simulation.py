"""Commands that simulate: run, sweep, simulate, replay."""

import json
import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dssc_jax.cli import options as opt
from dssc_jax.cli.common import (
    DONE,
    FAILS,
    app,
    assignment,
    attempt,
    checked,
    default_out,
    load_result,
    load_study,
    parse_overs,
    require_proofs,
    warn_of_integration,
    warn_of_study,
)
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.proofs import SWEEP_BOXES

if TYPE_CHECKING:
    from dssc_jax.results.result import Result
    from dssc_jax.runs.run_until import Rule
    from dssc_jax.study import Study

FIGURES = (".png", ".svg", ".pdf")


@app.command()
def run(
    study: opt.StudyArgument,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    resume: opt.Resume = False,
    fresh: opt.Fresh = False,
    until_width: Annotated[
        float | None, typer.Option("--until-width", metavar="W", help="Draw until the interval is no wider than W.")
    ] = None,
    accept: Annotated[
        float | None, typer.Option("--accept", metavar="P0", help="Draw until a probability <= P0 is shown, or ...")
    ] = None,
    reject: Annotated[float | None, typer.Option("--reject", metavar="P1", help="... one >= P1; exit 1 then.")] = None,
    max_draws: Annotated[
        int | None, typer.Option("--max-draws", metavar="N", help="Stop undecided at so many draws [100000].")
    ] = None,
    cluster: opt.ClusterOption = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Simulate every draw at the study's own values.

    The study's [sweep] is ignored.

    Prints the failure probability with its interval, and writes a results folder. Draws that fail are outcomes: the
    exit code is 0. With --until-width, or --accept and --reject, the draws decide their number; the interval is the
    sequential one, which stays valid, and the exit code is 1 unless the
    rule is met (narrow enough, or accepted).
    """
    rule = stopping_rule(until_width, accept, reject)
    loaded = load_study(study, settings, draws, seed, allow_local, cluster).without_sweep()
    if rule is not None:
        require_unset("a data-driven stop", draws=draws, resume=resume or None, cluster=cluster)
        return finish_sequential(loaded, rule, max_draws, out, as_json, check=not no_check)
    require_unset("a fixed number of draws", max_draws=max_draws)
    return finish(
        loaded,
        out or default_out(loaded, "run", settings, draws, seed),
        resume,
        as_json,
        cluster,
        allow_local,
        fresh=fresh,
        check=not no_check,
    )


@app.command()
def sweep(
    study: opt.StudyArgument,
    over: opt.Over = None,
    settings: opt.Set = None,
    draws: opt.Draws = None,
    seed: opt.Seed = None,
    out: opt.Out = None,
    resume: opt.Resume = False,
    fresh: opt.Fresh = False,
    cluster: opt.ClusterOption = None,
    prove: Annotated[
        bool, typer.Option("--prove", help="Also prove what can be proved at each point, with lag and sampling.")
    ] = False,
    boxes: Annotated[
        int,
        typer.Option("--boxes", metavar="N", min=1, help="Boxes of uncertain numbers that --prove tries."),
    ] = SWEEP_BOXES,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Simulate every draw at every point of a sweep.

    The axes are those of the study's [sweep], or those given by --over.

    With --prove, figures tell four things apart: points that are proved, that survive every draw, that fail in some
    draws, and in all. The proofs and their certificates are in proofs.json of the results folder.

    All points see the same draws. A swept value takes the place of the law of that parameter. The same study into the
    same folder again: a complete result is shown, --fresh computes it again; an incomplete one starts over, unless
    --resume is given. Another study's folder is never touched.
    """
    loaded = load_study(study, settings, draws, seed, allow_local, cluster)
    if over:
        loaded = loaded.override({"sweep": parse_overs(over)})
    if not loaded.axes:
        raise ConfigError(loaded.source, "has no [sweep]; add one, or --over NAME=LO:HI:COUNT")
    if prove:
        require_provable(loaded)
    out = out or default_out(loaded, "sweep", over, settings, draws, seed)
    proved = boxes if prove else None
    return finish(loaded, out, resume, as_json, cluster, allow_local, proved, fresh, check=not no_check)


@app.command()
def simulate(
    study: opt.StudyArgument,
    draw: Annotated[int, typer.Option("--draw", metavar="I", help="Index of the draw.")] = 0,
    csv: opt.Csv = None,
    figure: opt.Figure = None,
    every: opt.Every = 1,
    settings: opt.Set = None,
    seed: opt.Seed = None,
    no_check: opt.NoCheck = False,
    as_json: opt.Json = False,
    allow_local: opt.Local = False,
) -> int:
    """Simulate one draw and keep its trajectory.

    Values are the study's own. Tells how the draw ended; --csv and --figure keep the trajectory.
    """
    from dssc_jax.console.terminal import announce_compiling
    from dssc_jax.runs import trajectory as trajectories

    loaded = load_study(study, settings, None, seed, allow_local)
    warn_of_study(loaded)
    require_writable(csv, figure)
    trajectories.lane_values(loaded.without_sweep(), draw, {})  # bad input is reported before anything is compiled
    announce_compiling(loaded, quiet=as_json)
    trajectory = trajectories.simulate(loaded, draw, every=every)
    if not no_check:
        warn_of_integration(checked(loaded.without_sweep()))
    return output_trajectory(trajectory, csv, figure, as_json)


@app.command()
def replay(
    result: opt.ResultArgument,
    draw: Annotated[int, typer.Option("--draw", metavar="I", help="Index of the draw.")],
    at: opt.PointOption = None,
    csv: opt.Csv = None,
    figure: opt.Figure = None,
    every: opt.Every = 1,
    as_json: opt.Json = False,
    trust_code: opt.TrustCode = False,
    allow_local: opt.Local = False,
) -> int:
    """Simulate one draw of a result again, by the plain program.

    Its metrics are compared with the stored ones; exit 1 where they differ by more than rounding explains.

    In a sweep, --at picks the point (the nearest one); without it, the point where the draw's slack is smallest.
    A result whose study names code of its own needs --trust-code.
    """
    from dssc_jax.console.terminal import announce_compiling
    from dssc_jax.runs import trajectory as trajectories
    from dssc_jax.study import Described

    point = {}
    for text in at or []:
        name, value = assignment(text, "--at")
        try:
            point[name] = float(value)
        except ValueError:
            point[name] = math.nan
        if not math.isfinite(point[name]):
            raise ConfigError("--at", f"must be NAME=NUMBER, got '{text}'")
    stored = load_result(result, trust_code, allow_local)
    require_writable(csv, figure)
    trajectories.point_of(stored, draw, point)
    announce_compiling(stored.study, quiet=as_json or isinstance(stored.study, Described))
    trajectory = trajectories.replay(stored, draw, point=point or None, every=every)
    done = output_trajectory(trajectory, csv, figure, as_json)
    return FAILS if trajectory.attrs["agreement"] == "differs" else done


def stopping_rule(width: float | None, accept: float | None, reject: float | None) -> "Rule | None":
    """The stopping rule given by the options."""
    if width is accept is reject is None:
        return None
    if width is not None and (accept is not None or reject is not None):
        raise ConfigError("--until-width", "cannot be combined with --accept and --reject")
    if width is None and (accept is None or reject is None):
        raise ConfigError("--accept" if accept is None else "--reject", "is missing; the two go together")
    from dssc_jax.statistics import AcceptReject, UntilWidth

    try:
        if width is not None:
            return UntilWidth(width)
        assert accept is not None
        assert reject is not None
        return AcceptReject(accept, reject)
    except ValueError as error:
        raise ConfigError("--until-width" if width is not None else "--accept", str(error)) from None


def require_unset(purpose: str, **options: Any) -> None:
    """Require that options without a meaning here are not given."""
    for name, value in options.items():
        if value is not None:
            raise ConfigError(f"--{name.replace('_', '-')}", f"has no meaning with {purpose}")


def finish_sequential(
    study: "Study", rule: "Rule", most: int | None, out: Path | None, as_json: bool, check: bool
) -> int:
    """Make draws until the stopping rule is met."""
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.runs.run_until import MOST_DRAWS, run_until

    warn_of_study(study)
    most = MOST_DRAWS if most is None else most
    out = out or default_out(study.override({"draws": most}), f"run-{rule.slug}", most)
    with progress_bar(study, quiet=as_json, early="the rule is met") as advance:
        result = run_until(study, rule, out, most=most, progress=advance, check=check)
    output_result(result, out, as_json)
    return DONE if result.manifest["stopping"]["verdict"] in ("narrow", "accepted") else FAILS


def require_provable(study: "Study") -> None:
    """Check that proofs are installed and cover the study's points, before anything is simulated.

    Raises:
        ConfigError: they do not.
    """
    require_proofs()
    from dssc_jax.design.certification import NotCovered
    from dssc_jax.proofs.coverage import problem_of
    from dssc_jax.runs.prove_sweep import sweep_points

    try:
        problem_of(next(sweep_points(study)))
    except NotCovered as error:
        raise ConfigError(study.source, f"is outside of what a proof covers: {error}") from None


def proved_sweep(result: "Result", out: Path, boxes: int, quiet: bool) -> "Result":
    """Prove every point of a sweep, and keep the proofs in the results folder."""
    from dssc_jax.console.terminal import progress_bar
    from dssc_jax.runs.prove_sweep import prove_sweep

    with progress_bar(result.study, quiet=quiet, of="proofs", compiles=False) as advance:
        proofs = prove_sweep(result.study, boxes=boxes, progress=advance)
    attempt(out, lambda: proofs.save(out))
    return result.with_proofs(proofs)


def finish(
    study: "Study",
    out: Path,
    resume: bool,
    as_json: bool,
    cluster: str | None = None,
    local: bool = False,
    boxes: int | None = None,
    fresh: bool = False,
    check: bool = True,
) -> int:
    """Simulate all draws unless a complete result has them, and prove every point if there is a number of boxes."""
    from dssc_jax.console.terminal import notify, progress_bar
    from dssc_jax.runs import run as running

    if not fresh and (result := complete_result(study, out)) is not None:
        notify(f"{out} is complete, computed {result.manifest['started']}; --fresh computes it again")
        if boxes is not None and not result.proofs:
            result = proved_sweep(result, out, boxes, as_json)
        output_result(result, out, as_json)
        return DONE
    warn_of_study(study)
    folder = str(Path(study.source).resolve().parent) if local else None
    with progress_bar(study, quiet=as_json) as advance:
        result = running.run(
            study,
            out,
            resume=resume,
            progress=advance,
            cluster=cluster,
            notify=notify,
            local=folder,
            check=check,
        )
    if boxes is not None:
        result = proved_sweep(result, out, boxes, as_json)
    output_result(result, out, as_json)
    return DONE


def complete_result(study: "Study", out: Path) -> "Result | None":
    """The complete result of the same study in a folder, computed with the same software and device; None otherwise."""
    from dssc_jax.engine.batching import computing
    from dssc_jax.results.manifest import MANIFEST, code_entries, machinery_differences, read_manifest

    if not (out / MANIFEST).exists():
        return None
    from dssc_jax.results.result import Result
    from dssc_jax.results.store import read_dataset

    try:
        manifest = read_manifest(out)
        same = manifest["hash"] == study.hash and manifest.get("complete") and not manifest.get("stopping")
        if not same or machinery_differences(manifest, {**computing(), **code_entries(study)}):
            return None
        return Result.of(study, read_dataset(out, study, manifest), manifest, out)
    except ConfigError:  # damaged: it is computed again
        return None


def output_result(result: "Result", out: Path, as_json: bool) -> None:
    """Show the result, then draw its figures, which take longer."""
    warn_of_integration(result.manifest.get("integration"))
    from dssc_jax.console.results import show_figures, show_result
    from dssc_jax.results.blocks import writing

    if as_json:
        sys.stdout.writelines(line.replace("\n", "") for line in result.lines())
        print(flush=True)
    else:
        show_result(result)
    import dssc_jax.plotting as plotting

    with writing(out):
        figures = plotting.save_all(result, out / "figures")
    if not as_json:
        show_figures(figures)


def require_writable(csv: Path | None, figure: Path | None) -> None:
    """Require that the files of a trajectory can be written, before it is simulated.

    Raises:
        ConfigError: the figure's type is unknown, or a folder does not exist.
    """
    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise ConfigError(str(figure), f"cannot be written: the name must end in one of {', '.join(FIGURES)}")
    for file in (csv, figure):
        if file is not None and not file.parent.is_dir():
            raise ConfigError(str(file), "cannot be written: there is no such folder")


def write_table(trajectory: Any, path: Path) -> None:
    """Write a trajectory as CSV."""
    with files.replacing(path) as file:
        trajectory.to_dataframe().to_csv(file, index_label="t")


def output_trajectory(trajectory: Any, csv: Path | None, figure: Path | None, as_json: bool) -> int:
    """Write the requested files of a trajectory, and show how the draw ended."""
    from dssc_jax.console.draws import show_draw

    if csv is not None:
        attempt(csv, lambda: write_table(trajectory, csv))
    if figure is not None:
        import dssc_jax.plotting as plotting

        attempt(figure, lambda: plotting.write(plotting.trajectory(trajectory), figure))
    if as_json:
        from dssc_jax.results.summary import jsonable

        print(json.dumps(jsonable(trajectory.attrs), allow_nan=False))
    else:
        show_draw(trajectory.attrs, [path for path in (csv, figure) if path is not None])
    return DONE
