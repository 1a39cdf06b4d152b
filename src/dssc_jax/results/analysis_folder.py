"""The folder of an analysis: a description protected by digests, a dataset and a summary."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.results.array_files import ArrayFiles
from dssc_jax.results.digests import sum_of
from dssc_jax.results.manifest import DATA, SCHEMA, SUMMARY, about_code, unsealed, write_json, write_sealed
from dssc_jax.study import Study, hash_of, received
from dssc_jax.study.tables import require_shallow

NEEDED = {"study": dict, "hash": str, "source": str, "settings": dict, "sums": dict}
"""The description's entries besides the dataset, and their types."""

FLAGS = ("flag_values", "flag_meanings")


class Stored(NamedTuple):
    """An analysis as read from its folder.

    Args:
        study: The study that was analysed.
        dataset: Its numbers.
        settings: The settings given to :func:`save`.
    """

    study: Study
    dataset: xr.Dataset
    settings: dict[str, Any]


def require_free(folder: Path, kind: str, study: Study) -> None:
    """Require that a folder is absent, empty, or contains an analysis of this kind and study.

    Raises:
        ConfigError: it contains something else, such as a symbolic link.
    """
    if not folder.exists() or (folder.is_dir() and not any(folder.iterdir())):
        return
    if folder.is_dir():
        files.require_plain_tree(folder)
    path = folder / f"{kind}.json"
    if not path.exists():
        raise ConfigError(str(folder), f"holds something other than a {kind} analysis; nothing was written")
    try:
        same = json.loads(files.read_text(path))["hash"] == study.hash
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        same = False
    if not same:
        rule = f"holds the {kind} analysis of another study; choose another --out, nothing was written"
        raise ConfigError(str(folder), rule)


def save(
    folder: Path, kind: str, study: Study, dataset: xr.Dataset, summary: dict[str, Any], settings: dict[str, Any]
) -> Path:
    """Write the folder of an analysis; one of the same kind and study is overwritten.

    Args:
        folder: Created if absent.
        kind: Kind of analysis, e.g. ``margin``.
        study: The study that was analysed.
        dataset: Its numbers.
        summary: Summary of the numbers.
        settings: Other data needed for reading.

    Raises:
        ConfigError: the folder contains something else, or what is read back is not what was written.
    """
    require_free(folder, kind, study)
    files.make_folder(folder)
    plain, labels = with_codes(dataset)
    about = {"study": study.table, "hash": study.hash, "source": study.source, "settings": settings, "labels": labels}
    about |= {"sums": sums_of(plain), "schema": SCHEMA, **about_code(study)}
    write_sealed(folder / f"{kind}.json", about)
    plain.to_zarr(ArrayFiles(folder / DATA), mode="w", consolidated=False, zarr_format=3)
    write_json(folder / SUMMARY, summary)
    if read_about(folder, kind)["sums"] != about["sums"] or sums_of(stored_dataset(folder)) != about["sums"]:
        raise ConfigError(str(folder), "does not hold what was written; run the analysis again")
    return folder


def stored_dataset(folder: Path) -> xr.Dataset:
    """The dataset in the folder of an analysis, with codes in place of text."""
    stored = ArrayFiles(folder / DATA, read_only=True)
    return xr.open_zarr(stored, consolidated=False, zarr_format=3, chunks=None).load()


def with_codes(dataset: xr.Dataset) -> tuple[xr.Dataset, dict[str, list[str]]]:
    """Replace text coordinates of a dataset by numbers, since Zarr has no stable text type; also return the text."""
    labels = {str(name): one.values.tolist() for name, one in dataset.coords.items() if one.dtype.kind in "UO"}
    codes = {}
    for name, texts in labels.items():
        flags = (list(range(len(texts))), " ".join(text.replace(" ", "_") for text in texts))
        codes[name] = (name, np.arange(len(texts)), dataset[name].attrs | dict(zip(FLAGS, flags, strict=True)))
    return dataset.assign_coords(codes), labels


def with_labels(dataset: xr.Dataset, labels: Mapping[str, list[str]]) -> xr.Dataset:
    """Reverse :func:`with_codes`."""
    texts = {}
    for name, values in labels.items():
        attributes = {key: value for key, value in dataset[name].attrs.items() if key not in FLAGS}
        texts[name] = (name, np.array(values), attributes)
    return dataset.assign_coords(texts)


def sums_of(dataset: xr.Dataset) -> dict[str, str]:
    """A digest of each variable and coordinate, including dimensions and attributes; ``""`` is the dataset's own."""

    def about(attributes: Mapping[Any, Any]) -> str:
        return json.dumps(attributes, sort_keys=True, default=np.ndarray.tolist)

    sums = {str(name): sum_of(one.values, f"{one.dims} {about(one.attrs)}") for name, one in dataset.variables.items()}
    return sums | {"": hashlib.sha256(about(dataset.attrs).encode()).hexdigest()}


def read_about(folder: Path, kind: str) -> dict[str, Any]:
    """Read and check the description of an analysis.

    Raises:
        ConfigError: it is missing, damaged, or has been altered.
    """
    path = folder / f"{kind}.json"
    try:
        about = json.loads(files.read_text(path))
    except OSError as error:
        rule = f"holds no {kind} analysis: {path.name} cannot be read ({error.strerror})"
        raise ConfigError(str(folder), rule) from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(str(path), f"is damaged, not valid JSON: {error}") from error
    about = unsealed(path, about)
    lacking = [name for name, of in NEEDED.items() if not isinstance(about.get(name), of)]
    if lacking:
        raise ConfigError(str(path), f"is damaged: it has no {', '.join(lacking)}")
    try:
        require_shallow(about["study"])
    except ConfigError as error:
        raise error.within(str(path)) from None
    if hash_of(about["study"]) != about["hash"]:
        raise ConfigError(str(path), "is damaged: the study in it is not the one that its hash is of")
    return about


def read_analysis(folder: Path, kind: str, trust_code: bool = False) -> Stored:
    """Read an analysis written by :func:`save`.

    Args:
        folder: The folder.
        kind: Kind of analysis.
        trust_code: Import the models that its study names as ``module:object``.

    Raises:
        ConfigError: it is missing, damaged, or has been altered.
    """
    about = read_about(folder, kind)
    try:
        dataset = stored_dataset(folder)
        whole = sums_of(dataset) == about["sums"]
        dataset = with_labels(dataset, about.get("labels", {}))
    except Exception as error:  # zarr, its codecs and xarray raise errors of many kinds
        raise ConfigError(str(folder / DATA), f"cannot be read: {' '.join(str(error).split())}") from error
    if not whole:
        raise ConfigError(str(folder / DATA), "is damaged: it does not hold what was written; run the analysis again")
    return Stored(received(about, about["source"], trust_code), dataset, about["settings"])
