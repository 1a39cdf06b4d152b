"""The Zarr arrays of a results folder: creation, extension, and checks that they belong to the study."""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from zarr.codecs import BytesCodec, ZstdCodec
from zarr.core.metadata import ArrayV3Metadata
from zarr.storage import MemoryStore

from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Layout
from dssc_jax.results.array_files import ArrayFiles
from dssc_jax.results.manifest import DATA
from dssc_jax.results.schema import (
    NOT_COMPUTED,
    Variable,
    coordinate_values,
    coordinates,
    dataset_attributes,
    variables,
)
from dssc_jax.study import Study

RESUME_HINT = "`resume` recomputes corrupted blocks"
EVERY_CHUNK = {"array.write_empty_chunks": True}
"""Zarr's setting to write chunks of NaN, too; so the presence of a chunk means that it was computed."""
Extent = tuple[tuple[int, ...], tuple[int, ...]]
"""Shape and chunks of an array."""


def create_arrays(folder: Path, study: Study, layout: Layout) -> dict[str, zarr.Array]:
    """Create all arrays of a results folder at once, and fill the coordinates.

    Args:
        folder: The results folder; existing arrays in the folder are deleted.
        study: The study as run.
        layout: Blocks of the run.

    Returns:
        The empty arrays of the variables by name.
    """
    array_files = ArrayFiles(folder / DATA)
    group = zarr.open_group(array_files, mode="w", zarr_format=3, attributes={**dataset_attributes(study)})
    values = coordinate_values(study)
    nodes: dict[str, Any] = {}
    for name, variable in coordinates(study).items():
        nodes[name] = expected_metadata(variable, coordinate_extent(values[name]))
    for name, variable in variables(study).items():
        nodes[name] = expected_metadata(variable, array_extent(variable, layout))
    with zarr.config.set(EVERY_CHUNK):
        metadata: dict[str, Any] = {name: ArrayV3Metadata.from_dict(node) for name, node in nodes.items()}
        arrays: dict[str, Any] = dict(zarr.create_hierarchy(store=group.store, nodes=metadata))
    for name, column in values.items():
        arrays[name][...] = column
    return {name: arrays[name] for name in variables(study)}


def array_extent(variable: Variable, layout: Layout) -> Extent:
    """Shape and chunks of a variable's array, which has a chunk for each block of lanes."""
    if variable.dims == ("draw",):
        return layout.shape[-1:], layout.block[-1:]
    return layout.shape, layout.block


def coordinate_extent(values: np.ndarray) -> Extent:
    """Shape and chunks of the array of a coordinate with these values, which has a single chunk."""
    return values.shape, values.shape


def create_array(
    group: zarr.Group, name: str, variable: Variable, extent: Extent, overwrite: bool = False
) -> zarr.Array:
    """Create the empty array of a variable, with a checksum in every chunk.

    Args:
        group: The group of the store.
        name: Name of the array.
        variable: Dimensions, type and attributes.
        extent: Shape and chunks.
        overwrite: Whether an existing array is replaced.
    """
    shape, chunks = extent
    return group.create_array(
        name,
        overwrite=overwrite,
        serializer=BytesCodec(endian="little"),
        compressors=ZstdCodec(level=0, checksum=True),
        shape=shape,
        chunks=chunks,
        dtype=variable.dtype,
        fill_value=np.nan if variable.dtype.startswith("float") else NOT_COMPUTED,
        dimension_names=variable.dims,
        attributes=dict(variable.attributes),
    )


def open_group(folder: Path, mode: str) -> zarr.Group:
    """Open the Zarr group of a results folder.

    Only version 3 of Zarr's format is accepted. Version 2 has a codec that unpickles data, which may run foreign code.

    Args:
        folder: The results folder.
        mode: ``r`` to read, ``r+`` to write.

    Raises:
        ConfigError: The group is absent or damaged.
    """
    try:
        array_files = ArrayFiles(folder / DATA, read_only=mode == "r")
        return zarr.open_group(array_files, mode=mode, zarr_format=3)  # type: ignore[arg-type]
    except Exception as error:  # zarr has no common base class of its errors
        raise ConfigError(str(folder / DATA), f"cannot be opened: {one_line(error)}") from error


@cache
def default_metadata(dtype: str) -> dict[str, Any]:
    """Metadata that the installed version of Zarr gives to an array of this type from :func:`create_array`."""
    group = zarr.open_group(MemoryStore(), mode="w", zarr_format=3)
    blank = create_array(group, "blank", Variable(("draw",), dtype, {}), extent=((1,), (1,)))
    return blank.metadata.to_dict()


def expected_metadata(variable: Variable, extent: Extent) -> dict[str, Any]:
    """All metadata that the array of a variable has when it is created."""
    shape, chunks = extent
    variable_metadata = {
        "shape": shape,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunks}},
        "attributes": dict(variable.attributes),
        "dimension_names": variable.dims,
    }
    return default_metadata(variable.dtype) | variable_metadata


