"""The folder of a run: a Zarr store of all draws, manifest.json and summary.json."""

from collections.abc import Iterable
from pathlib import Path

import xarray as xr

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Block, Layout, lanes_in
from dssc_jax.engine.sampling import Arrays
from dssc_jax.results import lock
from dssc_jax.results.arrays import create_arrays, extend_arrays, has_all_arrays, require_coordinates
from dssc_jax.results.blocks import Chunks, report_write_errors
from dssc_jax.results.digests import DIGESTS, digest_of_all
from dssc_jax.results.manifest import (
    DATA,
    MANIFEST,
    SCHEMA,
    SUMMARY,
    Manifest,
    asks_for_more_draws,
    is_occupied,
    read_manifest,
    require_same_machinery,
    require_same_study,
    require_startable,
    stored_layout,
    write_manifest,
)
from dssc_jax.results.schema import copy_block, empty_dataset
from dssc_jax.study import Study, hash_of, stored_study


class Store:
    """A results folder into which a run writes its blocks; the run holds the folder's lock.

    The attribute ``pending`` has the blocks that the run still has to compute.

    Args:
        folder: The folder; created if absent.
        study: The study as run.
        manifest: Content of manifest.json until the run is complete, including the layout.
        resume: Whether to keep the finished blocks of an earlier run of the same study, which may have fewer draws.

    Raises:
        ConfigError: The folder contains another study's results or something else, another process is writing to it,
            or it cannot be written.
    """

    def __init__(self, folder: Path, study: Study, manifest: Manifest, resume: bool = False) -> None:
        """Lock the folder, and begin or resume the run in it."""
        self.folder = folder
        self.study = study
        self.values: xr.Dataset | None = None  # all blocks, where this process computes them
        require_startable(folder, study, resume)
        with report_write_errors(folder):
            files.make_folder(folder)
            self.held_folder = files.HeldFolder(folder)
        try:
            with report_write_errors(folder):
                self._lock = lock.take(folder)
        except BaseException:
            self.held_folder.close()
            raise
        try:
            stored = read_manifest(folder) if is_occupied(folder) else None
            if stored is not None:
                require_same_study(folder, stored, study, resume)  # again, now that no other process writes
            with report_write_errors(folder):
                is_resumed = stored is not None and resume and self._resume(stored, manifest)
                if not is_resumed:
                    self._begin(manifest)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> "Store":
        """The store itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the store, with or without an exception."""
        self.close()

    def close(self) -> None:
        """Release the lock and close the folder."""
        self._lock.release()
        self.held_folder.close()

    @property
    def finished(self) -> bool:
        """Whether the run is complete and recorded as complete in the manifest."""
        return bool(self.manifest.get("complete")) and not self.pending

    @property
    def layout(self) -> Layout:
        """The division of the grid into blocks; a resumed run keeps the blocks with which it began."""
        return self.chunks.layout

    def _begin(self, manifest: Manifest) -> None:
        """Delete the content of an earlier run, write the manifest, and create the arrays."""
        for name in (DATA, DIGESTS):
            files.delete_tree(self.folder / name, self.folder)
        files.delete(self.folder / SUMMARY)
        files.delete_partials(self.folder)
        manifest = {name: value for name, value in manifest.items() if name != DIGESTS}
        manifest["schema"] = SCHEMA
        write_manifest(self.folder, manifest)  # before the data, so that an interrupted run is recognised
        layout = Layout.from_dict(manifest["layout"])
        self.manifest = manifest
        self.pending = layout.blocks()
        arrays = create_arrays(self.folder, self.study, layout)
        self.chunks = Chunks(self.folder, self.study, layout, arrays=arrays, held_folder=self.held_folder)

    def _resume(self, stored: Manifest, present: Manifest) -> bool:
        """Continue an earlier run, perhaps with more draws.

        Args:
            stored: Manifest of the earlier run.
            present: Content of the manifest of this run.

        Returns:
            Whether the run continues; False if the earlier run stopped before it created its arrays.
        """
        draws = stored["study"].get("draws", 1)
        layout = stored_layout(self.folder, self.study, stored, draws)
        if not has_all_arrays(self.folder, self.study, layout):
            return False
        if asks_for_more_draws(stored, self.study):
            self._extend(stored, present, layout)
        else:
            files.delete_partials(self.folder)
            self.manifest = stored
        extend_arrays(self.folder, self.study, layout)
        self.chunks = Chunks(self.folder, self.study, layout, "r+", held_folder=self.held_folder)
        self.pending, obsolete_files = self.chunks.pending()
        if self.pending:
            require_same_machinery(self.folder, stored, present)
        else:
            self._require_sealed(stored, layout)
        for file in obsolete_files:
            files.delete(file, self.folder)
        return True

    def _extend(self, stored: Manifest, present: Manifest, layout: Layout) -> None:
        """Check the draws of an earlier run, and record the larger number of draws in the manifest.

        Args:
            stored: Manifest of the earlier run.
            present: Content of the manifest from now on.
            layout: Layout with the new number of draws.
        """
        require_same_machinery(self.folder, stored, present)
        draws = stored["study"].get("draws", 1)
        old_layout = Layout((*layout.shape[:-1], draws), layout.block)
        self._require_sealed(stored, old_layout)
        files.delete_partials(self.folder)
        self.manifest = present | {"layout": layout.to_dict()}
        write_manifest(self.folder, self.manifest)  # before the arrays grow, so that an interrupted run is recognised
        files.delete(self.folder / SUMMARY)

    def _require_sealed(self, manifest: Manifest, layout: Layout) -> None:
        """Refuse blocks whose digests do not match the digest over all blocks in the manifest, if there is one."""
        if DIGESTS in manifest and manifest[DIGESTS] != digest_of_all(self.folder, layout):
            raise ConfigError(str(self.folder / DIGESTS), "is damaged: these are not the run's digests; start over")

    def write(self, block: Block, results: Arrays, law_values: Arrays) -> None:
        """Write a pending block; if this process computes all blocks, also keep the block in memory.

        Args:
            block: The block.
            results: Metrics, slacks and outcomes of the block, by name.
            law_values: Drawn numbers of the block's draws, by name.
        """
        self.chunks.write(block, results, law_values)
        computes_all = self.pending == self.layout.blocks()
        if self.values is None and computes_all:
            self.values = empty_dataset(self.study)
        if self.values is not None:
            copy_block(self.values, block, results, law_values)

    def complete(self, entries: Manifest) -> None:
        """Record in the manifest that the run is complete.

        Args:
            entries: Further entries of the manifest of a finished run.

        Raises:
            ConfigError: A block is read back with other values than were written; nothing is recorded then.
        """
        self._require_sealed(self.manifest, self.layout)  # blocks computed again equal the original blocks
        self.require_kept()
        digest = digest_of_all(self.folder, self.layout)
        self.manifest = self.manifest | entries | {DIGESTS: digest, "complete": True}
        with report_write_errors(self.folder, self.held_folder):
            write_manifest(self.folder, self.manifest)

    def require_kept(self) -> None:
        """Read the folder again, and refuse it unless it holds all blocks as they were written.

        Raises:
            ConfigError: Blocks are lost or altered; the message says how much and where.
        """
        self.held_folder.require_in_place()
        pending, _ = Chunks(self.folder, self.study, self.layout).pending()
        require_coordinates(self.folder, self.study)
        if pending:
            lost = sum(map(lanes_in, pending))
            total = sum(map(lanes_in, self.layout.blocks()))
            rule = f"is not complete: {lost} of {total} lanes are no longer as they were written; finish with `resume`"
            raise ConfigError(str(self.folder), rule)

    def read(self) -> tuple[xr.Dataset, Manifest]:
        """Dataset and manifest of the complete run; from memory if this process has computed all blocks.

        Raises:
            ConfigError: The blocks on disk, which other processes or an earlier run have written, are damaged.
        """
        if self.values is not None:
            return self.values, self.manifest
        return read_dataset(self.folder, self.study, self.manifest), self.manifest

    def summarise(self, lines: Iterable[str]) -> None:
        """Write summary.json, the last file of a run.

        Args:
            lines: The text of the file, in pieces.

        Raises:
            ConfigError: The folder cannot be written, or it no longer holds the manifest of the finished run.
        """
        with report_write_errors(self.folder, self.held_folder):
            files.write_text(self.folder / SUMMARY, lines)
        self.held_folder.require_in_place()
        if hash_of(read_manifest(self.folder)) != hash_of(self.manifest):
            raise ConfigError(str(self.folder / MANIFEST), "does not hold what was written; finish with `resume`")


def read_run(folder: Path, trust_code: bool) -> tuple[Study, xr.Dataset, Manifest]:
    """Read study, dataset and manifest of a results folder.

    Raises:
        ConfigError: The folder is not a results folder, it is damaged, or its run did not finish.
    """
    manifest = read_manifest(folder)
    study = stored_study(manifest, str(folder / MANIFEST), trust_code)
    return study, read_dataset(folder, study, manifest), manifest


def read_dataset(folder: Path, study: Study, manifest: Manifest) -> xr.Dataset:
    """Read the dataset of a results folder, and check all digests.

    Args:
        folder: The results folder.
        study: The study as run.
        manifest: Manifest of the folder.

    Raises:
        ConfigError: The folder is damaged, or its run did not finish.
    """
    layout = stored_layout(folder, study, manifest)
    chunks = Chunks(folder, study, layout, any_draw_count=not manifest.get("complete"))
    chunks.require_all()
    dataset = empty_dataset(study)
    chunks.read(dataset)
    chunks.require_written(dataset, manifest.get(DIGESTS))
    require_coordinates(folder, study)
    return dataset
