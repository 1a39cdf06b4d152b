"""``run``: simulate every draw at every point of a sweep, in memory or into a folder, locally or on a cluster."""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import Block, Engine, Layout, computing, execute, lanes_in
from dssc_jax.engine.integration import integration_error
from dssc_jax.engine.sampling import Arrays
from dssc_jax.results.manifest import SCHEMA, Manifest, code_entries, require_startable
from dssc_jax.results.result import Result
from dssc_jax.results.schema import copy_block, empty_dataset
from dssc_jax.results.stated_errors import STATED, StatedAmounts
from dssc_jax.results.store import Store
from dssc_jax.runs.design_choice import choose_design
from dssc_jax.study import Study, takes_file
from dssc_jax.study.correlation import normal_correlation

if TYPE_CHECKING:
    from dssc_jax.runs.cluster import Cluster


def run_manifest(study: Study, layout: Layout, machinery: Manifest) -> Manifest:
    """The manifest of a run at its start: what is computed, by which code and on which machine.

    Args:
        study: The study.
        layout: The grid and its blocks.
        machinery: Versions, device and compiler settings.
    """
    return {
        "schema": SCHEMA,
        "study": study.table,
        "source": study.source,
        "hash": study.hash,
        "seed": study.config.seed,
        "sampling": sampling_entry(study),
        "precision": study.config.loop.precision,
        "layout": layout.to_dict(),
        "counts": {
            "points": int(np.prod([len(values) for values in study.axes.values()], dtype=int)),
            "draws": study.config.draws,
            "samples": study.loop.steps,
        },
        **machinery,
        **code_entries(study),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "complete": False,
        "times": {},
    }


def sampling_entry(study: Study) -> dict[str, object]:
    """The manifest's entry about the design of the draws and the correlations of the numbers.

    The entry has each correlation twice: for the ranks of the two numbers, as in the study, and for their normal
    variables.
    """
    config = study.config
    correlations = {}
    for pair, rank in config.correlation.items():
        correlations[pair] = {"rank": rank, "normal": normal_correlation(rank)}
    return {
        "kind": config.sampling,
        "replicates": None if config.independent else config.replicates,
        "correlation": correlations,
    }


@takes_file
def run(
    study: Study,
    out: str | Path | None = None,
    *,
    resume: bool = False,
    progress: ProgressCallback | None = None,
    block: int | None = None,
    tile: int | None = None,
    devices: int | None = None,
    cluster: str | None = None,
    notify: Callable[[str], None] = print,
    local: str | None = None,
    check: bool = True,
    within: Mapping[str, float] | None = None,
    shift: float | None = None,
    widening: float | None = None,
) -> Result:
    """Simulate every draw of a study at every point of its sweep.

    With ``sampling = "auto"`` the result's study has the design that the tool chose, see
    :mod:`dssc_jax.runs.design_choice`.

    Args:
        study: The study, or its file; one with a ``[sweep]`` is swept, see :meth:`Study.without_sweep`.
        out: Results folder to fill during the run; None: the result stays in memory.
        resume: Whether to keep the results of an earlier run of the same study in ``out``, and to compute only the
            missing ones; the study may have more draws than that run.
        progress: Called with the lanes done and all lanes after each block.
        block: Maximum number of lanes of a block; None: the engine chooses. Results depend neither on this argument nor
            on ``tile``, ``devices``, ``cluster``, ``notify`` and ``local``.
        tile: Number of lanes of a tile; None: the engine chooses.
        devices: Number of devices to use; None: all devices.
        cluster: ``tcp://host:port`` of a dask scheduler or ``local:N``; every worker must see ``out``. Devices and
            tiles are then the workers' own choice.
        notify: Called with a line of text when a worker of the cluster is lost or joins.
        local: Folder in which a cluster's workers also look for the study's ``module:object`` names.
        check: Whether to simulate some draws again with twice the substeps; see
            :func:`dssc_jax.engine.integration.integration_error`.
        within: Divergences by which the laws may be wrong, by name: ``total_variation``, ``kl`` or ``chi_square``, each
            >= 0. The result then also has the interval of the failure probability for each of them.
        shift: Shift by which all means may be wrong, >= 0 [standard deviations], for such an interval.
        widening: Factor by which all laws may be wider, >= 1, for such an interval.

    Raises:
        ConfigError: ``out`` contains something else, is being written, cannot be written, or is missing where
            ``resume`` or ``cluster`` needs it; the cluster is lost; an amount is out of range, or the study does not
            admit it.
    """
    entries: Manifest = {}
    if study.config.sampling == "auto":
        choice = choose_design(study, None if out is None else Path(out), resume)
        study = choice.study
        entries = choice.entry
    amounts_entry = stated_entry(study, within, shift, widening)
    layout = Layout.of(study, block) if block else Layout.of(study)
    if out is None:
        if cluster:
            raise ConfigError("out", "is needed on a cluster: a folder that every worker can access")
        if resume:
            raise ConfigError("out", "is needed to resume")
        engine = Engine(study, layout.lanes, tile, devices)
        return run_in_memory(study, layout, engine, progress, entries | integration_entry(study, check) | amounts_entry)
    require_startable(Path(out), study, resume)
    this_process = ThisProcess(study, tile, devices)
    if not resume and not cluster:  # every block is missing, so the first can start before the folder is made
        this_process.start(layout, layout.blocks())
    with ExitStack() as stack:
        workers: ThisProcess | Cluster = this_process
        if cluster:
            from dssc_jax.runs.cluster import connected  # needs an optional package

            workers = stack.enter_context(connected(cluster, notify, local))
        manifest = run_manifest(study, layout, workers.machinery()) | entries
        target = stack.enter_context(Store(Path(out), study, manifest, resume))
        if not target.finished:
            advance = LanesDone(progress, target.layout, target.pending)
            times = workers.fill(target, advance)
            target.complete(times | integration_entry(study, check) | amounts_entry)
        elif amounts_entry and amounts_entry[STATED] != target.manifest.get(STATED):
            target.complete(amounts_entry)
        result = Result.of(study, *target.read(), Path(out))
        target.summarise(result.lines())
    return result


