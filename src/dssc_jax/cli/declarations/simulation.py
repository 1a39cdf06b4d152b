"""Options of the commands that simulate: run, sweep, simulate, replay, explore."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import typer

from dssc_jax.cli.declarations.types import (
    DrawsOptions,
    Json,
    Local,
    LogOptions,
    Native,
    NoCheck,
    OutputOptions,
    ResultArgument,
    RunOptions,
    SeededOptions,
    Set,
    StatedOptions,
    StoredOptions,
    TrajectoryOptions,
    TrustCode,
)
from dssc_jax.proofs import SWEEP_BOXES


@dataclass(frozen=True, kw_only=True)
class Run(OutputOptions, StatedOptions, RunOptions, DrawsOptions):
    """Simulate every draw at the study's own values.

    The study's [sweep] is ignored.

    Prints the failure probability with its interval, and writes a results folder. Draws that fail are outcomes: the
    exit code is 0. With --until-width, or --accept and --reject, the run draws until it can stop, and its interval
    accounts for this. The exit code is then 1 unless the interval is narrow enough, or the loop is accepted.

    --within, --shift and --widening add an interval that holds if the laws are wrong by these amounts.
    """

    synonyms: ClassVar = ("monte-carlo", "montecarlo", "mc")

    until_width: Annotated[
        float | None, typer.Option("--until-width", metavar="W", help="Draw until the interval is no wider than W.")
    ] = None
    accept: Annotated[
        float | None, typer.Option("--accept", metavar="P0", help="Draw until a probability <= P0 is shown, or ...")
    ] = None
    reject: Annotated[
        float | None,
        typer.Option("--reject", metavar="P1", help="... or until a probability >= P1 is shown; then exit 1."),
    ] = None
    max_draws: Annotated[
        int | None, typer.Option("--max-draws", metavar="N", help="Stop undecided at so many draws [100000].")
    ] = None


@dataclass(frozen=True, kw_only=True)
class Sweep(OutputOptions, RunOptions, DrawsOptions):
    """Simulate every draw at every point of a sweep.

    The axes are those of the study's [sweep], or those given by --over.

    With --prove, figures distinguish four kinds of points: proved; not proved, but no draw fails; some draws fail; all
    draws fail. The proofs and their certificates are in proofs.json of the results folder.

    All points see the same draws. A swept value takes the place of the law of that parameter. If the folder already
    holds this study's complete result, it is shown; --fresh computes it again. If it is incomplete, the run starts
    over, unless --resume is given. Another study's folder is never touched.
    """

    over: Annotated[
        list[str] | None,
        typer.Option(
            "--over",
            metavar="NAME=LO:HI:COUNT[:log]",
            help="Sweep this parameter instead of the study's own axes; may be repeated.",
        ),
    ] = None
    prove: Annotated[
        bool, typer.Option("--prove", help="Also prove what can be proved at each point, with lag and sampling.")
    ] = False
    boxes: Annotated[
        int, typer.Option("--boxes", metavar="N", min=1, help="Boxes of uncertain numbers that --prove tries.")
    ] = SWEEP_BOXES


@dataclass(frozen=True, kw_only=True)
class Simulate(TrajectoryOptions, SeededOptions):
    """Simulate one draw and keep its trajectory.

    The study's [sweep] is ignored. Prints how the draw ended; --csv and --figure keep the trajectory.
    """

    synonyms: ClassVar = ("step", "lsim", "sim", "impulse")

    draw: Annotated[int, typer.Option("--draw", metavar="I", help="Index of the draw.")] = 0
    flight: Annotated[
        Path | None,
        typer.Option("--flight", metavar="FILE", help="Write the flight of a vehicle in 3-D over time, as HTML."),
    ] = None
    ghosts: Annotated[
        int | None, typer.Option("--ghosts", metavar="N", min=0, help="Other draws that --flight shows [32].")
    ] = None
    no_check: NoCheck = False
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class Replay(TrajectoryOptions, StoredOptions):
    """Simulate one draw of a result again, by the plain program.

    Its metrics are compared with the stored ones; exit 1 where they differ by more than rounding explains.

    In a sweep, --at picks the point (the nearest one); without it, the point where the draw's slack is smallest. A
    result whose study names code of its own needs --trust-code.
    """

    result: ResultArgument
    draw: Annotated[int, typer.Option("--draw", metavar="I", help="Index of the draw.")]
    at: Annotated[
        list[str] | None, typer.Option("--at", metavar="NAME=VALUE", help="Point of the sweep; may be repeated.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class Explore(LogOptions):
    """Move a study's numbers and see its failures move, or brush a result's draws: a page in the browser.

    For a study, all draws are simulated again whenever a slider moves: failure probability with interval, fans of the
    signals, and the worst draw. "Save" writes a study file that reproduces what is shown. For a result, brushed draws
    are counted, and a click on a draw simulates it again.

    With --log the page of a study also tells, on request, what logged flights say of the next flight and of the study,
    as `compare-log` does.

    The page is served to this machine only (127.0.0.1), under an address with a random token. Ctrl-C ends it.
    """

    subject: Annotated[str, typer.Argument(metavar="STUDY|RESULT", help="A study, or the folder of a run or sweep.")]
    settings: Set = None
    sliders: Annotated[
        list[str] | None,
        typer.Option("--slider", metavar="NAME", help="Number to move, by dotted name; may be repeated."),
    ] = None
    draws: Annotated[
        int | None, typer.Option("--draws", metavar="N", min=1, help="Number of draws [1000; 64 for a vehicle].")
    ] = None
    logs: Annotated[
        list[Path] | None,
        typer.Option("--log", metavar="FILE", help="A logged flight, as of compare-log; may be repeated."),
    ] = None
    port: Annotated[int, typer.Option("--port", metavar="P", min=0, max=65535, help="Port; 0: any free one.")] = 0
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="Open the page in the browser.")] = True
    trust_code: TrustCode = False
    allow_local: Local = False
    allow_native: Native = False
