"""The folder of an analysis: a description protected by digests, a dataset and a summary."""

import hashlib
import json
from collections.abc import Hashable, Iterable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import xarray as xr

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError, errors_in_file
from dssc_jax.core.json_types import JsonObject
from dssc_jax.results.array_files import ArrayFiles
from dssc_jax.results.digests import digest_of
from dssc_jax.results.manifest import DATA, SCHEMA, SUMMARY, Manifest, code_entries, unseal, write_json, write_sealed
from dssc_jax.study import Study, hash_of, stored_study
from dssc_jax.study.tables import require_shallow

REQUIRED_ENTRIES = {"study": dict, "hash": str, "source": str, "settings": dict, "sums": dict}
"""Entries that every description of an analysis has, and their types."""

FLAGS = ("flag_values", "flag_meanings")
"""Attributes of a coded coordinate, with its codes and their texts, following the CF conventions."""


class StoredAnalysis(NamedTuple):
    """An analysis as read from its folder.

    Args:
        study: The study that was analysed.
        dataset: The numbers of the analysis.
        settings: The settings that were passed to :func:`save`.
    """

    study: Study
    dataset: xr.Dataset
    settings: JsonObject


def require_free_folder(folder: Path, kind: str, study: Study) -> None:
    """Refuse a folder whose content would be lost if an analysis were written into it.

    The folder must be absent or empty, or contain an analysis of this kind and study.

    Raises:
        ConfigError: The folder contains something else, such as a symbolic link, or cannot be read.
    """
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    if folder.is_dir():
        files.require_plain_tree(folder)
    path = folder / f"{kind}.json"
    if not path.exists():
        raise ConfigError(str(folder), f"holds something other than a {kind} analysis; nothing was written")
    if read_description(folder, kind)["hash"] != study.hash:
        rule = f"holds the {kind} analysis of another study; choose another `out`, nothing was written"
        raise ConfigError(str(folder), rule)


def save(folder: Path, kind: str, study: Study, dataset: xr.Dataset, summary: JsonObject, settings: JsonObject) -> Path:
    """Write the folder of an analysis, and read it back; an analysis of the same kind and study is overwritten.

    Args:
        folder: Created if absent.
        kind: Kind of analysis, e.g. ``margin``.
        study: The study that was analysed.
        dataset: The numbers of the analysis.
        summary: Summary of the numbers, which is never read back.
        settings: Other data that are needed to read the analysis.

    Returns:
        The folder.

    Raises:
        ConfigError: The folder contains something else, or what is read back is not what was written.
    """
    require_free_folder(folder, kind, study)
    files.make_folder(folder)
    coded_dataset, labels = with_text_codes(dataset)
    stored = with_uniform_nan(coded_dataset)
    sums = digests_of(stored)
    description = {
        "study": study.table,
        "hash": study.hash,
        "source": study.source,
        "settings": settings,
        "labels": labels,
        "sums": sums,
        "schema": SCHEMA,
        **code_entries(study),
    }
    write_sealed(folder / f"{kind}.json", description)
    stored.to_zarr(ArrayFiles(folder / DATA), mode="w", consolidated=False, zarr_format=3)
    write_json(folder / SUMMARY, summary)
    holds_sums = read_description(folder, kind)["sums"] == sums
    if not holds_sums or digests_of(stored_dataset(folder)) != sums:
        raise ConfigError(str(folder), "does not hold what was written; run the analysis again")
    return folder


def stored_dataset(folder: Path) -> xr.Dataset:
    """Read the dataset in the folder of an analysis as it is stored, with codes in place of text."""
    array_files = ArrayFiles(folder / DATA, read_only=True)
    return xr.open_zarr(array_files, consolidated=False, zarr_format=3, chunks=None).load()


def with_uniform_nan(dataset: xr.Dataset) -> xr.Dataset:
    """Copy a dataset, with the same bits in every NaN.

    Zarr does not store a chunk that contains only NaN. When it reads such a chunk, it fills in a NaN of its own. The
    digest of the values must then be the same as before.
    """
    float_variables = {}
    for name, variable in dataset.data_vars.items():
        if variable.dtype.kind == "f":
            values = variable.values
            float_variables[name] = variable.copy(data=np.where(np.isnan(values), np.nan, values))
    return dataset.assign(float_variables)


