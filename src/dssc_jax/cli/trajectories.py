"""Steps that the commands simulate and replay share: write the files of a trajectory, and print it."""

import json
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TypeAlias

import xarray as xr

import dssc_jax.plotting as plotting
from dssc_jax.cli.analysing import write_or_refuse
from dssc_jax.cli.declarations.simulation import Replay, Simulate
from dssc_jax.console.draws import show_draw
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.results.mcap_recording import write_mcap
from dssc_jax.results.summary import jsonable

Writer: TypeAlias = Callable[[xr.Dataset, Path], object]
"""Writes a trajectory to a file."""

FIGURES = (".png", ".svg", ".pdf")
"""Endings of a figure's file name, which choose its format."""
AXES = (
    "inertial x, y, z: east, north, up (ENU); body: forward, left, up (FLU); attitude R_z(psi) R_y(theta) R_x(phi) and "
    "its quaternion: body to inertial"
)
"""Description of the axes of a vehicle's trajectory, for the metadata of its file."""


def require_writable(options: Simulate | Replay) -> None:
    """Require that the files of a trajectory can be written, before the draw is simulated.

    Raises:
        ConfigError: The type of the figure is unknown, or a folder does not exist.
    """
    figure = options.figure
    if figure is not None and figure.suffix.lower() not in FIGURES:
        raise ConfigError(str(figure), f"cannot be written: the name must end in one of {', '.join(FIGURES)}")
    for file in (options.csv, options.parquet, options.mcap, figure):
        if file is not None and not file.parent.is_dir():
            raise ConfigError(str(file), "cannot be written: there is no such folder")


def print_trajectory(
    trajectory: xr.Dataset, options: Simulate | Replay, units: Mapping[str, str], flight_files: Sequence[Path] = ()
) -> None:
    """Write the requested files of a trajectory, and print how the draw ended.

    Args:
        trajectory: The trajectory.
        options: Options of the command, with the files.
        units: Unit of each printed number, by name.
        flight_files: Files that have already been written, and are printed with the others.

    Raises:
        ConfigError: A file cannot be written.
    """
    writers: list[tuple[Path | None, Writer]] = [
        (options.csv, write_csv),
        (options.parquet, write_parquet),
        (options.mcap, write_mcap),
        (options.figure, write_figure),
    ]
    file_paths = [*flight_files]
    for path, write in writers:
        if path is not None:
            write_or_refuse(path, partial(write, trajectory, path))
            file_paths.append(path)
    if options.as_json:
        print(json.dumps(jsonable(trajectory.attrs), allow_nan=False))
    else:
        show_draw(trajectory.attrs, units, file_paths)


def write_figure(trajectory: xr.Dataset, path: Path) -> None:
    """Draw a trajectory and write the figure, in the format that the file's name ends in."""
    plotting.write(plotting.trajectory(trajectory), path)


def write_csv(trajectory: xr.Dataset, path: Path) -> None:
    """Write a trajectory as CSV."""
    with files.replacing(path) as file:
        trajectory.to_dataframe().to_csv(file, index_label="t")


def write_parquet(trajectory: xr.Dataset, path: Path) -> None:
    """Write a trajectory as Parquet.

    Each column has its unit and meaning as metadata. The file has the study's name, the draw, its numbers and how it
    ended, and for a vehicle the description of its axes.

    Raises:
        ConfigError: Pyarrow is not installed.
    """
    try:
        import pyarrow as pa  # an optional extra
        from pyarrow import parquet
    except ImportError as error:
        raise ConfigError(str(path), "a Parquet file needs pyarrow: pip install 'dssc_jax[export]'") from error
    names = ["t", *map(str, trajectory.data_vars)]
    columns = [pa.array(trajectory[name].values) for name in names]
    fields = []
    for name, column in zip(names, columns, strict=True):
        column_metadata = {key: str(value) for key, value in trajectory[name].attrs.items()}
        fields.append(pa.field(name, column.type, metadata=column_metadata))
    file_metadata = {key: str(value) for key, value in trajectory.attrs.items()}
    if "attitude_w" in trajectory:
        file_metadata["axes"] = AXES
    table = pa.Table.from_arrays(columns, schema=pa.schema(fields, metadata=file_metadata))
    with files.replacing(path) as file:
        parquet.write_table(table, file)
