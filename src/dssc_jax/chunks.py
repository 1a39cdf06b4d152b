"""The Zarr arrays of a results folder, block by block, each block being one chunk of every variable.

A chunk is written beside its place, with a checksum, and moved there. The chunk of ``outcome`` is written last: a
block is complete where all of its chunks read well and no outcome is missing.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr
from zarr.codecs import ZstdCodec

from dssc_jax.dataset import (
    NOT_COMPUTED,
    Variable,
    coordinate_values,
    coordinates,
    dataset_attributes,
    variables,
)
from dssc_jax.engine import Arrays, Layout, lanes_in
from dssc_jax.errors import ConfigError
from dssc_jax.manifest import DATA
from dssc_jax.study import Study

Block = tuple[slice, ...]
MEND = "--resume computes again what does not read"


@contextmanager
def told(folder: Path) -> Iterator[None]:
    """A full disk, and whatever else prevents writing, in one line.

    Raises:
        ConfigError: the folder cannot be written.
    """
    try:
        yield
    except OSError as error:
        reason = error.strerror or one_line(error)
        raise ConfigError(
            str(folder), f"cannot be written: {reason}; what was finished is kept, --resume goes on from there"
        ) from error


class Chunks:
    """The arrays of a results folder, block by block. Any number of processes may write, each its own blocks.

    Args:
        folder: The results folder, laid out.
        study: The study as run.
        layout: Its blocks.
        mode: ``r`` to read, ``r+`` to write.

    Raises:
        ConfigError: an array is absent or not as it was laid out.
    """

    def __init__(self, folder: Path, study: Study, layout: Layout, mode: str = "r") -> None:
        self.folder, self.layout = folder, layout
        self.arrays = checked_arrays(folder, study, layout, mode)
        self.drawn = list(study.laws)

    def write(self, block: Block, results: Arrays, drawn: Arrays) -> None:
        """Write a block; ``outcome`` last."""
        with told(self.folder):
            if all(part.start == 0 for part in block[:-1]):
                for name, values in drawn.items():
                    self.arrays[name][block[-1]] = values
            for name, array in self.arrays.items():
                if name not in self.drawn:
                    array[block] = results[name]

    def pending(self) -> tuple[list[Block], list[Path]]:
        """What is still to be computed: whole blocks, or the draws that are missing at a block's end.

        Returns:
            The blocks, and the files of chunks that are damaged.

        Raises:
            ConfigError: a folder stands where a chunk should be.
        """
        blocks: list[Block] = []
        damaged: list[Path] = []
        for block in self.layout.blocks():
            missing = self._missing(block, damaged)
            if missing is not None:
                blocks.append(missing)
        return blocks, damaged

    def _missing(self, block: Block, damaged: list[Path]) -> Block | None:
        files = {name: self._file(name, block) for name in self.arrays}
        for file in files.values():
            if file.is_dir():
                raise ConfigError(str(file), "is damaged: a folder stands in the place of a chunk; take it away")
        if not all(file.is_file() for file in files.values()):
            return block
        values = {}
        for name, array in self.arrays.items():
            try:
                values[name] = np.asarray(array[block[-1:] if name in self.drawn else block])
            except Exception:  # zarr and its codecs raise errors of many kinds
                damaged.append(files[name])
        if len(values) < len(files):
            return block
        absent = np.any(values["outcome"] == NOT_COMPUTED, axis=tuple(range(len(block) - 1)))
        if not absent.any():
            return None
        return (*block[:-1], slice(block[-1].start + int(np.argmax(absent)), block[-1].stop))

    def _file(self, name: str, block: Block) -> Path:
        index = [part.start // size for part, size in zip(block, self.layout.block, strict=True)]
        return self.folder / DATA / name / "c" / Path(*map(str, index[-1:] if name in self.drawn else index))

    def require_all(self, dataset: xr.Dataset) -> None:
        """Require a dataset's shape and every chunk's file: an absent one would read as NaN without a word.

        Raises:
            ConfigError: otherwise.
        """
        blocks = self.layout.blocks()
        lanes = [lanes_in(block) for block in blocks if not self._file("outcome", block).is_file()]
        if lanes:
            raise incomplete(self.folder, sum(lanes), dataset["outcome"].size)
        for name, array in self.arrays.items():
            place, shape = str(self.folder / DATA / name), dataset[name].shape
            if array.shape != shape:
                raise ConfigError(place, f"is damaged: its shape is {array.shape}, not {shape}; {MEND}")
            absent = sum(not self._file(name, block).is_file() for block in blocks)
            if absent:
                raise ConfigError(place, f"is damaged: {absent} of {len(blocks)} chunks missing; {MEND}")


def incomplete(folder: Path, missing: int, total: int) -> ConfigError:
    """The error of a run that did not finish."""
    return ConfigError(str(folder), f"is not complete: {missing} of {total} lanes are missing; finish with --resume")


def lay_out(folder: Path, study: Study, layout: Layout) -> zarr.Group:
    """Every array of the store, empty."""
    group = zarr.open_group(folder / DATA, mode="w", zarr_format=3, attributes={**dataset_attributes(study)})
    for name, values in coordinate_values(study).items():
        array = create(group, name, coordinates(study)[name], values.shape, values.shape)
        array[...] = values
    for name, variable in variables(study).items():
        drawn = variable.dims == ("draw",)
        shape = layout.shape[-1:] if drawn else layout.shape
        create(group, name, variable, shape, layout.block[-1:] if drawn else layout.block)
    return group


def create(
    group: zarr.Group,
    name: str,
    variable: Variable,
    shape: tuple[int, ...],
    chunks: tuple[int, ...],
    overwrite: bool = False,
) -> zarr.Array:
    """One array with its dimensions and attributes, and a checksum in every chunk."""
    return group.create_array(
        name,
        overwrite=overwrite,
        compressors=ZstdCodec(checksum=True),
        shape=shape,
        chunks=chunks,
        dtype=variable.dtype,
        fill_value=np.nan if variable.dtype.startswith("float") else NOT_COMPUTED,
        dimension_names=variable.dims,
        attributes=dict(variable.attributes),
    )


def open_group(folder: Path, mode: str) -> zarr.Group:
    """The folder's Zarr group. Version 3 only: version 2 has a codec that unpickles.

    Raises:
        ConfigError: it is absent or damaged.
    """
    try:
        return zarr.open_group(folder / DATA, mode=mode, zarr_format=3)  # type: ignore[arg-type]
    except Exception as error:  # zarr has no common base class of its errors
        raise ConfigError(str(folder / DATA), f"cannot be opened: {one_line(error)}") from error


def checked(group: zarr.Group, folder: Path, name: str, like: tuple[Any, ...]) -> zarr.Array:
    """One array, whose type, dimensions and chunks are as they were laid out.

    Args:
        group: The group.
        folder: The results folder, for messages.
        name: The array's name.
        like: Its data type, number of dimensions and chunks.

    Raises:
        ConfigError: it is absent or otherwise.
    """
    place = str(folder / DATA / name)
    try:
        with zarr.config.set({"array.write_empty_chunks": True}):  # chunks of NaN too, since presence has a meaning
            array = group[name]
    except Exception as error:
        raise ConfigError(place, f"is damaged: {one_line(error)}") from error
    if not isinstance(array, zarr.Array):
        raise ConfigError(place, "is damaged: it is no array")
    found = (str(array.dtype), array.ndim, tuple(array.chunks))
    if found != like:
        raise ConfigError(place, f"is damaged: its type, dimensions and chunks are {found}, not {like}")
    return array


def checked_arrays(folder: Path, study: Study, layout: Layout, mode: str = "r") -> dict[str, zarr.Array]:
    """Every variable's array.

    Raises:
        ConfigError: one is absent or not as it was laid out.
    """
    group = open_group(folder, mode)
    found = {}
    for name, variable in variables(study).items():
        chunks = layout.block[-1:] if variable.dims == ("draw",) else layout.block
        found[name] = checked(group, folder, name, (variable.dtype, len(chunks), chunks))
    return found


def laid_out(folder: Path, study: Study, layout: Layout) -> bool:
    """Whether an earlier run came as far as laying out the whole store.

    Raises:
        ConfigError: it did, and the store is damaged since.
    """
    try:
        checked_arrays(folder, study, layout)
    except ConfigError as error:
        if any((folder / DATA / "outcome" / "c").rglob("*")):
            raise ConfigError(error.where, f"{error.rule}; start over without --resume") from None
        return False
    return True


def reshape(folder: Path, study: Study, layout: Layout) -> None:
    """Give every array the study's number of draws, and the coordinates their values; nothing that exists is lost."""
    for name, array in checked_arrays(folder, study, layout, "r+").items():
        shape = layout.shape[-1:] if variables(study)[name].dims == ("draw",) else layout.shape
        if array.shape != shape:
            array.resize(shape)
    group = open_group(folder, mode="r+")
    for name, values in coordinate_values(study).items():
        if not np.array_equal(stored_coordinate(group, name), values):
            create(group, name, coordinates(study)[name], values.shape, values.shape, overwrite=True)[...] = values


def stored_coordinate(group: zarr.Group, name: str) -> np.ndarray:
    """A coordinate as it stands in the store; empty where it cannot be read, since it can be written again."""
    try:
        return np.asarray(group[name])
    except Exception:  # zarr and its codecs raise errors of many kinds
        return np.empty(0)


def one_line(error: BaseException) -> str:
    """An exception's message without its line breaks."""
    return " ".join(str(error).split()) or type(error).__name__
