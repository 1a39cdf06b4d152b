"""Batches of lanes, and the blocks of a run. No other module adds batch axes.

A lane is one draw at one sweep point. A block is the unit of work and of storage: a box of the grid
(sweep axes..., draw), computed as one batch of lanes in one of the forms of :mod:`dssc_jax.engine.kernels`. Lanes are
independent, so results depend neither on the size of a block nor on the cores that share it.
"""

import itertools
import math
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from typing import Any

import jax
import numpy as np

from dssc_jax.closed_loop.draw import Run, simulate_draw
from dssc_jax.closed_loop.metrics.margin_measures import margins_of
from dssc_jax.core.json_types import JsonObject
from dssc_jax.core.native.fmu_instances import require_no_faults
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.signals import Scalar
from dssc_jax.engine import kernels
from dssc_jax.engine.clock import Clock, CountedLane
from dssc_jax.engine.linearisation.margin_values import MarginValues, margin_values
from dssc_jax.engine.sampling import Arrays, draw, draw_key
from dssc_jax.lanes.interface import AXIS
from dssc_jax.study import Study

BLOCK = 16384  # most lanes of a block
PROBES = 16  # draws that are simulated with two indices each to find in-loop noise
VERSIONS = ("dssc_jax", "jax", "jaxlib", "llvmlite", "numpy", "scipy", "xarray", "zarr")

Block = tuple[slice, ...]
"""A box of the grid: a range of indices along every swept parameter, then a range of draws."""

Lanes = tuple[np.ndarray, ...]
"""Places of n lanes in the grid: indices along every swept parameter, then draw indices, shape (n,) each."""

Lane = Callable[[dict[str, jax.Array], jax.Array], dict[str, Scalar]]
"""The program of a lane: ``(numbers of the lane by name, draw index) -> results by name``."""

BlockRun = tuple[Block, Callable[[], Arrays], Arrays]
"""A block that is being computed, the function that waits for its results, and the drawn values of its draws."""


def lane_of_study(study: Study, axis_name: str | None = AXIS, segment: int | None = None) -> Lane:
    """Return the program of a lane: the function that simulates its draw.

    Args:
        study: The study.
        axis_name: Name of the mapped axis of the lanes that share a time loop; None if derivatives are taken. See
            :func:`dssc_jax.closed_loop.draw.simulate_draw`.
        segment: Samples between checkpoints of reverse mode; see
            :func:`dssc_jax.closed_loop.time_loops.scan_segments`.
    """

    def lane(values: dict[str, jax.Array], index: jax.Array) -> dict[str, Scalar]:
        """The results of the lane's draw by name."""
        key = draw_key(study.config.seed, index)
        loop = study.loop
        params = study.params(values)
        margins = margins_in(study, values)
        criteria = study.measures, study.requirements
        run = simulate_draw(loop, params, key, *criteria, axis_name=axis_name, segment=segment, margins=margins)
        return results_of(study, run)

    return lane


def margins_in(study: Study, values: Mapping[str, Scalar]) -> dict[str, Scalar]:
    """The required margins of the linearised loop, by name, among all numbers of a lane.

    Margins are computed before the flight, so a lane receives them as inputs, like its other numbers.
    """
    return {name: values[name] for name in margins_of(study.measures)}


def lane_names(study: Study) -> list[str]:
    """Names of the numbers of a lane: swept and uncertain numbers, and margins of the linearised loop."""
    return [*study.axes, *study.laws, *margins_of(study.measures)]


def results_of(study: Study, run: Run) -> dict[str, Scalar]:
    """Metrics, slacks, times of violation and outcome of a lane, by their names in a dataset."""
    results = {**run.metrics, **run.slacks, **run.violated_at, "outcome": run.outcome, "failed_at": run.failed_at}
    if study.loop.settled:
        results["settled_at"] = run.settled_at
    return results


