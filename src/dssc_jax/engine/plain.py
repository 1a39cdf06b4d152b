"""Batches of lanes by plain XLA: ``vmap`` over the lanes of a tile, tiles in sequence, and tiles over devices.

This is the reference program, and the form for programs without machine code.
"""

import time
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, PartitionSpec

from dssc_jax.lanes.interface import AXIS

LANES = 512  # most lanes of a tile on a CPU, so that calling the kernels of a sample costs little
TILE_STEP = 16  # divides every tile: for tiles of 8, a 512-bit vector, the compiler may contract other products


def plain_options() -> dict[str, str | bool]:
    """Options of ``jax.jit`` for simulations: on a CPU, without fusion.

    XLA's fusion turns a sample into a few large kernels, each of which computes shared values again. Without fusion,
    the vehicle compiles in an eighth of the time and runs up to five times faster.
    """
    return {"xla_disable_hlo_passes": "fusion"} if jax.default_backend() == "cpu" else {}


class PlainBatch:
    """The program of a lane by plain XLA, for batches of at most ``lanes`` lanes.

    Args:
        lane: (numbers by name, draw index) -> results.
        names: Names of the numbers.
        lanes: Most lanes of a batch; smaller ones are padded.
        tile: Lanes of a tile; None: a share of the batch, on a CPU at most :data:`LANES`.
        devices: Devices to use; None: all.
    """

    def __init__(
        self, lane: Callable[..., Any], names: Sequence[str], lanes: int, tile: int | None, devices: int | None
    ) -> None:
        usable = jax.devices()[:devices]
        share = -(-lanes // len(usable))
        most = min(share, LANES) if usable[0].platform == "cpu" else share
        self._tile = -(-min(tile or most, share) // TILE_STEP) * TILE_STEP
        tiles = -(-lanes // self._tile)
        self._tiles = -(-tiles // len(usable)) * len(usable)
        self._real = np.dtype(jnp.result_type(float))
        batch = jax.vmap(lane, axis_name=AXIS)
        mesh = Mesh(np.array(usable), ("device",))

        def part(values: dict[str, jax.Array], index: jax.Array) -> Any:
            return jax.lax.map(lambda tile: batch(*tile), (values, index))

        spec = PartitionSpec("device")
        shape = (self._tiles, self._tile)
        sharded = jax.shard_map(part, mesh=mesh, in_specs=spec, out_specs=spec, check_vma=False)
        number = jax.ShapeDtypeStruct(shape, self._real)
        lowered = jax.jit(sharded).lower(dict.fromkeys(names, number), jax.ShapeDtypeStruct(shape, jnp.uint32))
        self._run = lowered.compile(compiler_options=plain_options())

    def start(self, values: dict[str, np.ndarray], index: np.ndarray) -> Callable[[], tuple[Any, float]]:
        """Start a batch; see :data:`dssc_jax.engine.kernels.Start`."""
        count = len(index)
        shape = (self._tiles, self._tile)

        def as_tiles(column: np.ndarray, dtype: Any) -> np.ndarray:
            return np.pad(column, (0, self._tiles * self._tile - count), mode="edge").astype(dtype).reshape(shape)

        columns = {name: as_tiles(column, self._real) for name, column in values.items()}
        tiled_results = self._run(columns, as_tiles(index, np.uint32))

        def flat() -> tuple[Any, float]:
            results = jax.tree.map(lambda array: np.asarray(array).reshape(-1, *array.shape[2:])[:count], tiled_results)
            return results, time.perf_counter()  # an upper bound: XLA does not report the end

        return flat
