"""Arguments and options shared by several commands: the types of single ones, and groups of them."""

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.analyses.defaults import BISECTIONS, POINTS

StudyArgument = Annotated[str, typer.Argument(metavar="STUDY", help="A study file, or the name of one of `studies`.")]
ResultArgument = Annotated[Path, typer.Argument(metavar="RESULT", help="A results folder.")]
StoredArgument = Annotated[Path, typer.Argument(metavar="FOLDER", help="The folder of a result, or of an analysis.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Override a value by dotted name; may be repeated."),
]
Draws = Annotated[int | None, typer.Option("--draws", metavar="N", help="Number of draws.")]
Seed = Annotated[int | None, typer.Option("--seed", metavar="S", help="Seed of the draws.")]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
NoCheck = Annotated[bool, typer.Option("--no-check", help="Do not simulate some draws again with twice the substeps.")]
TrustCode = Annotated[
    bool, typer.Option("--trust-code", help="Import the `module:object` names of the result's study.")
]
Local = Annotated[
    bool, typer.Option("--allow-local", help="Let `module:object` names also import from the study's own folder.")
]
Native = Annotated[
    bool, typer.Option("--allow-native", help="Load and run the shared objects and FMUs that the study names.")
]
Prove = Annotated[
    bool, typer.Option("--prove", help="Also prove the sampled loop, as far along the walk as a proof is found.")
]


class RareMethod(StrEnum):
    """Method for a rare failure probability."""

    AUTO = "auto"
    IMPORTANCE = "importance"
    SPLITTING = "splitting"


@dataclass(frozen=True, kw_only=True)
class StudyOptions:
    """Options on a study: changes of its values, and code that it may import or load."""

    study: StudyArgument
    settings: Set = None
    allow_local: Local = False
    allow_native: Native = False


@dataclass(frozen=True, kw_only=True)
class SeededOptions(StudyOptions):
    """Options on a study and on the seed of its draws."""

    seed: Seed = None


@dataclass(frozen=True, kw_only=True)
class DrawsOptions(SeededOptions):
    """Options on a study, and on the seed and the number of its draws."""

    draws: Draws = None


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Options on the folder of a result, the check of integration, and the format of the output."""

    out: Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Results folder [results/NAME-COMMAND].")] = (
        None
    )
    no_check: NoCheck = False
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class LogOptions:
    """Options on how a logged flight is read."""

    columns: Annotated[
        Path | None, typer.Option("--columns", metavar="FILE", help="Table of the log's columns, in TOML.")
    ] = None
    column: Annotated[
        list[str] | None,
        typer.Option("--column", metavar="SIGNAL=COLUMN", help="The column of a signal; may be repeated."),
    ] = None
    start: Annotated[
        float | None,
        typer.Option("--start", metavar="T", help="Time of the log at which the study begins [its first]."),
    ] = None
    segment: Annotated[
        str | None,
        typer.Option("--segment", metavar="NAME", help="Part of a ULog: armed or airborne; armed:2 the second one."),
    ] = None
    allow_damaged: Annotated[
        bool,
        typer.Option(
            "--allow-damaged",
            help="Leave out rows whose times fall; fit a log with lost messages or jumps of the estimator.",
        ),
    ] = False


@dataclass(frozen=True, kw_only=True)
class StatedOptions:
    """Options on amounts by which the laws may be wrong."""

    within: Annotated[
        list[str] | None,
        typer.Option(
            "--within",
            metavar="NAME=R",
            help="The failure probability if the laws are wrong by R: kl, chi_square or total_variation.",
        ),
    ] = None
    shift: Annotated[
        float | None, typer.Option("--shift", metavar="S", help="The same if all means are, by S standard deviations.")
    ] = None
    widening: Annotated[
        float | None, typer.Option("--widening", metavar="K", help="The same if all laws are up to K times as wide.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class StoredOptions:
    """Options on a stored result, and on code that its study may import or load."""

    as_json: Json = False
    trust_code: TrustCode = False
    allow_local: Local = False
    allow_native: Native = False


@dataclass(frozen=True, kw_only=True)
class WalkOptions:
    """Options on a walk over one number, from its safe end to the other end."""

    over: Annotated[
        str,
        typer.Option("--over", metavar="NAME=LO:HI", help="The number to walk, from its safe end to the other."),
    ]
    log: Annotated[bool, typer.Option("--log", help="Walk evenly in the logarithm.")] = False
    points: Annotated[int, typer.Option("--points", metavar="N", help="Values of the bracketing grid.")] = POINTS
    bisections: Annotated[int, typer.Option("--bisections", metavar="N", help="Halvings of a grid's cell.")] = (
        BISECTIONS
    )


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options on the use of an earlier run in the folder, and on a cluster."""

    resume: Annotated[bool, typer.Option("--resume", help="Keep what an interrupted run of this study finished.")] = (
        False
    )
    fresh: Annotated[bool, typer.Option("--fresh", help="Compute a complete result again.")] = False
    cluster: Annotated[
        str | None,
        typer.Option("--cluster", metavar="ADDRESS", help="Workers: tcp://HOST:PORT of a dask scheduler, or local:N."),
    ] = None


@dataclass(frozen=True, kw_only=True)
class TrajectoryOptions:
    """Options on the files of a trajectory."""

    csv: Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the trajectory as CSV.")] = None
    parquet: Annotated[
        Path | None, typer.Option("--parquet", metavar="FILE", help="Write the trajectory as Parquet, with units.")
    ] = None
    mcap: Annotated[
        Path | None,
        typer.Option("--mcap", metavar="FILE", help="Write the trajectory as MCAP, for Foxglove and Rerun."),
    ] = None
    figure: Annotated[Path | None, typer.Option("--figure", metavar="FILE", help="Write a figure (PNG, SVG, PDF).")] = (
        None
    )
    every: Annotated[int, typer.Option("--every", metavar="K", min=1, help="Keep every K-th sample.")] = 1
