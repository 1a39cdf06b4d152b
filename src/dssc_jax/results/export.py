"""Export of a result: a table of draws as CSV or Parquet, or the dataset as netCDF, with units and meanings."""

import importlib
import json
import os
from collections.abc import Callable, Iterable
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Layout, lanes_of
from dssc_jax.results.result import Result
from dssc_jax.results.schema import OUTCOME, coordinates, outcome_codes, variables

if TYPE_CHECKING:
    import pandas as pd

ROWS = 2**17  # of the table at a time
MEANING = "outcome_meaning"
CSVW = "http://www.w3.org/ns/csvw"


class Format(StrEnum):
    """Export formats."""

    CSV = "csv"
    PARQUET = "parquet"
    NETCDF = "netcdf"


FILE_NAMES = {Format.CSV: "draws.csv", Format.PARQUET: "draws.parquet", Format.NETCDF: "result.nc"}
NEEDS = {Format.CSV: (), Format.PARQUET: ("pyarrow",), Format.NETCDF: ("h5netcdf", "h5py")}


def export(result: Result, to: Format | str, out: str | Path | None = None) -> list[Path]:
    """Write a result for other programs.

    ``csv`` and ``parquet`` are a table with one row per lane: swept values, draw, drawn numbers, metrics, slacks and
    outcome. Units and long names are in Parquet's column metadata; for CSV in a separate ``<file>-metadata.json``,
    which follows the W3C's "CSV on the Web". ``netcdf`` is the dataset itself, with CF attributes.

    Args:
        result: A loaded or fresh result.
        to: One of :class:`Format`.
        out: The file; None: in the results folder.

    Returns:
        The files written.

    Raises:
        ConfigError: the format is unknown, a package is missing, or the file cannot be written.
    """
    if to not in list(Format):
        raise ConfigError("to", f"must be one of {', '.join(Format)}, got {to!r}")
    form = Format(to)
    for package in NEEDS[form]:
        require(package, form)
    if out is None and result.path is None:
        raise ConfigError("out", "is needed for a result that has no folder")
    path = Path(out) if out is not None else Path(result.path or "") / FILE_NAMES[form]
    writers = {Format.CSV: write_csv, Format.PARQUET: write_parquet, Format.NETCDF: write_netcdf}
    written = [into_place(path, lambda partial: writers[form](result, partial))]
    if form is Format.CSV:
        about = path.with_name(f"{path.name}-metadata.json")
        content = json.dumps(csv_metadata(result, path.name), indent=2) + "\n"
        written.append(into_place(about, lambda partial: partial.write_text(content, encoding="utf-8")))
    return written


def require(package: str, form: Format) -> None:
    """Require an optional package.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        importlib.import_module(package)
    except ImportError:
        raise ConfigError(f"--to {form}", f"needs {package}: pip install 'dssc_jax[export]'") from None


def into_place(path: Path, write: Callable[[Path], Any]) -> Path:
    """Write to a temporary file and move it to its final name, so that no partial file remains.

    Raises:
        ConfigError: it cannot be written.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        write(partial)
        os.replace(partial, path)
    except OSError as error:
        raise ConfigError(str(path), f"cannot be written: {error.strerror or error}") from error
    finally:
        partial.unlink(missing_ok=True)
    return path


def columns(result: Result) -> dict[str, dict[str, Any]]:
    """Attributes of the table's columns, in order."""
    described = {**coordinates(result.study), **variables(result.study)}
    attributes = {name: dict(variable.attributes) for name, variable in described.items()}
    return {**attributes, MEANING: {"long_name": OUTCOME}}


def pieces(result: Result) -> Iterable["pd.DataFrame"]:
    """The table of draws, in parts."""
    import pandas as pd

    study, data = result.study, result.dataset
    codes = outcome_codes(study)
    for block in Layout.of(study, ROWS).blocks():
        drawn = {name: data[name].values[block[-1]] for name in study.laws}
        flat, draws = lanes_of(study, block, drawn)
        table = {name: flat[name] for name in study.axes} | {"draw": draws} | {name: flat[name] for name in drawn}
        table |= {name: data[name].values[block].reshape(-1) for name in variables(study) if name not in drawn}
        meaning = pd.Categorical.from_codes(
            np.searchsorted(list(codes), table["outcome"]), categories=list(codes.values())
        )
        yield pd.DataFrame(table | {MEANING: meaning}, columns=list(columns(result)))


def write_csv(result: Result, path: Path) -> None:
    """Write a CSV file with enough digits to restore numbers exactly; missing values are empty."""
    with path.open("w", encoding="utf-8", newline="") as file:
        for number, piece in enumerate(pieces(result)):
            piece.to_csv(file, index=False, header=number == 0, lineterminator="\n")


def csv_metadata(result: Result, name: str) -> dict[str, Any]:
    """The table's description according to "CSV on the Web"."""
    kinds = {"draw": "integer", "outcome": "integer", MEANING: "string"}
    described = []
    for column, about in columns(result).items():
        unit = {"schema:unitText": about["units"]} if "units" in about else {}
        law = {"dc:source": about["law"]} if "law" in about else {}
        entry = {"name": column, "datatype": kinds.get(column, "double"), "dc:description": about["long_name"]}
        described.append(entry | unit | law)
    return {
        "@context": CSVW,
        "url": name,
        "dc:title": result.study.name,
        "dc:description": result.study.config.description,
        "dc:identifier": result.study.hash,
        "tableSchema": {"columns": described},
    }


def write_parquet(result: Result, path: Path) -> None:
    """Write a Parquet file: one row group per part, attributes as column metadata, the study as file metadata."""
    import pyarrow as pa
    from pyarrow import parquet

    about = columns(result)
    writer = None
    try:
        for piece in pieces(result):
            table = pa.Table.from_pandas(piece, preserve_index=False)
            fields = [f.with_metadata({k: str(v) for k, v in about[f.name].items()}) for f in table.schema]
            whole = {**(table.schema.metadata or {}), **provenance(result)}
            table = table.cast(pa.schema(fields, metadata=whole))
            writer = writer or parquet.ParquetWriter(path, table.schema)
            writer.write_table(table)
    finally:
        if writer is not None:
            writer.close()


def write_netcdf(result: Result, path: Path) -> None:
    """Write the dataset as compressed netCDF."""
    data = result.dataset.copy().assign_attrs(provenance(result))
    codes = np.asarray(list(outcome_codes(result.study)), dtype=data["outcome"].dtype)
    data["outcome"].attrs["flag_values"] = codes  # CF: of the variable's own type
    data.to_netcdf(path, engine="h5netcdf", encoding={name: {"zlib": True, "complevel": 4} for name in data.data_vars})


def provenance(result: Result) -> dict[str, str]:
    """Metadata for tracing a file back: the study as run, and its hash."""
    versions = result.manifest.get("versions", {})
    return {
        **{name: str(value) for name, value in result.dataset.attrs.items()},
        "study": json.dumps(result.study.table),
        "study_hash": result.study.hash,
        "history": f"computed with dssc_jax {versions.get('dssc_jax')}, {result.manifest.get('started')}",
    }
