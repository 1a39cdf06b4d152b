"""The folder of an analysis that is no run of a study's grid: its dataset, its summary, and the study."""

from pathlib import Path
from typing import Any

import xarray as xr

from dssc_jax.errors import ConfigError
from dssc_jax.store import DATA, SUMMARY, write_json
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
