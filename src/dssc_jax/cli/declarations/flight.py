"""Options of the commands on flight computers and logs: airframe, code, library, log, compare-log."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.cli.declarations.types import DrawsOptions, Json, LogOptions, OutputOptions, StudyOptions


@dataclass(frozen=True, kw_only=True)
class Airframe:
    """Show a PX4 airframe as the table [plant] of a study.

    Takes the rotors' places, axes and spins from CA_ROTOR.., mass, inertia, thrust, lag and drag from SIH_.., and gains
    from MC_.. and MPC_... A mass that the file does not set is refused. Comments name what is estimated or left out.
    """

    file: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="A PX4 airframe script, a ground station's file, or a .ulg."),
    ]
    mass: Annotated[
        float | None, typer.Option("--mass", metavar="KG", min=1e-3, help="Mass, in place of SIH_MASS [kg].")
    ] = None
    arm: Annotated[
        float | None,
        typer.Option("--arm", metavar="M", min=1e-3, help="Length that multiplies all positions [m]."),
    ] = None
    cascade: Annotated[
        bool, typer.Option("--cascade", help="PX4's cascade as inner loop, with the file's gains, for the article's.")
    ] = False
    hover_speed: Annotated[
        float | None,
        typer.Option(
            "--hover-speed", metavar="RAD/S", min=1.0, help="Mean rotor speed in hover [rad/s], of which PX4 has none."
        ),
    ] = None
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class Code(StudyOptions):
    """Write the sampled controller as C99, with a bench that compares it bit by bit with the analysis.

    Differentiator and controller of every channel come from the functions that the analysis runs. `make -C DIR` replays
    recorded draws and compares every bit; docs/flight.md tells how to do so for ARM. For float32 give
    --set loop.precision=32. With --fmu the same source becomes an FMU, with its library if there is a C compiler.

    With --monitor the certificate of `dssc-jax prove` is verified, and a monitor is written beside the controller. At
    each sample it tells which bound or premise of the certificate the flight has left. A certificate that the verifier
    rejects, or that belongs to another loop than the study's, is refused with exit code 2.
    """

    out: Annotated[Path, typer.Option("--out", metavar="DIR", help="The folder to write.")]
    draws: Annotated[int, typer.Option("--draws", metavar="N", min=1, help="Draws to record for the bench.")] = 32
    samples: Annotated[
        int | None, typer.Option("--samples", metavar="K", min=1, help="Samples of each draw [all, at most 2000].")
    ] = None
    fmu: Annotated[
        bool, typer.Option("--fmu", help="Write the controller as an FMU for co-simulation (FMI 2.0) beside it.")
    ] = False
    monitor: Annotated[
        Path | None,
        typer.Option("--monitor", metavar="CERTIFICATE", help="A certificate of the study's loop, for a monitor."),
    ] = None
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class Library:
    """Build your controller in C, and show what it exports.

    The source has the functions and types of the headers that `dssc-jax code` writes, and ends with a description of
    the controller; --template writes an example to fill in. What `dssc-jax code` writes can be built, too. A study uses
    the library by [controller] kind = "library".

    The command loads and runs the library: it flies two flights, alone and in turn, and refuses a controller that keeps
    state outside of its structure. It shows an existing shared object (.so) without building.
    """

    sources: Annotated[
        list[Path] | None, typer.Argument(metavar="FILE.c ...", help="Its source files, or one shared object.")
    ] = None
    template: Annotated[
        Path | None, typer.Option("--template", metavar="FILE.c", help="Write an example to fill in.")
    ] = None
    out: Annotated[
        Path | None, typer.Option("--out", metavar="FILE.so", help="The library [the first source's name, .so].")
    ] = None
    include: Annotated[
        list[Path] | None, typer.Option("--include", metavar="DIR", help="A folder of headers; may be repeated.")
    ] = None
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class Log:
    """What does this log hold?

    Lists the topics of a ULog of PX4 with their number of messages, rate and span, and when the vehicle was armed and
    airborne. Times count from the beginning of the log. With --topic also the fields of a topic with their values;
    those marked with * are in the axes of the model: position in east, north, up, and the angles phi, theta, psi of a
    body whose axes point forward, left, up. Of a CSV or Parquet file, lists the columns.

    A file of any size is read message by message: memory holds the topics of --topic, and no others.
    """

    file: Annotated[
        list[Path], typer.Argument(metavar="FILE...", help="ULogs of PX4 (.ulg), CSV or Parquet files; any number.")
    ]
    topic: Annotated[
        list[str] | None,
        typer.Option("--topic", metavar="NAME", help="A topic whose fields to show; may be repeated."),
    ] = None
    csv: Annotated[
        Path | None,
        typer.Option("--csv", metavar="OUT", help="Write the one --topic of the one FILE as a table with its times t."),
    ] = None
    segment: Annotated[
        str | None, typer.Option("--segment", metavar="NAME", help="With --csv, only the part armed or airborne.")
    ] = None
    start: Annotated[
        float | None,
        typer.Option("--start", metavar="T", help="With --csv, the time of the log at which t is 0 [its beginning]."),
    ] = None
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class CompareLog(OutputOptions, LogOptions, DrawsOptions):
    """Is this logged flight one of the flights that were analysed?

    Replays the logged measurements through the analysed controller and compares its commands with the logged ones. Lays
    the log over the study's draws, tells which signal leaves their range and since when, and gives a p-value that is
    exact for any time series: the rank of the log among the draws by its largest standardised departure. Signals are y,
    y_dot, y_ref, y_ref_dot, y_ref_ddot and u_total; those of a channel x are x_y and so on. Without a table, the log's
    columns must have these names, and t. The study's [sweep] is ignored.

    With several logs the answer is a set in which the next flight lies with the probability of --probability: a band of
    all signals, and limits of metrics. It assumes that flights are exchangeable, and no law. It also tells whether the
    flights refute the study, and how many flights would refute or confirm it.

    With --fit the plant's numbers are estimated instead, and their laws are proposed as TOML. The exit code is 1, with
    the reason, if the flight does not identify them, or if the study does not describe the flight, and 2 if a reference
    or command of the log is that of the study with another sign, in another unit or column.

    The exit code is 0 for an answer with warnings, too. With --json they are one list, `warnings`, each with the
    signal that it concerns and its text, and `warned` tells whether there is any.
    """

    log: Annotated[
        list[Path],
        typer.Argument(metavar="LOG...", help="CSV or Parquet files, or ULogs of PX4 (.ulg); one for each flight."),
    ]
    probability: Annotated[
        float | None,
        typer.Option("--probability", metavar="P", help="Of the next flight, with several logs [0.9]; needs P/(1-P)."),
    ] = None
    fit: Annotated[
        bool, typer.Option("--fit", help="Estimate numbers that have laws, and propose narrower laws; --out FILE.toml.")
    ] = False
    simulations: Annotated[
        int | None,
        typer.Option(
            "--simulations",
            metavar="N",
            min=1,
            help="With --fit, after which the search ends with the best so far [2000]; its refinement takes more.",
        ),
    ] = None
    minutes: Annotated[
        float | None,
        typer.Option("--minutes", metavar="M", min=0.0, help="With --fit, likewise, by time [no limit]."),
    ] = None
    number: Annotated[
        list[str] | None,
        typer.Option(
            "--number", metavar="NAME", help="A number to estimate, repeatable [all that the flight identifies]."
        ),
    ] = None
