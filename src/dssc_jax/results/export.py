"""Export of a result: a table as CSV or Parquet, or the dataset as netCDF or for MATLAB, with units and meanings."""

import importlib
import io
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
from dssc_jax.engine.batching import Layout, lanes_of
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.result import Result
from dssc_jax.results.schema import OUTCOME, coordinates, outcome_codes, variables

if TYPE_CHECKING:
    import pandas as pd

TABLE_ROWS = 2**17
"""Number of rows that are written at a time."""
MEANING = "outcome_meaning"
CSVW = "http://www.w3.org/ns/csvw"


class Format(StrEnum):
    """Export formats."""

    CSV = "csv"
    PARQUET = "parquet"
    NETCDF = "netcdf"
    MAT = "mat"


FILE_NAMES = dict(zip(Format, ("draws.csv", "draws.parquet", "result.nc", "result.mat"), strict=True))
ANALYSIS_FILES = dict(zip(Format, ("table.csv", "table.parquet", "dataset.nc", "dataset.mat"), strict=True))
REQUIRED_PACKAGES = {Format.CSV: (), Format.PARQUET: ("pyarrow",), Format.NETCDF: ("h5netcdf", "h5py"), Format.MAT: ()}
DATATYPES = {"i": "integer", "u": "integer", "b": "boolean", "U": "string", "O": "string", "f": "double"}
"""Datatypes of "CSV on the Web" by NumPy's kinds."""


