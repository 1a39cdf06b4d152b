"""A results folder: a Zarr store of all draws, manifest.json and summary.json; filled by one run, read by anybody."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from dssc_jax import lock
from dssc_jax.chunks import MEND, Chunks, incomplete, laid_out, lay_out, one_line, reshape, told
from dssc_jax.dataset import NOT_COMPUTED, in_memory
from dssc_jax.engine import Layout
from dssc_jax.errors import ConfigError
from dssc_jax.manifest import (
    DATA,
    MANIFEST,
    PARTIAL,
    SUMMARY,
    read_manifest,
    require_same_machinery,
    require_same_study,
    stored_layout,
    write_json,
)
from dssc_jax.study import Study

OWN = (lock.LOCK, lock.HOLDER, Path(MANIFEST).with_suffix(PARTIAL).name)
"""What a run that was killed at its very beginning leaves behind."""


class Store:
    """A results folder being filled by one run, which holds its lock.

    Args:
        folder: Where; made when absent.
        study: The study as run.
        manifest: What manifest.json says until the run is complete, the layout included.
        resume: Keep what an earlier run of the same study finished; the study may ask for more draws.

    Raises:
        ConfigError: the folder holds another study's results, or something that is no result, or somebody is
            writing it, or it cannot be written.
    """

    def __init__(self, folder: Path, study: Study, manifest: dict[str, Any], resume: bool = False) -> None:
        self.folder, self.study = folder, study
        if self._occupied():
            require_same_study(folder, read_manifest(folder), study, resume)  # before anything is touched
        with told(folder):
            folder.mkdir(parents=True, exist_ok=True)
            self._lock = lock.take(folder)
        try:
            old = read_manifest(folder) if self._occupied() else None
            more = old is not None and require_same_study(folder, old, study, resume)
            with told(folder):
                if old is None or not resume or not self._go_on(old, manifest, more):
                    self._begin(manifest)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "Store":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Release the lock."""
        self._lock.release()

    @property
    def finished(self) -> bool:
        """Whether there is nothing left to do, and the manifest says so."""
        return bool(self.manifest.get("complete")) and not self.pending

    @property
    def layout(self) -> Layout:
        """The blocks; a resumed run keeps those it began with."""
        return self.chunks.layout

    def _occupied(self) -> bool:
        if self.folder.exists() and not self.folder.is_dir():
            raise ConfigError(str(self.folder), "is a file, not a results folder; nothing was written")
        return self.folder.exists() and any(file.name not in OWN for file in self.folder.iterdir())

    def _begin(self, manifest: dict[str, Any]) -> None:
        shutil.rmtree(self.folder / DATA, ignore_errors=True)
        (self.folder / SUMMARY).unlink(missing_ok=True)
        write_json(self.folder / MANIFEST, manifest)  # before the data, so that an interrupted run is known as one
        layout = Layout.from_dict(manifest["layout"])
        lay_out(self.folder, self.study, layout)
        self.manifest, self.pending = manifest, layout.blocks()
        self.chunks = Chunks(self.folder, self.study, layout, "r+")

    def _go_on(self, old: dict[str, Any], new: dict[str, Any], more: bool) -> bool:
        """Take up what is there; False where the run before did not come as far as laying out its store."""
        began = Study.from_table(old["study"], str(self.folder / MANIFEST))
        layout = Layout(Layout.of(self.study).shape, stored_layout(self.folder, began, old).block)
        if not laid_out(self.folder, self.study, layout):
            return False
        if more:
            require_same_machinery(self.folder, old, new)
        for partial in (self.folder / DATA).rglob(f"*{PARTIAL}"):
            partial.unlink(missing_ok=True)
        self.manifest = old
        if more:
            self.manifest = new | {"layout": layout.to_dict()}
            write_json(self.folder / MANIFEST, self.manifest)  # before the arrays grow, for the same reason
            (self.folder / SUMMARY).unlink(missing_ok=True)
        reshape(self.folder, self.study, layout)
        self.chunks = Chunks(self.folder, self.study, layout, "r+")
        self.pending, damaged = self.chunks.pending()
        if self.pending:
            require_same_machinery(self.folder, old, new)
        for file in damaged:
            file.unlink(missing_ok=True)
        return True

    def complete(self, about: dict[str, Any]) -> None:
        """Record that every block is there, and what the manifest says further of the finished run."""
        self.manifest = self.manifest | about | {"complete": True}
        with told(self.folder):
            write_json(self.folder / MANIFEST, self.manifest)

    def summarise(self, summary: dict[str, Any]) -> None:
        """Write summary.json."""
        with told(self.folder):
            write_json(self.folder / SUMMARY, summary)


def read(folder: Path) -> tuple[Study, xr.Dataset, dict[str, Any]]:
    """Study, dataset and manifest of a results folder.

    Raises:
        ConfigError: it is no results folder, it is damaged, or its run did not finish.
    """
    manifest = read_manifest(folder)
    study = Study.from_table(manifest["study"], str(folder / MANIFEST))
    chunks = Chunks(folder, study, stored_layout(folder, study, manifest))
    dataset = in_memory(study)
    chunks.require_all(dataset)
    for name, array in chunks.arrays.items():
        try:
            dataset[name].values[...] = array[...]
        except Exception as error:  # zarr and its codecs raise errors of many kinds
            raise ConfigError(str(folder / DATA / name), f"is damaged: {one_line(error)}; {MEND}") from error
    unfinished = int(np.count_nonzero(dataset["outcome"].values == NOT_COMPUTED))
    if unfinished:
        raise incomplete(folder, unfinished, dataset["outcome"].size)
    return study, dataset, manifest
