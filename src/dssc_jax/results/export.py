"""Export of a result with units and meanings: a table as CSV or Parquet, or the dataset as netCDF or for MATLAB."""

import importlib
import io
import itertools
import json
import re
from collections.abc import Callable, Iterable
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, NamedTuple

import numpy as np

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Block, Layout, lanes_of
from dssc_jax.engine.sampling import Arrays
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import Result
from dssc_jax.results.schema import OUTCOME, coordinates, outcome_codes, variables

if TYPE_CHECKING:
    import pandas as pd

TABLE_ROWS = 2**17
LONGEST_NAME = 63  # characters of a name in MATLAB
"""Number of rows that are written at a time."""
MEANING = "outcome_meaning"  # column with the outcome in words
CSVW = "http://www.w3.org/ns/csvw"  # context of the metadata of "CSV on the Web"


class Format(StrEnum):
    """Export formats."""

    CSV = "csv"
    PARQUET = "parquet"
    NETCDF = "netcdf"
    MAT = "mat"


FILE_NAMES = {
    Format.CSV: "draws.csv",
    Format.PARQUET: "draws.parquet",
    Format.NETCDF: "result.nc",
    Format.MAT: "result.mat",
}
"""File of an exported result in its folder."""
ANALYSIS_FILES = {
    Format.CSV: "table.csv",
    Format.PARQUET: "table.parquet",
    Format.NETCDF: "dataset.nc",
    Format.MAT: "dataset.mat",
}
"""File of an exported analysis in its folder."""
REQUIRED_PACKAGES = {Format.CSV: (), Format.PARQUET: ("pyarrow",), Format.NETCDF: ("h5netcdf", "h5py"), Format.MAT: ()}
"""Optional packages that each format needs."""
DATATYPES = {"i": "integer", "u": "integer", "b": "boolean", "U": "string", "O": "string", "f": "double"}
"""Datatypes of "CSV on the Web", by the kind of a NumPy type."""


class ExportTable(NamedTuple):
    """A table for export, whose rows are made piece by piece, so that a large table need not fit into memory.

    Args:
        columns: Attributes of each column by name, in the order of the columns.
        datatypes: Datatype of each column, as "CSV on the Web" names it.
        pieces: The rows, in several parts.
    """

    columns: dict[str, dict[str, Any]]
    datatypes: dict[str, str]
    pieces: Iterable["pd.DataFrame"]


def export(result: Result | Analysis, to: Format | str, out: str | Path | None = None) -> list[Path]:
    """Write a result or an analysis for other programs.

    ``csv`` and ``parquet`` are tables. The table of a result has a row for each lane, with swept values, draw, drawn
    numbers, metrics, slacks and outcome. The table of an analysis has a row for each index of its own dimensions.
    Parquet has units and meanings in the metadata of its columns. A CSV has them in ``<file>-metadata.json``, as the
    W3C's "CSV on the Web" defines it. ``netcdf`` is the dataset itself with CF attributes, and ``mat`` has a MATLAB
    struct for each variable.

    Args:
        result: A loaded or new result, or analysis.
        to: One of :class:`Format`.
        out: The file; None: in the folder of the result.

    Returns:
        The files written.

    Raises:
        ConfigError: The format is unknown, a package is missing, or the file cannot be written.
    """
    if to not in list(Format):
        raise ConfigError("to", f"must be one of {', '.join(Format)}, got {to!r}")
    form = Format(to)
    for package in REQUIRED_PACKAGES[form]:
        require_package(package, form)
    if out is None and result.path is None:
        raise ConfigError("out", "is needed for a result that has no folder")
    names = ANALYSIS_FILES
    if isinstance(result, Result):
        names = FILE_NAMES
        result = result.with_theorem()
    path = Path(out) if out is not None else Path(result.path or "") / names[form]
    writers = {Format.CSV: write_csv, Format.PARQUET: write_parquet, Format.NETCDF: write_netcdf, Format.MAT: write_mat}
    write_content = writers[form]
    exported_files = [write_whole_file(path, lambda file: write_content(result, file))]
    if form is Format.CSV:
        metadata_file = path.with_name(f"{path.name}-metadata.json")
        content = json.dumps(csv_metadata(result, path.name), indent=2) + "\n"
        exported_files.append(write_whole_file(metadata_file, lambda file: file.write(content.encode())))
    return exported_files