@dataclass(frozen=True)
class Layout:
    """The grid of all lanes, and its division into blocks.

    Args:
        shape: Number of points of each swept parameter, then number of draws.
        block: Shape of a block; the last blocks along each dimension may be smaller.
    """

    shape: tuple[int, ...]
    block: tuple[int, ...]

    @classmethod
    def of(cls, study: Study, lanes: int = BLOCK) -> "Layout":
        """The grid of a study in blocks of at most ``lanes`` lanes.

        A block takes all draws first, then as many points of the last swept parameter as fit, then of the one before
        it, and so on. If the whole grid fits, the block is longer than the draws, so that a run may get more draws
        later.
        """
        shape = (*(len(values) for values in study.axes.values()), study.config.draws)
        reversed_block = []  # lengths along the draws, the last swept parameter, ..., the first
        room = lanes  # how often the block so far fits into the lanes
        for size in reversed(shape):
            length = max(1, min(size, room))
            reversed_block.append(length)
            room = room // size if length == size else 0
        reversed_block[0] *= max(1, room)
        return cls(shape, tuple(reversed(reversed_block)))

    @classmethod
    def from_dict(cls, entries: Mapping[str, Any]) -> "Layout":
        """The layout from the result of :meth:`to_dict`."""
        return cls(tuple(entries["shape"]), tuple(entries["block"]))

    def to_dict(self) -> dict[str, list[int]]:
        """The layout as plain data for JSON."""
        return {"shape": list(self.shape), "block": list(self.block)}

    @property
    def lanes(self) -> int:
        """Number of lanes of the largest block."""
        return math.prod(map(min, self.shape, self.block))

    def index(self, block: Block) -> tuple[int, ...]:
        """The number of a block along each dimension of the grid; a part of a block has the number of its block."""
        return tuple(part.start // size for part, size in zip(block, self.block, strict=True))

    def blocks(self) -> list[Block]:
        """Every block of the grid in C order: the draws advance first."""
        ranges_by_dimension = []
        for size, length in zip(self.shape, self.block, strict=True):
            starts = range(0, size, length)
            ranges_by_dimension.append([slice(start, min(start + length, size)) for start in starts])
        return list(itertools.product(*ranges_by_dimension))


@dataclass
class Engine:
    """A study compiled once for batches of a fixed size; a call of the engine simulates a batch.

    Args:
        study: The study.
        lanes: Lanes of a batch; a smaller batch is padded.
        tile: Lanes of a tile, for the forms of XLA; None: chosen from the size of the batch.
        devices: Cores of a CPU, or GPUs, that share a batch; None: all.
        clock: Times and counts of the engine.
        program: Makes the program of a lane from the study.
        kernel: The form, see :func:`dssc_jax.engine.kernels.requested_form`.
        extra: Names of further numbers of each lane that the program needs.
    """

    study: Study
    lanes: int
    tile: int | None = None
    devices: int | None = None
    clock: Clock = field(default_factory=Clock)
    program: Callable[[Study], Lane] = lane_of_study
    kernel: str = ""
    extra: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Choose the form; programs are compiled when they are first needed."""
        self.kernel = kernels.requested_form(self.kernel)
        self._start: kernels.Start | None = None
        self._margins: MarginValues | None = None
        self._last_end = 0.0  # time of perf_counter at which the last batch ended [s]

    @property
    def names(self) -> list[str]:
        """Names of the numbers that differ between lanes: swept, uncertain, and further ones."""
        return [*self.study.axes, *self.study.laws, *self.extra]

    def __call__(self, values: Mapping[str, np.ndarray], indices: np.ndarray) -> Callable[[], Arrays]:
        """Start a batch, and return a function that waits for its results.

        Args:
            values: For each of ``names`` an array of shape (n,), n <= lanes; also for each required margin of the
                linearised loop, unless the engine is to compute them all.
            indices: Draw index of each lane, shape (n,).
        """
        count = len(indices)
        columns = {name: np.asarray(values[name]) for name in self.names}
        margins = margins_of(self.study.measures)
        if margins.keys() <= values.keys():
            columns |= {name: values[name] for name in margins}
        else:
            start_time = time.perf_counter()
            columns |= self.margins(columns, np.asarray(indices))
            self.clock.margin_seconds += time.perf_counter() - start_time
        with arithmetic(self.study.config.loop.precision):
            start = self.compiled()
            start_time = time.perf_counter()
            results = start(columns, np.asarray(indices))

        def finish() -> Arrays:
            """Wait for the batch, and return its results; the time in which two batches overlap counts once."""
            arrays, end_time = results()
            require_no_faults()
            end_time = max(end_time, self._last_end)
            self.clock.run_seconds += end_time - max(start_time, self._last_end)
            self._last_end = end_time
            self.clock.lanes += count
            return arrays

        return finish

    def compiled(self) -> kernels.Start:
        """The function that starts a batch, compiled on first use."""
        if self._start is None:
            start_time = time.perf_counter()
            lane = CountedLane(self.program(self.study), self.clock)
            names = [*self.names, *margins_of(self.study.measures)]
            with arithmetic(self.study.config.loop.precision):
                self._start = kernels.compile_batches(self.kernel, lane, names, self.lanes, self.tile, self.devices)
            self.clock.compile_seconds += time.perf_counter() - start_time
        return self._start

    @property
    def margins(self) -> MarginValues:
        """The function that computes the required margins of the linearised loop, before the flight."""
        if self._margins is None:
            self._margins = margin_values(self.study)
        return self._margins

    @property
    def rate(self) -> float:
        """Lanes times samples per second, without compilation [1/s]; 0 before the first batch."""
        if not self.clock.run_seconds:
            return 0.0
        return self.clock.lanes * self.study.loop.steps / self.clock.run_seconds

    def times(self, start_time: float) -> dict[str, float]:
        """Times and counts of a run for its manifest; the run began at ``start_time`` of ``time.perf_counter`` [s]."""
        return {
            "seconds": time.perf_counter() - start_time,
            "compile_seconds": self.clock.compile_seconds,
            "margin_seconds": self.clock.margin_seconds,
            "run_seconds": self.clock.run_seconds,
            "rate": self.rate,
            "traces": self.clock.traces,
        }


def medians(study: Study) -> dict[str, float]:
    """The median of each uncertain number."""
    return {name: law.median for name, law in study.laws.items()}


def values_of_draws(study: Study, draws: slice) -> Arrays:
    """Values of the uncertain numbers in a range of draws, by name, shape (draws,) each."""
    return draw(study, np.arange(draws.start, draws.stop))


def lanes_of(study: Study, block: Block, values: Arrays) -> tuple[Arrays, np.ndarray]:
    """Numbers and draw indices of every lane of a block, shape (lanes,) each, in C order of the block.

    Args:
        study: The study.
        block: The block.
        values: Values of the laws for the block's draws, shape (draws,) each.
    """
    *points, draws = block
    draw_indices = np.arange(draws.start, draws.stop)
    swept_values = [np.asarray(axis[part]) for axis, part in zip(study.axes.values(), points, strict=True)]
    *swept_grids, index_grid = np.meshgrid(*swept_values, draw_indices, indexing="ij")
    numbers = {name: grid.reshape(-1) for name, grid in zip(study.axes, swept_grids, strict=True)}
    for name, column in values.items():
        numbers[name] = np.broadcast_to(column, shape_of(block)).reshape(-1)
    return numbers, index_grid.reshape(-1)


def lane_numbers(study: Study, lanes: Lanes) -> Arrays:
    """Swept and drawn numbers of n lanes by name, shape (n,) each."""
    *points, draws = lanes
    numbers = draw(study, draws)
    for (name, axis), index in zip(study.axes.items(), points, strict=True):
        numbers[name] = np.asarray(axis)[index]
    return numbers


def shape_of(block: Block) -> tuple[int, ...]:
    """The number of points of a block along each swept parameter, then its number of draws."""
    return tuple(part.stop - part.start for part in block)


def lanes_in(block: Block) -> int:
    """Number of lanes of a block."""
    return math.prod(shape_of(block))


def computing() -> JsonObject:
    """What affects the last digits of a result beside the study: versions, device and compiler settings, for JSON."""
    device = jax.devices()[0]
    return {
        "versions": {"python": platform.python_version(), **{name: version(name) for name in VERSIONS}},
        "device": {"kind": device.device_kind, "platform": device.platform, "count": len(jax.devices())},
        "compiler": kernels.compiler_settings(),
    }


def execute(engine: Engine, blocks: Sequence[Block]) -> Iterator[tuple[Block, Arrays, Arrays]]:
    """Compute blocks in turn, each in the background while the caller handles the previous block.

    The first block starts when this function is called, and not when the iterator is first read.

    Returns:
        An iterator over triples: block, results by name in the block's shape, and values of the laws for the block's
        draws.
    """
    engine.compiled()  # a program that cannot be compiled fails here, before anything is drawn

    def start_block(block: Block) -> BlockRun:
        """Draw the numbers of a block, and start its lanes."""
        *_, draws = block
        values = values_of_draws(engine.study, draws)
        return block, engine(*lanes_of(engine.study, block, values)), values

    def collect_all(first: BlockRun) -> Iterator[tuple[Block, Arrays, Arrays]]:
        """Yield the blocks in turn; the next block starts before the caller gets the present one."""
        current_run = first
        for block in blocks[1:]:
            next_run = start_block(block)
            yield collect(*current_run)
            current_run = next_run
        yield collect(*current_run)

    if not blocks:
        return iter(())
    return collect_all(start_block(blocks[0]))


def evaluate(engine: Engine, values: Arrays, indices: np.ndarray) -> Arrays:
    """Results of any number of lanes, in batches of the engine's size.

    Args:
        engine: The compiled study.
        values: For each of the engine's names an array of shape (n,).
        indices: Draw index of each lane, which selects its in-loop noise, shape (n,).

    Returns:
        Each metric, slack, ``outcome`` and ``failed_at``, shape (n,).
    """
    started = []
    for start in range(0, len(indices), engine.lanes):
        part = slice(start, start + engine.lanes)
        columns = {name: column[part] for name, column in values.items()}
        started.append(engine(columns, indices[part]))
    return join_batches([finish() for finish in started])


def join_batches(batches: Sequence[Arrays]) -> Arrays:
    """Join the arrays of several batches by name, in the order of the batches."""
    return {name: np.concatenate([batch[name] for batch in batches]) for name in batches[0]}


def is_noisy(engine: Engine) -> bool:
    """Whether the loop has in-loop noise, such as the noise of sensors.

    The draw index alone selects the noise. So the loop is noisy if draws with equal numbers and different indices have
    different results.
    """
    values = draw(engine.study, np.arange(PROBES) % engine.study.config.draws)
    results = evaluate(engine, values, np.arange(PROBES))
    results_of_other_draws = evaluate(engine, values, np.arange(PROBES, 2 * PROBES))
    return any(not np.array_equal(results[name], results_of_other_draws[name], equal_nan=True) for name in results)


def collect(block: Block, finish: Callable[[], Arrays], values: Arrays) -> tuple[Block, Arrays, Arrays]:
    """Wait for the lanes of a :data:`BlockRun`, and give their results the shape of the block."""
    shape = shape_of(block)
    return block, {name: array.reshape(shape) for name, array in finish().items()}, values