def json_text(content: Mapping[str, object]) -> str:
    """Metadata as JSON with sorted keys, for comparison."""
    return json.dumps(content, sort_keys=True, default=str)


def checked_array(
    group: zarr.Group,
    place: Path,
    variable: Variable,
    extent: Extent,
    any_draw_count: bool = False,
) -> zarr.Array:
    """Open an array, and refuse it if its metadata have changed since it was created.

    Args:
        group: The group of the store.
        place: Path of the array, for its name and for messages.
        variable: The variable of the array.
        extent: Shape and chunks of the array.
        any_draw_count: Whether the array may have another number of draws than the extent.

    Raises:
        ConfigError: The array is absent, or its metadata have changed.
    """
    shape, chunks = extent
    try:
        with zarr.config.set(EVERY_CHUNK):
            array: Any = group[place.name]
        actual = json_text(array.metadata.to_dict())
        if any_draw_count:
            shape = (*shape[:-1], array.shape[-1])
    except Exception as error:  # zarr has no common base class of its errors
        raise ConfigError(str(place), f"is damaged: {one_line(error)}") from error
    if actual != json_text(expected_metadata(variable, (shape, chunks))):
        raise ConfigError(str(place), "is damaged: its metadata are not those that its study lays out")
    return array


def checked_arrays(
    folder: Path, study: Study, layout: Layout, mode: str = "r", any_draw_count: bool = False
) -> dict[str, zarr.Array]:
    """Open the arrays of all variables of a study, and refuse a folder with missing, changed or further arrays.

    Args:
        folder: The results folder.
        study: The study as run.
        layout: Blocks of the run.
        mode: ``r`` to read, ``r+`` to write.
        any_draw_count: Whether arrays may have another number of draws than the layout.

    Returns:
        The arrays by name.

    Raises:
        ConfigError: An array is absent or differs from its creation, or there is a further array.
    """
    group = open_group(folder, mode)
    blank_group = zarr.open_group(MemoryStore(), mode="w", zarr_format=3, attributes={**dataset_attributes(study)})
    if json_text(group.metadata.to_dict()) != json_text(blank_group.metadata.to_dict()):
        raise ConfigError(str(folder / DATA), "is damaged: its attributes are not those that its study lays out")
    arrays = {}
    for name, variable in variables(study).items():
        extent = array_extent(variable, layout)
        arrays[name] = checked_array(group, folder / DATA / name, variable, extent, any_draw_count)
    folder_names = {file.name for file in (folder / DATA).iterdir() if file.is_dir()}
    unexpected = folder_names - arrays.keys() - coordinates(study).keys()
    if unexpected:
        raise ConfigError(str(folder / DATA / min(unexpected)), "is damaged: it is no variable of the study")
    return arrays


def require_coordinates(folder: Path, study: Study) -> None:
    """Refuse a results folder whose coordinates are not those of the study; other programs read these coordinates.

    Raises:
        ConfigError: A coordinate differs from the study's.
    """
    group = open_group(folder, "r")
    for name, values in coordinate_values(study).items():
        if not holds_coordinate(group, folder / DATA / name, coordinates(study)[name], values):
            raise ConfigError(str(folder / DATA / name), f"is damaged: it is not the study's coordinate; {RESUME_HINT}")


def holds_coordinate(group: zarr.Group, place: Path, variable: Variable, values: np.ndarray) -> bool:
    """Whether a coordinate of a store can be read and has these values, shape (n,)."""
    try:
        array = checked_array(group, place, variable, coordinate_extent(values))
        return np.array_equal(np.asarray(array), values)
    except Exception:  # zarr and its codecs raise errors of many kinds
        return False


def has_all_arrays(folder: Path, study: Study, layout: Layout) -> bool:
    """Whether an earlier run, with any number of draws, has created all arrays.

    Raises:
        ConfigError: The store is damaged, although it already holds draws.
    """
    try:
        checked_arrays(folder, study, layout, any_draw_count=True)
    except ConfigError as error:
        chunks_of_outcome = folder / DATA / "outcome" / "c"
        holds_draws = any(chunks_of_outcome.rglob("*"))
        if holds_draws:
            raise ConfigError(error.where, f"{error.rule}; start over without `resume`") from None
        return False
    return True


def extend_arrays(folder: Path, study: Study, layout: Layout) -> None:
    """Extend all arrays to the study's number of draws, and set the coordinates; stored draws remain."""
    for name, array in checked_arrays(folder, study, layout, "r+", any_draw_count=True).items():
        shape, _ = array_extent(variables(study)[name], layout)
        if array.shape != shape:
            array.resize(shape)
    group = open_group(folder, mode="r+")
    for name, values in coordinate_values(study).items():
        variable = coordinates(study)[name]
        if not holds_coordinate(group, folder / DATA / name, variable, values):
            array = create_array(group, name, variable, coordinate_extent(values), overwrite=True)
            array[...] = values


def one_line(error: BaseException) -> str:
    """The message of an exception in one line, or its type if it has no message."""
    return " ".join(str(error).split()) or type(error).__name__