def require_package(package: str, form: Format) -> None:
    """Refuse an export whose optional package is not installed.

    Raises:
        ConfigError: The package is not installed; the message tells how to install it.
    """
    try:
        importlib.import_module(package)
    except ImportError:
        raise ConfigError("to", f"{form} needs {package}: pip install 'dssc_jax[export]'") from None


def write_whole_file(path: Path, write: Callable[[IO[bytes]], object]) -> Path:
    """Write a file completely or not at all, and return its path.

    Args:
        path: The file; an existing file is replaced.
        write: (open file) -> writes the content into the file.

    Raises:
        ConfigError: The file cannot be written.
    """
    try:
        with files.replacing(path) as file:
            write(file)
    except OSError as error:
        raise ConfigError(str(path), f"cannot be written: {error.strerror or error}") from error
    return path


def table_of(result: Result | Analysis) -> ExportTable:
    """Make the table of a result, with a row for each lane; or of an analysis, with a row for each index."""
    return table_of_analysis(result) if isinstance(result, Analysis) else table_of_lanes(result)


def table_of_analysis(analysis: Analysis) -> ExportTable:
    """Make the table of an analysis, with a row for each index of its own dimensions."""
    data = analysis.dataset
    names = [name for name, variable in data.items() if set(variable.dims) <= set(analysis.table)]
    frame = data[names].to_dataframe(dim_order=list(analysis.table)).reset_index()
    columns = {}
    datatypes = {}
    for name in map(str, frame.columns):
        columns[name] = {"long_name": f"index of the {name}"}
        if name in data.variables:
            columns[name] = dict(data[name].attrs)
        kind = frame[name].to_numpy().dtype.kind
        datatypes[name] = DATATYPES[kind]
    return ExportTable(columns, datatypes, pieces=[frame])


def table_of_lanes(result: Result) -> ExportTable:
    """Make the table of a result, with a row for each lane, that is, for each draw at each point of the sweep."""
    columns = {}
    for name, variable in (coordinates(result.study) | variables(result.study)).items():
        columns[name] = dict(variable.attributes)
    columns[MEANING] = {"long_name": OUTCOME}
    datatypes = dict.fromkeys(columns, "double") | {"draw": "integer", "outcome": "integer", MEANING: "string"}
    return ExportTable(columns, datatypes, pieces=lane_rows(result, list(columns)))


def lane_rows(result: Result, names: list[str]) -> Iterable["pd.DataFrame"]:
    """Yield the rows of a result's table, :data:`TABLE_ROWS` at a time.

    Args:
        result: The result.
        names: Names of the columns, in order.
    """
    import pandas as pd

    codes = outcome_codes(result.study)
    for block in Layout.of(result.study, TABLE_ROWS).blocks():
        columns: dict[str, Any] = dict(lane_columns(result, block))
        code_indices = np.searchsorted(list(codes), columns["outcome"])
        columns[MEANING] = pd.Categorical.from_codes(code_indices, categories=list(codes.values()))
        yield pd.DataFrame(columns, columns=names)


def lane_columns(result: Result, block: Block) -> Arrays:
    """Numbers and results of the lanes of a block, by name, each of shape (lanes,)."""
    study = result.study
    data = result.dataset
    law_values = {name: data[name].values[block[-1]] for name in study.laws}
    numbers, draws = lanes_of(study, block, law_values)
    columns = {"draw": draws}
    for name in (*study.axes, *study.laws):
        columns[name] = numbers[name]
    for name in variables(study):
        if name not in study.laws:
            columns[name] = data[name].values[block].reshape(-1)
    return columns


def write_csv(result: Result | Analysis, file: IO[bytes]) -> None:
    """Write a table as CSV: numbers with all their digits, missing values as empty cells."""
    is_first = True
    for piece in table_of(result).pieces:
        piece.to_csv(file, index=False, header=is_first, lineterminator="\n")
        is_first = False


def csv_metadata(result: Result | Analysis, name: str) -> dict[str, object]:
    """Metadata of a CSV file, as "CSV on the Web" defines them: type, meaning, unit and law of each column.

    Args:
        result: The result or analysis.
        name: Name of the CSV file.
    """
    table = table_of(result)
    column_metadata = []
    for column, attributes in table.columns.items():
        entry = {"name": column, "datatype": table.datatypes[column], "dc:description": attributes["long_name"]}
        if "units" in attributes:
            entry["schema:unitText"] = attributes["units"]
        if "law" in attributes:
            entry["dc:source"] = attributes["law"]
        column_metadata.append(entry)
    return {
        "@context": CSVW,
        "url": name,
        "dc:title": result.study.name,
        "dc:description": result.study.config.description,
        "dc:identifier": result.study.hash,
        "tableSchema": {"columns": column_metadata},
    }


