"""Reading of results folders of the first schema, which had no digests and called slacks margins."""

from pathlib import Path

import numpy as np
import xarray as xr
import zarr

from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Layout
from dssc_jax.results.arrays import array_extent, one_line, open_group
from dssc_jax.results.manifest import DATA
from dssc_jax.results.schema import NOT_COMPUTED, in_memory, variables
from dssc_jax.study import Study


def read_first_schema(folder: Path, study: Study, layout: Layout) -> xr.Dataset:
    """The dataset of a folder of the first schema. Checks only types, shapes, chunks and checksums of its arrays.

    Raises:
        ConfigError: an array is damaged, or the run did not finish.
    """
    group, dataset = open_group(folder, "r"), in_memory(study)
    for name, variable in variables(study).items():
        stored = f"margin_{name.removeprefix('slack_')}" if name.startswith("slack_") else name
        place, (shape, chunks) = folder / DATA / stored, array_extent(variable, layout)
        try:
            array = group[stored]
            if not isinstance(array, zarr.Array):
                raise TypeError("it is no array")
            described = (str(array.dtype), array.shape, tuple(array.chunks))
            dataset[name].values[...] = array[...]
        except Exception as error:  # zarr and its codecs raise errors of many kinds
            raise ConfigError(str(place), f"is damaged: {one_line(error)}") from error
        if described != (variable.dtype, shape, chunks):
            raise ConfigError(str(place), "is damaged: its type, shape and chunks are not those of its study")
        missing = array.nchunks - array.nchunks_initialized
        if missing and name != "outcome":
            raise ConfigError(str(place), f"is damaged: {missing} of {array.nchunks} chunks missing")
    absent = int(np.count_nonzero(dataset["outcome"].values == NOT_COMPUTED))
    if absent:
        rule = f"is not complete: {absent} of {dataset['outcome'].size} lanes are missing; run its study again"
        raise ConfigError(str(folder), rule)
    return dataset
