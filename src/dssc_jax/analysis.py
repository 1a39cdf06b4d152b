"""What an analysis that is no run of a study's grid leaves: a folder with a dataset, or an answer in one file."""

import json
from pathlib import Path
from typing import Any

import xarray as xr

from dssc_jax.errors import ConfigError
from dssc_jax.manifest import DATA, SUMMARY, write_json
from dssc_jax.study import Study


def require_free(folder: Path, kind: str) -> None:
    """Require that a folder is absent, empty, or holds an analysis of this kind.

    Raises:
        ConfigError: it holds something else.
    """
    if folder.exists() and not (folder.is_dir() and ((folder / f"{kind}.json").exists() or not any(folder.iterdir()))):
        raise ConfigError(str(folder), f"holds something other than a {kind} analysis; nothing was written")


def save(folder: Path, kind: str, study: Study, dataset: xr.Dataset, summary: dict[str, Any]) -> Path:
    """Write the folder of an analysis; one of the same kind is written anew.

    Args:
        folder: Made when absent.
        kind: Which analysis: ``margin``, ``compare``.
        study: What was analysed.
        dataset: Every draw.
        summary: What they say together.

    Raises:
        ConfigError: the folder holds something else.
    """
    require_free(folder, kind)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / f"{kind}.json", {"study": study.table, "hash": study.hash, "source": study.source})
    dataset.to_zarr(folder / DATA, mode="w", consolidated=False)
    write_json(folder / SUMMARY, summary)
    return folder


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