def write_parquet(result: Result | Analysis, file: IO[bytes]) -> None:
    """Write a table as Parquet, with the attributes of each column and the study as metadata."""
    import pyarrow as pa
    from pyarrow import parquet

    export_table = table_of(result)
    writer = None
    try:
        for piece in export_table.pieces:
            table = pa.Table.from_pandas(piece, preserve_index=False)
            fields = []
            for field in table.schema:
                attributes = export_table.columns[field.name]
                fields.append(field.with_metadata({name: str(value) for name, value in attributes.items()}))
            metadata = {**(table.schema.metadata or {}), **file_provenance(result)}
            table = table.cast(pa.schema(fields, metadata=metadata))
            writer = writer or parquet.ParquetWriter(file, table.schema)
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def write_netcdf(result: Result | Analysis, file: IO[bytes]) -> None:
    """Write the dataset as compressed netCDF; it is made in memory, since HDF5 ends the process if a disk is full."""
    data = result.dataset.copy().assign_attrs(file_provenance(result))
    for variable in data.variables.values():
        is_integer = variable.dtype.kind in "iu"  # kinds of NumPy: signed, unsigned
        if is_integer and "flag_values" in variable.attrs:
            flags = np.asarray(variable.attrs["flag_values"], dtype=variable.dtype)  # CF: of the variable's type
            variable.attrs["flag_values"] = flags
    memory = io.BytesIO()
    encoding = {name: {"zlib": True, "complevel": 4} for name in data.data_vars}
    data.to_netcdf(memory, engine="h5netcdf", encoding=encoding)
    file.write(memory.getbuffer())


def write_mat(result: Result | Analysis, file: IO[bytes]) -> None:
    """Write a MATLAB file of version 5, with a struct of values, dimensions, unit and long name for each variable.

    Characters that MATLAB does not allow in a name are replaced by underscores.
    """
    from scipy.io import savemat

    content: dict[str, object] = {"study": file_provenance(result)}
    for name, variable in result.dataset.variables.items():
        is_numeric = variable.dtype.kind in "fiub"  # kinds of NumPy: float, integers, booleans
        struct: dict[str, object] = {
            "values": variable.values if is_numeric else variable.values.astype(object),
            "dimensions": list(map(str, variable.dims)),
        }
        for key in ("units", "long_name"):
            if key in variable.attrs:
                struct[key] = str(variable.attrs[key])
        content[matlab_name(str(name), content)] = struct
    savemat(file, content, long_field_names=True, do_compression=True, oned_as="column", appendmat=False)


def matlab_name(name: str, used_names: Iterable[str]) -> str:
    """Make a valid MATLAB name of at most :data:`LONGEST_NAME` characters that is not among the used names.

    Args:
        name: Any name; an underscore replaces each character that MATLAB does not allow.
        used_names: Names that are taken; a further variable of the same name gets the ending ``_v2``, ``_v3``, ...
    """
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)
    if not plain[:1].isalpha():
        plain = f"v{plain}"
    taken = set(used_names)
    candidate = plain[:LONGEST_NAME]
    for number in itertools.count(2):
        if candidate not in taken:
            break
        ending = f"_v{number}"
        candidate = f"{plain[: LONGEST_NAME - len(ending)]}{ending}"
    return candidate


def file_provenance(result: Result | Analysis) -> dict[str, str]:
    """Attributes by which an exported file can be traced: those of the dataset, the study, its hash and the history.

    The history states the version that computed the result, and the time at which the run started. An analysis has no
    manifest with this information. Its history states the version that exports, and no time.
    """
    manifest = {} if isinstance(result, Analysis) else result.manifest
    computing_version = manifest.get("versions", {}).get("dssc_jax") or version("dssc_jax")
    history = [f"computed with dssc_jax {computing_version}"]
    if "started" in manifest:
        history.append(str(manifest["started"]))
    return {
        **{name: str(value) for name, value in result.dataset.attrs.items()},
        "study": json.dumps(result.study.table),
        "study_hash": result.study.hash,
        "history": ", ".join(history),
    }
