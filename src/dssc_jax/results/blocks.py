"""Block-wise reading and writing of a results folder; each block is one chunk of every variable.

A chunk is written to a temporary file and moved to its final name; the block's digests follow. A block is complete if
the values of its chunks match its digests.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import xarray as xr
import zarr

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.files import HeldFolder
from dssc_jax.engine.batching import Block, Layout, lanes_in
from dssc_jax.engine.sampling import Arrays
from dssc_jax.results.arrays import MEND, checked_arrays, one_line
from dssc_jax.results.digests import DIGESTS, DrawRange, add_range, digest_of, over_all, ranges_of
from dssc_jax.results.manifest import DATA
from dssc_jax.study import Study


@contextmanager
def writing(folder: Path, held_folder: HeldFolder | None = None) -> Iterator[None]:
    """Report a full disk, or any other error that prevents writing, in one line.

    Args:
        folder: The results folder, for messages.
        held_folder: The folder as it was when the writer began; None: it is not compared.

    Raises:
        ConfigError: the folder cannot be written, or it is no longer the one in which the writer began.
    """
    if held_folder is not None:
        held_folder.require_in_place()
    try:
        yield
    except OSError as error:
        if held_folder is not None:
            held_folder.require_in_place()
        reason = error.strerror or one_line(error)
        raise ConfigError(
            str(folder), f"cannot be written: {reason}; finished blocks are kept, `resume` continues from them"
        ) from error


class Chunks:
    """The arrays of a results folder, block by block. Any number of processes may write, each to its own blocks.

    Args:
        folder: The results folder with its arrays.
        study: The study as run.
        layout: Its blocks.
        mode: ``r`` to read, ``r+`` to write.
        any_draw_count: Whether arrays may have another number of draws than the layout.
        arrays: The arrays, if they have just been created; None: they are opened.
        held_folder: The folder as it was when its writer began; None: it is not compared when a block is written.

    Raises:
        ConfigError: An array is absent or differs from its creation.
    """

    def __init__(
        self,
        folder: Path,
        study: Study,
        layout: Layout,
        mode: str = "r",
        any_draw_count: bool = False,
        arrays: dict[str, zarr.Array] | None = None,
        held_folder: HeldFolder | None = None,
    ) -> None:
        self.folder = folder
        self.layout = layout
        self.arrays = checked_arrays(folder, study, layout, mode, any_draw_count) if arrays is None else arrays
        self.law_names = list(study.laws)
        self.held_folder = held_folder

    def write(self, block: Block, results: Arrays, law_values: Arrays) -> None:
        """Write a block, or the new end of an extended one, and then its digests."""
        values = results | law_values
        digests = {}
        with writing(self.folder, self.held_folder):
            for name in self._variables_of(block):
                array = self.arrays[name]
                stored_values = np.asarray(values[name], dtype=array.dtype)
                array[self._part(name, block)] = stored_values
                digests[name] = digest_of(stored_values)
            draws = block[-1].start, block[-1].stop
            add_range(self.folder, self.layout.index(block), DrawRange(draws, digests))

    def pending(self) -> tuple[list[Block], list[Path]]:
        """The work that remains: whole blocks, or the missing draws at the end of a block.

        Returns:
            The blocks, and the files of blocks that are not kept.

        Raises:
            ConfigError: There is a folder in place of a chunk or its digests.
        """
        blocks: list[Block] = []
        obsolete_files: list[Path] = []
        for block in self.layout.blocks():
            files = [self._file(name, block) for name in self._variables_of(block)]
            for file in files:
                if file.is_dir():
                    raise ConfigError(str(file), "is damaged: it is a folder, not a chunk; remove it")
            ranges = self._ranges(block)
            if ranges and self._altered(block, ranges, self.arrays):
                ranges = []
            remaining = uncovered(block, ranges)
            if lanes_in(remaining) > 0:
                blocks.append(remaining)
            if not ranges:
                obsolete_files += files
        return blocks, obsolete_files

    def read(self, dataset: xr.Dataset) -> None:
        """Fill a dataset with the stored values.

        Raises:
            ConfigError: A variable cannot be read.
        """
        for name, array in self.arrays.items():
            try:
                dataset[name].values[...] = array[...]
            except Exception as error:  # zarr and its codecs raise errors of many kinds
                raise ConfigError(str(self.folder / DATA / name), f"is damaged: {one_line(error)}; {MEND}") from error

    def require_all(self) -> None:
        """Require every block's digests.

        Raises:
            ConfigError: Some are absent, because the run did not finish.
        """
        blocks = self.layout.blocks()
        missing = sum(lanes_in(uncovered(block, self._ranges(block))) for block in blocks)
        if missing:
            raise incomplete(self.folder, missing, sum(map(lanes_in, blocks)))

    def require_written(self, dataset: xr.Dataset, seal: str | None) -> None:
        """Require that a dataset equals the written data.

        Args:
            dataset: The dataset that was read.
            seal: The digest over all blocks; None for an unfinished run.

        Raises:
            ConfigError: It does not.
        """
        values = {name: dataset[name].values for name in self.arrays}
        for block in self.layout.blocks():
            altered_variable = self._altered(block, self._ranges(block), values)
            if altered_variable:
                rule = f"is damaged: block {self.layout.index(block)} does not hold what was written; {MEND}"
                raise ConfigError(str(self.folder / DATA / altered_variable), rule)
        if seal is not None and seal != over_all(self.folder, self.layout):
            raise ConfigError(str(self.folder / DIGESTS), f"is damaged: these are not the run's digests; {MEND}")

    def _ranges(self, block: Block) -> list[DrawRange]:
        """A block's digests, if they cover its draws from the first without a gap; else none."""
        ranges = ranges_of(self.folder, self.layout.index(block))
        ends = [block[-1].start, *(draw_range.draws[1] for draw_range in ranges)]
        sound = [draw_range.draws[0] for draw_range in ranges] == ends[:-1] and ends == sorted({*ends})
        return ranges if sound and ends[-1] <= block[-1].stop else []

    def _altered(
        self, block: Block, ranges: list[DrawRange], values: Mapping[str, zarr.Array] | Mapping[str, np.ndarray]
    ) -> str:
        """The first variable that differs from the written data; empty if there is none.

        Args:
            block: The block.
            ranges: Its digests.
            values: Each variable as an object that can be indexed by the block.
        """
        for draw_range in ranges:
            part = (*block[:-1], slice(*draw_range.draws))
            for name in self._variables_of(block):
                try:
                    actual = digest_of(np.asarray(values[name][self._part(name, part)]))
                except Exception:  # zarr and its codecs raise errors of many kinds
                    return name
                if actual != draw_range.digests.get(name):
                    return name
        return ""

    def _variables_of(self, block: Block) -> list[str]:
        """Names of the variables that a block holds; drawn numbers belong to the first block of their draws."""
        first = all(part.start == 0 for part in block[:-1])
        return [name for name in self.arrays if first or name not in self.law_names]

    def _part(self, name: str, block: Block) -> Block:
        return block[-1:] if name in self.law_names else block

    def _file(self, name: str, block: Block) -> Path:
        index = self.layout.index(block)
        return self.folder / DATA / name / "c" / Path(*map(str, index[-1:] if name in self.law_names else index))


def uncovered(block: Block, ranges: list[DrawRange]) -> Block:
    """The part of a block that its digests do not cover."""
    return (*block[:-1], slice(ranges[-1].draws[1] if ranges else block[-1].start, block[-1].stop))


def incomplete(folder: Path, missing: int, total: int) -> ConfigError:
    """The error for a run that did not finish."""
    return ConfigError(str(folder), f"is not complete: {missing} of {total} lanes are missing; finish with `resume`")