def with_text_codes(dataset: xr.Dataset) -> tuple[xr.Dataset, dict[str, list[str]]]:
    """Replace text coordinates of a dataset by numbers, since Zarr has no stable type for text.

    Returns:
        The dataset with numbers, and the texts by name of the coordinate; a number is the index of its text.
    """
    labels = {}
    codes = {}
    for name, variable in dataset.coords.items():
        is_text = variable.dtype.kind in "UO"  # kinds of NumPy: Unicode, object
        if not is_text:
            continue
        texts = variable.values.tolist()
        words = [text.replace(" ", "_") for text in texts]
        attributes = {**variable.attrs, "flag_values": list(range(len(texts))), "flag_meanings": " ".join(words)}
        labels[str(name)] = texts
        codes[str(name)] = (name, np.arange(len(texts)), attributes)
    return dataset.assign_coords(codes), labels


def with_texts(dataset: xr.Dataset, labels: Mapping[str, list[str]]) -> xr.Dataset:
    """Restore the text coordinates that :func:`with_text_codes` replaced by numbers."""
    texts = {}
    for name, values in labels.items():
        attributes = {key: value for key, value in dataset[name].attrs.items() if key not in FLAGS}
        texts[name] = (name, np.array(values), attributes)
    return dataset.assign_coords(texts)


def digests_of(dataset: xr.Dataset) -> dict[str, str]:
    """Digest of the values, dimensions and attributes of each variable and coordinate, by name.

    The key ``""`` has the digest of the attributes of the dataset itself.
    """
    sums = {}
    for name, variable in dataset.variables.items():
        context = f"{variable.dims} {attributes_text(variable.attrs)}"
        sums[str(name)] = digest_of(variable.values, context)
    sums[""] = hashlib.sha256(attributes_text(dataset.attrs).encode()).hexdigest()
    return sums


def attributes_text(attributes: Mapping[Hashable, object]) -> str:
    """Attributes as JSON with sorted keys, for a digest."""
    return json.dumps(attributes, sort_keys=True, default=np.ndarray.tolist)


def read_description(folder: Path, kind: str) -> Manifest:
    """Read and check the description of an analysis, the file ``KIND.json`` of its folder.

    Raises:
        ConfigError: The description is missing, damaged or altered.
    """
    path = folder / f"{kind}.json"
    try:
        content = json.loads(files.read_text(path))
    except OSError as error:
        rule = f"holds no {kind} analysis: {path.name} cannot be read ({error.strerror})"
        raise ConfigError(str(folder), rule) from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(str(path), f"is damaged, not valid JSON: {error}") from error
    description = unseal(path, content)
    require_entries(path, description)
    return description


def require_entries(path: Path, description: JsonObject) -> None:
    """Require that a description has all entries of :data:`REQUIRED_ENTRIES`, and a study that matches its hash.

    Args:
        path: File of the description, for messages.
        description: The description.

    Raises:
        ConfigError: An entry is missing or of another type, or the study does not match.
    """
    invalid_entries = []
    for name, entry_type in REQUIRED_ENTRIES.items():
        if not isinstance(description.get(name), entry_type):
            invalid_entries.append(name)
    if invalid_entries:
        raise ConfigError(str(path), f"is damaged: it has no {', '.join(invalid_entries)}")
    with errors_in_file(str(path)):
        require_shallow(description["study"])
    if hash_of(description["study"]) != description["hash"]:
        raise ConfigError(str(path), "is damaged: its study does not match its hash")


def read_analysis(folder: Path, kind: str, trust_code: bool) -> StoredAnalysis:
    """Read an analysis written by :func:`save`.

    Args:
        folder: The folder.
        kind: Kind of analysis.
        trust_code: Whether to import the models that the study names as ``module:object``.

    Raises:
        ConfigError: The analysis is missing, damaged or altered.
    """
    description = read_description(folder, kind)
    try:
        dataset = stored_dataset(folder)
        is_intact = digests_of(dataset) == description["sums"]
        dataset = with_texts(dataset, description.get("labels", {}))
    except Exception as error:  # zarr, its codecs and xarray raise errors of many kinds
        raise ConfigError(str(folder / DATA), f"cannot be read: {' '.join(str(error).split())}") from error
    if not is_intact:
        raise ConfigError(str(folder / DATA), "is damaged: it does not hold what was written; run the analysis again")
    return StoredAnalysis(
        study=stored_study(description, description["source"], trust_code),
        dataset=with_order(dataset, description["sums"]),
        settings=description["settings"],
    )


def with_order(dataset: xr.Dataset, names: Iterable[str]) -> xr.Dataset:
    """Copy a dataset, with its variables and coordinates in a given order of names.

    Zarr lists arrays in the order in which the file system has them, which differs from one machine to the next.
    """
    data = {}
    coordinates = {}
    for name in names:
        if name in dataset.coords:
            coordinates[name] = dataset.variables[name]
        elif name in dataset.data_vars:
            data[name] = dataset.variables[name]
    return xr.Dataset(data, coordinates, dataset.attrs)
