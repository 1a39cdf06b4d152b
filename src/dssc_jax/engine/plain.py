"""Batches of lanes by plain XLA: ``vmap`` over the lanes of a tile, tiles in sequence, and tiles over devices.

The plain program is the reference, and the form for programs without machine code.
"""

import math
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


def next_multiple(count: int, step: int) -> int:
    """The smallest multiple of a step that is not below a count."""
    return math.ceil(count / step) * step


class PlainBatch:
    """The program of a lane by plain XLA, for batches of at most ``lanes`` lanes.

    Args:
        lane: ``(numbers by name, draw index) -> results``.
        names: Names of the numbers.
        lanes: Most lanes of a batch; a smaller batch is padded.
        tile: Lanes of a tile; None: a share of the batch, on a CPU at most :data:`LANES`.
        devices: Devices to use; None: all.
    """

    def __init__(
        self, lane: Callable[..., Any], names: Sequence[str], lanes: int, tile: int | None, devices: int | None
    ) -> None:
        """Divide the batch into tiles, the same number for each device, and compile the program.

        The arguments are those of the class.
        """
        usable = jax.devices()[:devices]
        share = math.ceil(lanes / len(usable))  # lanes of a device
        most = min(share, LANES) if usable[0].platform == "cpu" else share
        self._tile = next_multiple(min(tile or most, share), TILE_STEP)
        tiles = math.ceil(lanes / self._tile)
        self._tiles = next_multiple(tiles, len(usable))
        self._real = np.dtype(jnp.result_type(float))
        batch = jax.vmap(lane, axis_name=AXIS)
        mesh = Mesh(np.array(usable), ("device",))

        def run_tiles(values: dict[str, jax.Array], index: jax.Array) -> Any:
            """The results of the tiles of one device, one tile after the other."""
            return jax.lax.map(lambda tile: batch(*tile), (values, index))

        over_devices = PartitionSpec("device")
        shape = (self._tiles, self._tile)
        sharded = jax.shard_map(run_tiles, mesh=mesh, in_specs=over_devices, out_specs=over_devices, check_vma=False)
        number = jax.ShapeDtypeStruct(shape, self._real)
        lowered = jax.jit(sharded).lower(dict.fromkeys(names, number), jax.ShapeDtypeStruct(shape, jnp.uint32))
        self._run = lowered.compile(compiler_options=plain_options())

    def start(self, values: dict[str, np.ndarray], index: np.ndarray) -> Callable[[], tuple[Any, float]]:
        """Start a batch; see :data:`dssc_jax.engine.kernels.Start`."""
        count = len(index)
        shape = (self._tiles, self._tile)

        def as_tiles(column: np.ndarray, dtype: Any) -> np.ndarray:
            """One number of all lanes, arranged in tiles, shape (tiles, lanes of a tile).

            Copies of the last lane fill the last tiles.
            """
            padding = self._tiles * self._tile - count
            return np.pad(column, (0, padding), mode="edge").astype(dtype).reshape(shape)

        def as_lanes(array: jax.Array) -> np.ndarray:
            """The results of the batch's lanes; lanes that only fill the last tiles are left out."""
            return np.asarray(array).reshape(-1, *array.shape[2:])[:count]

        columns = {name: as_tiles(column, self._real) for name, column in values.items()}
        tiled_results = self._run(columns, as_tiles(index, np.uint32))

        def finish() -> tuple[Any, float]:
            """Wait for the batch, and return its results and the time at which it ended.

            The time is an upper bound, because XLA does not report when it ends.
            """
            return jax.tree.map(as_lanes, tiled_results), time.perf_counter()

        return finish
