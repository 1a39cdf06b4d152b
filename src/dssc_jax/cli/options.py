"""Arguments and options shared by several commands, as the types of their parameters."""

from pathlib import Path
from typing import Annotated

import typer

StudyArgument = Annotated[str, typer.Argument(metavar="STUDY", help="A study file, or the name of one of `studies`.")]
Set = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="NAME=VALUE", help="Override a value by dotted name; may be repeated."),
]
Over = Annotated[
    list[str] | None,
    typer.Option(
        "--over",
        metavar="NAME=LO:HI:COUNT[:log]",
        help="Sweep this parameter instead of the study's own axes; may be repeated.",
    ),
]
Draws = Annotated[int | None, typer.Option("--draws", metavar="N", help="Number of draws.")]
Seed = Annotated[int | None, typer.Option("--seed", metavar="S", help="Seed of the draws.")]
Out = Annotated[Path | None, typer.Option("--out", metavar="DIR", help="Results folder [results/NAME-COMMAND].")]
Resume = Annotated[bool, typer.Option("--resume", help="Keep what an interrupted run of this study finished.")]
Fresh = Annotated[bool, typer.Option("--fresh", help="Compute a complete result again.")]
ClusterOption = Annotated[
    str | None,
    typer.Option("--cluster", metavar="ADDRESS", help="Workers: tcp://HOST:PORT of a dask scheduler, or local:N."),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
NoCheck = Annotated[bool, typer.Option("--no-check", help="Do not simulate some draws again with twice the substeps.")]
Local = Annotated[
    bool, typer.Option("--allow-local", help="Let `module:object` names also import from the study's own folder.")
]
TrustCode = Annotated[
    bool, typer.Option("--trust-code", help="Import the `module:object` names of the result's study.")
]
PointOption = Annotated[
    list[str] | None, typer.Option("--at", metavar="NAME=VALUE", help="Point of the sweep; may be repeated.")
]
Csv = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the trajectory as CSV.")]
Figure = Annotated[Path | None, typer.Option("--figure", metavar="FILE", help="Write a figure (PNG, SVG, PDF).")]
Every = Annotated[int, typer.Option("--every", metavar="K", min=1, help="Keep every K-th sample.")]
StoredArgument = Annotated[Path, typer.Argument(metavar="FOLDER", help="The folder of a result, or of an analysis.")]
ResultArgument = Annotated[Path, typer.Argument(metavar="RESULT", help="A results folder.")]