class ExportTable(NamedTuple):
    """A table for export.

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

    ``csv`` and ``parquet`` are tables. That of a result has a row for each lane: swept values, draw, drawn numbers,
    metrics, slacks and outcome. That of an analysis has a row for each index of its own dimensions. Units and meanings
    are in the column metadata of Parquet, and beside a CSV in ``<file>-metadata.json``, as the W3C's "CSV on the Web"
    defines it. ``netcdf`` is the dataset itself with CF attributes, and ``mat`` has a MATLAB struct for each variable.

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
    exported_files = [write_whole_file(path, lambda file: writers[form](result, file))]
    if form is Format.CSV:
        metadata_file = path.with_name(f"{path.name}-metadata.json")
        content = json.dumps(csv_metadata(result, path.name), indent=2) + "\n"
        exported_files.append(write_whole_file(metadata_file, lambda file: file.write(content.encode())))
    return exported_files


def require_package(package: str, form: Format) -> None:
    """Require an optional package.

    Raises:
        ConfigError: It is not installed.
    """
    try:
        importlib.import_module(package)
    except ImportError:
        raise ConfigError("to", f"{form} needs {package}: pip install 'dssc_jax[export]'") from None


def write_whole_file(path: Path, write: Callable[[IO[bytes]], object]) -> Path:
    """Write a file completely or not at all.

    Raises:
        ConfigError: It cannot be written.
    """
    try:
        with files.replacing(path) as file:
            write(file)
    except OSError as error:
        raise ConfigError(str(path), f"cannot be written: {error.strerror or error}") from error
    return path


def table_of(result: Result | Analysis) -> ExportTable:
    """The table of a result, or of an analysis."""
    return table_of_analysis(result) if isinstance(result, Analysis) else table_of_lanes(result)


def table_of_analysis(analysis: Analysis) -> ExportTable:
    """The table of an analysis, with a row for each index of its own dimensions."""
    data = analysis.dataset
    names = [name for name, variable in data.items() if set(variable.dims) <= set(analysis.table)]
    frame = data[names].to_dataframe(dim_order=list(analysis.table)).reset_index()
    columns = {}
    datatypes = {}
    for name in map(str, frame.columns):
        columns[name] = {"long_name": f"index of the {name}"}
        if name in data.variables:
            columns[name] = dict(data[name].attrs)
        datatypes[name] = DATATYPES[frame[name].to_numpy().dtype.kind]
    return ExportTable(columns, datatypes, [frame])


def table_of_lanes(result: Result) -> ExportTable:
    """The table of a result, with a row for each lane."""
    columns = {}
    for name, variable in (coordinates(result.study) | variables(result.study)).items():
        columns[name] = dict(variable.attributes)
    columns[MEANING] = {"long_name": OUTCOME}
    datatypes = dict.fromkeys(columns, "double") | {"draw": "integer", "outcome": "integer", MEANING: "string"}
    return ExportTable(columns, datatypes, lane_rows(result, list(columns)))


def lane_rows(result: Result, names: list[str]) -> Iterable["pd.DataFrame"]:
    """The rows of a result's table, :data:`TABLE_ROWS` at a time.

    Args:
        result: The result.
        names: Names of the columns, in order.
    """
    import pandas as pd

    study = result.study
    data = result.dataset
    codes = outcome_codes(study)
    for block in Layout.of(study, TABLE_ROWS).blocks():
        law_values = {name: data[name].values[block[-1]] for name in study.laws}
        numbers, draws = lanes_of(study, block, law_values)
        table: dict[str, Any] = {"draw": draws}
        for name in (*study.axes, *study.laws):
            table[name] = numbers[name]
        for name in variables(study):
            if name not in study.laws:
                table[name] = data[name].values[block].reshape(-1)
        code_indices = np.searchsorted(list(codes), table["outcome"])
        table[MEANING] = pd.Categorical.from_codes(code_indices, categories=list(codes.values()))
        yield pd.DataFrame(table, columns=names)


def write_csv(result: Result | Analysis, file: IO[bytes]) -> None:
    """Write a table as CSV: numbers with all their digits, missing values as empty cells."""
    for number, piece in enumerate(table_of(result).pieces):
        piece.to_csv(file, index=False, header=number == 0, lineterminator="\n")


def csv_metadata(result: Result | Analysis, name: str) -> dict[str, object]:
    """Metadata of a CSV file, as "CSV on the Web" defines them.

    Args:
        result: The result or analysis.
        name: Name of the CSV file.
    """
    table = table_of(result)
    column_metadata = []
    for column, attributes in table.columns.items():
        unit = {"schema:unitText": attributes["units"]} if "units" in attributes else {}
        law = {"dc:source": attributes["law"]} if "law" in attributes else {}
        entry = {"name": column, "datatype": table.datatypes[column], "dc:description": attributes["long_name"]}
        column_metadata.append(entry | unit | law)
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

    rows = table_of(result)
    writer = None
    try:
        for piece in rows.pieces:
            table = pa.Table.from_pandas(piece, preserve_index=False)
            fields = [f.with_metadata({k: str(v) for k, v in rows.columns[f.name].items()}) for f in table.schema]
            metadata = {**(table.schema.metadata or {}), **file_provenance(result)}
            table = table.cast(pa.schema(fields, metadata=metadata))
            writer = writer or parquet.ParquetWriter(file, table.schema)
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def write_netcdf(result: Result | Analysis, file: IO[bytes]) -> None:
    """Write the dataset as compressed netCDF. It is made in memory, since HDF5 ends the process if a disk is full."""
    data = result.dataset.copy().assign_attrs(file_provenance(result))
    for variable in data.variables.values():
        if "flag_values" in variable.attrs and variable.dtype.kind in "iu":
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
        values = variable.values if variable.dtype.kind in "fiub" else variable.values.astype(object)
        attributes = {key: str(variable.attrs[key]) for key in ("units", "long_name") if key in variable.attrs}
        content[matlab_name(str(name), content)] = {
            "values": values,
            "dimensions": list(map(str, variable.dims)),
            **attributes,
        }
    savemat(file, content, long_field_names=True, do_compression=True, oned_as="column", appendmat=False)


def matlab_name(name: str, used_names: Iterable[str]) -> str:
    """A valid MATLAB name of at most 63 characters that is not among the used names."""
    plain = re.sub(r"\W", "_", name, flags=re.ASCII)[:60]
    plain = plain if plain[:1].isalpha() else f"v{plain}"
    alike = sum(used_name == plain or used_name.startswith(f"{plain}_v") for used_name in used_names)
    return f"{plain}_v{alike + 1}" if alike and plain in used_names else plain


def file_provenance(result: Result | Analysis) -> dict[str, str]:
    """Attributes by which an exported file can be traced: the study, its hash, the version of dssc_jax and the time."""
    manifest = {} if isinstance(result, Analysis) else result.manifest
    history = [f"computed with dssc_jax {manifest.get('versions', {}).get('dssc_jax') or version('dssc_jax')}"]
    if "started" in manifest:
        history.append(str(manifest["started"]))
    return {
        **{name: str(value) for name, value in result.dataset.attrs.items()},
        "study": json.dumps(result.study.table),
        "study_hash": result.study.hash,
        "history": ", ".join(history),
    }
