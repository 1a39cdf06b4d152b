"""Options of the commands on a stored result: verify, export, report."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from dssc_jax.analyses.defaults import WORST_DRAWS
from dssc_jax.cli.declarations.types import Json, ResultArgument, StoredArgument, StoredOptions


@dataclass(frozen=True, kw_only=True)
class Verify(StoredOptions):
    """Recompute some random lanes of a result by the plain program.

    Prints the largest relative deviation. Exit 1 if it is more than rounding explains, or if every lane amplifies
    rounding so much that none can confirm the result. A result whose study names code of its own needs --trust-code.
    """

    result: ResultArgument
    draws: Annotated[int, typer.Option("--draws", metavar="K", help="How many lanes to compute again.")] = 16
    seed: Annotated[int | None, typer.Option("--seed", metavar="S", help="Seed of the choice [at random].")] = None


@dataclass(frozen=True, kw_only=True)
class Export:
    """Write a result or an analysis for other programs, with units and meanings.

    csv and parquet: a table, of a result with one row a draw and sweep point, of an analysis with one row of its own
    kind (a draw, a controller's draw, a factor, a simulated point, ...). netcdf: the dataset, with CF attributes.
    """

    result: StoredArgument
    to: Annotated[str, typer.Option("--to", metavar="FORMAT", help="csv, parquet, netcdf or mat.")]
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="The file [draws.csv, ... in FOLDER].")] = (
        None
    )
    as_json: Json = False


@dataclass(frozen=True, kw_only=True)
class Report(StoredOptions):
    """Write a result, or an analysis, as one HTML page.

    The page needs neither network nor JavaScript and prints well. A result's worst draws are simulated again for it;
    those of a study that names code of its own with --trust-code only.

    With --interactive, one file in which the draws of a result can be brushed; it needs JavaScript, but no network.

    With --index, a page over all the results in a folder instead; reports that are missing or out of date are made.
    """

    result: Annotated[
        Path | None, typer.Argument(metavar="[FOLDER]", help="The folder of a result, or of an analysis.")
    ] = None
    out: Annotated[Path | None, typer.Option("--out", metavar="FILE", help="The page [FOLDER/report.html].")] = None
    worst: Annotated[int, typer.Option("--worst", metavar="N", min=0, help="Worst draws to show.")] = WORST_DRAWS
    index: Annotated[
        Path | None, typer.Option("--index", metavar="DIR", help="Write DIR/index.html over the results in DIR.")
    ] = None
    interactive: Annotated[
        bool, typer.Option("--interactive", help="Write a page of the draws with linked brushing [interactive.html].")
    ] = False
