"""Reading and writing of a results folder block by block; a block is one chunk of every variable.

Each chunk is written to a temporary file and moved to its final name. The digests of the block are written last. A
block is complete if the values of its chunks match the digests.
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
from dssc_jax.results.arrays import RESUME_HINT, checked_arrays, one_line
from dssc_jax.results.digests import DIGESTS, DrawRange, add_range, digest_of, digest_of_all, stored_ranges
from dssc_jax.results.manifest import DATA
from dssc_jax.study import Study


@contextmanager
def report_write_errors(folder: Path, held_folder: HeldFolder | None = None) -> Iterator[None]:
    """Turn an error of writing within the context, such as a full disk, into a ConfigError with one line.

    Args:
        folder: The results folder, for messages.
        held_folder: The folder in which the writer began, which must still be in place; None: no such check.

    Raises:
        ConfigError: The folder cannot be written, or another folder has taken its place.
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
    """Reads, writes and checks the arrays of a results folder, block by block.

    Several processes may write, each to blocks of its own.

    Args:
        folder: The results folder.
        study: The study as run.
        layout: Blocks of the run.
        mode: ``r`` to read, ``r+`` to write.
        any_draw_count: Whether arrays may have another number of draws than the layout.
        arrays: The arrays, if they have just been created; None: they are opened.
        held_folder: The folder in which the writer began, which must be in place at each write; None: no such check.

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
        """Open the arrays, unless they are given, and check them."""
        self.folder = folder
        self.layout = layout
        self.arrays = checked_arrays(folder, study, layout, mode, any_draw_count) if arrays is None else arrays
        self.law_names = list(study.laws)
        self.held_folder = held_folder

    def write(self, block: Block, results: Arrays, law_values: Arrays) -> None:
        """Write a block, or the draws that are added at its end, and then the digests.

        Args:
            block: The block.
            results: Metrics, slacks and outcomes of the block, by name.
            law_values: Drawn numbers of the block's draws, by name.
        """
        values = results | law_values
        digests = {}
        with report_write_errors(self.folder, self.held_folder):
            for name in self._variables_of(block):
                array = self.arrays[name]
                stored_values = np.asarray(values[name], dtype=array.dtype)
                array[self._part(name, block)] = stored_values
                digests[name] = digest_of(stored_values)
            draws = block[-1].start, block[-1].stop
            add_range(self.folder, self.layout.index(block), DrawRange(draws, digests))

    def pending(self) -> tuple[list[Block], list[Path]]:
        """Find the remaining work: blocks without intact values, or the missing draws at the end of a block.

        Returns:
            The remaining blocks, and the files of blocks that must be computed again as a whole.

        Raises:
            ConfigError: There is a folder in the place of a chunk, or of the file with a block's digests.
        """
        blocks: list[Block] = []
        obsolete_files: list[Path] = []
        for block in self.layout.blocks():
            files = [self._file(name, block) for name in self._variables_of(block)]
            for file in files:
                if file.is_dir():
                    raise ConfigError(str(file), "is damaged: it is a folder, not a chunk; remove it")
            ranges = self._digested_ranges(block)
            if self._altered_variable(block, ranges, self.arrays):
                ranges = []  # the whole block is computed again
            remaining = missing_part(block, ranges)
            if lanes_in(remaining) > 0:
                blocks.append(remaining)
            if not ranges:
                obsolete_files += files
        return blocks, obsolete_files

    def read(self, dataset: xr.Dataset) -> None:
        """Fill a dataset with the stored values, which are not yet compared with their digests.

        Raises:
            ConfigError: A variable cannot be read.
        """
        for name, array in self.arrays.items():
            try:
                dataset[name].values[...] = array[...]
            except Exception as error:  # zarr and its codecs raise errors of many kinds
                rule = f"is damaged: {one_line(error)}; {RESUME_HINT}"
                raise ConfigError(str(self.folder / DATA / name), rule) from error

    def require_all(self) -> None:
        """Refuse a folder in which digests of a block are missing.

        Raises:
            ConfigError: Digests are missing, since the run did not finish.
        """
        blocks = self.layout.blocks()
        missing = sum(lanes_in(missing_part(block, self._digested_ranges(block))) for block in blocks)
        if missing:
            raise incomplete_error(self.folder, missing, sum(map(lanes_in, blocks)))

    def require_written(self, dataset: xr.Dataset, seal: str | None) -> None:
        """Refuse a dataset with values that do not match the digests of the written values.

        Args:
            dataset: The dataset, as :meth:`read` filled it.
            seal: The digest over all blocks in the manifest; None for an unfinished run.

        Raises:
            ConfigError: A value differs, or the digests do not belong to the run.
        """
        values = {name: dataset[name].values for name in self.arrays}
        for block in self.layout.blocks():
            altered_variable = self._altered_variable(block, self._digested_ranges(block), values)
            if altered_variable:
                rule = f"is damaged: block {self.layout.index(block)} does not hold what was written; {RESUME_HINT}"
                raise ConfigError(str(self.folder / DATA / altered_variable), rule)
        if seal is not None and seal != digest_of_all(self.folder, self.layout):
            raise ConfigError(str(self.folder / DIGESTS), f"is damaged: these are not the run's digests; {RESUME_HINT}")

    def _digested_ranges(self, block: Block) -> list[DrawRange]:
        """Ranges of a block's draws with stored digests; empty unless they cover the first draws without a gap."""
        ranges = stored_ranges(self.folder, self.layout.index(block))
        draws = block[-1]
        end = draws.start  # of the draws that are covered so far
        for draw_range in ranges:
            start, stop = draw_range.draws
            if start != end or stop <= start:
                return []
            end = stop
        return ranges if end <= draws.stop else []

    def _altered_variable(
        self, block: Block, ranges: list[DrawRange], values: Mapping[str, zarr.Array] | Mapping[str, np.ndarray]
    ) -> str:
        """The first variable of a block whose values do not match the digests; empty if all match.

        Args:
            block: The block.
            ranges: Digests of the block.
            values: All values of each variable by name; the block selects a part of them.
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
        """Names of the variables that are stored with a block.

        Drawn numbers are the same at all points of a sweep. They are stored with the first block of their draws only.
        """
        is_first_of_draws = all(part.start == 0 for part in block[:-1])
        if is_first_of_draws:
            return list(self.arrays)
        return [name for name in self.arrays if name not in self.law_names]

    def _part(self, name: str, block: Block) -> Block:
        """Slices of a variable's array that belong to a block; drawn numbers have only the dimension of draws."""
        return block[-1:] if name in self.law_names else block

    def _file(self, name: str, block: Block) -> Path:
        """Path of the chunk of a variable in a block, such as ``data.zarr/outcome/c/0/3``."""
        index = self.layout.index(block)
        if name in self.law_names:
            index = index[-1:]
        return self.folder / DATA / name / "c" / Path(*map(str, index))


def missing_part(block: Block, ranges: list[DrawRange]) -> Block:
    """The part of a block whose draws have no digests; it has no draws if all draws have digests.

    Args:
        block: The block.
        ranges: Digests of the block's draws, from the first draw on without a gap.
    """
    draws = block[-1]
    start = draws.start
    if ranges:
        _, start = ranges[-1].draws
    return (*block[:-1], slice(start, draws.stop))


def incomplete_error(folder: Path, missing: int, total: int) -> ConfigError:
    """The error of a run that did not finish, with the numbers of missing lanes and of all lanes."""
    return ConfigError(str(folder), f"is not complete: {missing} of {total} lanes are missing; finish with `resume`")