@dataclass
class ThisProcess:
    """This process as the only worker of a run, with the same methods as :class:`dssc_jax.runs.cluster.Cluster`.

    Args:
        study: The study.
        tile: Number of lanes of a tile; None: the engine chooses.
        devices: Number of devices to use; None: all devices.
    """

    study: Study
    tile: int | None
    devices: int | None

    def __post_init__(self) -> None:
        """Record the time at which the run began; nothing is computed yet."""
        self.began = time.perf_counter()
        self.block_results: Iterator[tuple[Block, Arrays, Arrays]] | None = None

    def machinery(self) -> Manifest:
        """Versions, device and compiler settings of this process, see :func:`dssc_jax.engine.batching.computing`."""
        return computing()

    def start(self, layout: Layout, blocks: list[Block]) -> Iterator[tuple[Block, Arrays, Arrays]]:
        """Start computing blocks in turn, and return the iterator of :func:`dssc_jax.engine.batching.execute`."""
        self.engine = Engine(self.study, layout.lanes, self.tile, self.devices)
        self.block_results = execute(self.engine, blocks)
        return self.block_results

    def fill(self, target: Store, advance: Callable[[int], None]) -> Manifest:
        """Compute the missing blocks of a results folder.

        Args:
            target: The folder, locked by this process.
            advance: Called with the number of lanes of each finished block.

        Returns:
            The entry ``times`` for the manifest.
        """
        # started already if every block was missing
        block_results = self.block_results or self.start(target.layout, target.pending)
        for block, results, values in block_results:
            target.write(block, results, values)
            advance(lanes_in(block))
        return {"times": self.engine.times(self.began)}


class LanesDone:
    """Counter of finished lanes that reports to a progress callback.

    Args:
        progress: Called with the lanes done and all lanes; None: no callback.
        layout: The grid of all lanes.
        pending: Blocks that are not finished at the beginning.
    """

    def __init__(self, progress: ProgressCallback | None, layout: Layout, pending: list[Block]) -> None:
        """Count the lanes that are finished already, and report them."""
        self.progress = progress
        self.total = math.prod(layout.shape)
        self.finished_lanes = self.total - sum(map(lanes_in, pending))
        self(0)  # reports without adding a lane

    def __call__(self, lanes: int) -> None:
        """Add a number of finished lanes."""
        self.finished_lanes += lanes
        if self.progress:
            self.progress(self.finished_lanes, self.total)


def integration_entry(study: Study, check: bool) -> Manifest:
    """The manifest's entry with the measured error of integration; empty if ``check`` is False."""
    return {"integration": integration_error(study).to_dict()} if check else {}


def stated_entry(
    study: Study, within: Mapping[str, float] | None, shift: float | None, widening: float | None
) -> Manifest:
    """The manifest's entry with the amounts by which the laws may be wrong; empty if no amount is given.

    Args:
        study: The study.
        within: As for :func:`run`.
        shift: As for :func:`run`.
        widening: As for :func:`run`.

    Raises:
        ConfigError: An amount is out of range, or the study does not admit it.
    """
    amounts = StatedAmounts(within or {}, shift, widening)
    if not amounts:
        return {}
    amounts.require(study)
    return {STATED: amounts.entry}


def run_in_memory(
    study: Study, layout: Layout, engine: Engine, progress: ProgressCallback | None, entries: Manifest
) -> Result:
    """Simulate all lanes of a study, and return the result without writing a file.

    Args:
        study: The study.
        layout: The grid and its blocks.
        engine: The compiled study.
        progress: Called with the lanes done and all lanes; None: no callback.
        entries: Further entries of the manifest.
    """
    began = time.perf_counter()
    blocks = layout.blocks()
    block_results = execute(engine, blocks)
    manifest = run_manifest(study, layout, computing())
    dataset = empty_dataset(study)
    advance = LanesDone(progress, layout, blocks)
    for box, results, values in block_results:
        copy_block(dataset, box, results, values)
        advance(lanes_in(box))
    manifest |= {"complete": True, "times": engine.times(began), **entries}
    return Result.of(study, dataset, manifest)
