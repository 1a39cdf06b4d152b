"""What the commands simulate and replay share: the files of a trajectory."""

import json
from pathlib import Path

import xarray as xr

import dssc_jax.plotting as plotting
from dssc_jax.cli.analysing import attempt
from dssc_jax.cli.declarations.simulation import Replay, Simulate
from dssc_jax.console.draws import show_draw
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.results.summary import jsonable

FIGURES = (".png", ".svg", ".pdf")


def require_writable(options: Simulate | Replay) -> None:
    """Require that the files of a trajectory can be written, before it is simulated.

    Raises:
        ConfigError: the figure's type is unknown, or a folder does not exist.
    """
    figure = options.figure
    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise ConfigError(str(figure), f"cannot be written: the name must end in one of {', '.join(FIGURES)}")
    for file in (options.csv, figure):
        if file is not None and not file.parent.is_dir():
            raise ConfigError(str(file), "cannot be written: there is no such folder")


def print_trajectory(trajectory: xr.Dataset, options: Simulate | Replay) -> None:
    """Write the requested files of a trajectory, and show how the draw ended."""
    csv = options.csv
    figure = options.figure
    if csv is not None:
        attempt(csv, lambda: write_table(trajectory, csv))
    if figure is not None:
        attempt(figure, lambda: plotting.write(plotting.trajectory(trajectory), figure))
    if options.as_json:
        print(json.dumps(jsonable(trajectory.attrs), allow_nan=False))
    else:
        show_draw(trajectory.attrs, [path for path in (csv, figure) if path is not None])


def write_table(trajectory: xr.Dataset, path: Path) -> None:
    """Write a trajectory as CSV."""
    with files.replacing(path) as file:
        trajectory.to_dataframe().to_csv(file, index_label="t")
