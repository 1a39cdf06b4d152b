"""What an analysis that is no run of a study's grid leaves: a folder with a dataset, or an answer in one file."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from dssc_jax.core.errors import ConfigError
from dssc_jax.results.digests import sum_of
from dssc_jax.results.manifest import DATA, SCHEMA, SEAL, SUMMARY, about_code, unsealed, write_json, write_sealed
from dssc_jax.study import Study, hash_of, received
from dssc_jax.study.tables import require_shallow

NEEDED = {"study": dict, "hash": str, "source": str, "how": dict, "sums": dict}
"""What the file of an analysis says beside its dataset, and of which type."""


class Stored(NamedTuple):
    """An analysis as it was read.

    Args:
        study: What was analysed.
        dataset: Every draw.
        how: What else :func:`save` was given.
    """

    study: Study
    dataset: xr.Dataset
    how: dict[str, Any]


def require_free(folder: Path, kind: str) -> None:
    """Require that a folder is absent, empty, or holds an analysis of this kind.

    Raises:
        ConfigError: it holds something else.
    """
    if folder.exists() and not (folder.is_dir() and ((folder / f"{kind}.json").exists() or not any(folder.iterdir()))):
        raise ConfigError(str(folder), f"holds something other than a {kind} analysis; nothing was written")


def save(
    folder: Path,
    kind: str,
    study: Study,
    dataset: xr.Dataset,
    summary: dict[str, Any],
    how: dict[str, Any] | None = None,
) -> Path:
    """Write the folder of an analysis; one of the same kind is written anew.

    Args:
        folder: Made when absent.
        kind: Which analysis, e.g. ``margin``.
        study: What was analysed.
        dataset: Every draw.
        summary: What they say together.
        how: What else its reader needs.

    Raises:
        ConfigError: the folder holds something else.
    """
    require_free(folder, kind)
    folder.mkdir(parents=True, exist_ok=True)
    about = {"study": study.table, "hash": study.hash, "source": study.source, "how": how or {}}
    about |= {"sums": sums_of(dataset), "schema": SCHEMA, **about_code(study)}
    write_sealed(folder / f"{kind}.json", about)
    dataset.to_zarr(folder / DATA, mode="w", consolidated=False, zarr_format=3)
    write_json(folder / SUMMARY, summary)
    return folder


def sums_of(dataset: xr.Dataset) -> dict[str, str]:
    """A digest of each variable and coordinate, dimensions and attributes included; ``""`` is the dataset's own."""

    def about(attributes: Mapping[Any, Any]) -> str:
        return json.dumps(attributes, sort_keys=True, default=np.ndarray.tolist)

    found = {str(name): sum_of(one.values, f"{one.dims} {about(one.attrs)}") for name, one in dataset.variables.items()}
    return found | {"": hashlib.sha256(about(dataset.attrs).encode()).hexdigest()}


def plain_sums_of(dataset: xr.Dataset) -> dict[str, str]:
    """The sums of a file without a digest of its own, from before attributes were summed."""
    found = {}
    for name, one in dataset.variables.items():
        head = f"{one.dims} {one.shape} {one.dtype.str}".encode()
        found[str(name)] = hashlib.sha256(head + np.ascontiguousarray(one.values).tobytes()).hexdigest()
    return found


def read(folder: Path, kind: str, trust_code: bool = False) -> Stored:
    """Read what :func:`save` wrote.

    Args:
        folder: The folder.
        kind: Which analysis.
        trust_code: Import the models that its study names as ``module:object``.

    Raises:
        ConfigError: it is not there, it is damaged, or somebody has altered it.
    """
    path = folder / f"{kind}.json"
    try:
        about = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        rule = f"holds no {kind} analysis: {path.name} cannot be read ({error.strerror})"
        raise ConfigError(str(folder), rule) from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(str(path), f"is damaged, not valid JSON: {error}") from error
    about = about if isinstance(about, dict) else {}
    lacking = [name for name, of in NEEDED.items() if not isinstance(about.get(name), of)]
    if lacking:
        raise ConfigError(str(path), f"is damaged, or of another version: it has no {', '.join(lacking)}")
    digested = SEAL in about or "schema" in about
    if digested:
        about = unsealed(path, about)
    try:
        require_shallow(about["study"])
    except ConfigError as error:
        raise error.within(str(path)) from None
    if hash_of(about["study"]) != about["hash"]:
        raise ConfigError(str(path), "is damaged: the study in it is not the one that its hash is of")
    try:
        dataset = xr.open_zarr(folder / DATA, consolidated=False, zarr_format=3, chunks=None).load()
        whole = (sums_of if digested else plain_sums_of)(dataset) == about["sums"]
    except Exception as error:  # zarr, its codecs and xarray raise errors of many kinds
        raise ConfigError(str(folder / DATA), f"cannot be read: {' '.join(str(error).split())}") from error
    if not whole:
        raise ConfigError(str(folder / DATA), "is damaged: it does not hold what was written; run the analysis again")
    return Stored(received(about, about["source"], trust_code), dataset, about["how"])


def require_place(path: Path, study: Study) -> None:
    """Require that an answer of the study may be written.

    Raises:
        ConfigError: the file holds something else, or its folder is a file.
    """
    if path.parent.exists() and not path.parent.is_dir():
        raise ConfigError(str(path.parent), "is a file, not a results folder; nothing was written")
    if path.exists():
        try:
            same = json.loads(path.read_text(encoding="utf-8"))["hash"] == study.hash
        except (ValueError, KeyError, TypeError):
            same = False
        if not same:
            raise ConfigError(str(path), "holds the answer to another study; choose another --out, nothing was written")


def write_answer(path: Path, content: dict[str, Any], study: Study) -> None:
    """Write an analysis that has no dataset, with the study that it is of.

    Args:
        path: A JSON file that :func:`require_place` has passed; its folder is made when absent.
        content: The answer.
        study: What it answers for.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, {**content, "hash": study.hash, "source": study.source, "inputs": study.table})
