"""A study run: every draw at every point of its sweep, in memory or into a folder, here or on a cluster."""

import math
import time
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import ProgressCallback
from dssc_jax.engine.batching import Engine, Layout, computing, execute, lanes_in
from dssc_jax.results.manifest import SCHEMA, about_code
from dssc_jax.results.result import Result
from dssc_jax.results.schema import in_memory, put
from dssc_jax.results.store import Store
from dssc_jax.runs.cluster import connected
from dssc_jax.study import Study
from dssc_jax.study.correlation import gaussian


def about_run(study: Study, layout: Layout, machinery: Mapping[str, Any]) -> dict[str, Any]:
    """The manifest before the run: what, with which versions, on which machine."""
    return {
        "schema": SCHEMA,
        "study": study.table,
        "source": study.source,
        "hash": study.hash,
        "seed": study.config.seed,
        "sampling": about_sampling(study),
        "precision": study.config.loop.precision,
        "layout": layout.to_dict(),
        "counts": {
            "points": int(np.prod([len(values) for values in study.axes.values()], dtype=int)),
            "draws": study.config.draws,
            "samples": study.loop.steps,
        },
        **machinery,
        **about_code(study),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
        "complete": False,
        "times": {},
    }


def about_sampling(study: Study) -> dict[str, Any]:
    """The design of the draws, and the correlations among them: ranks as given, and those of the normal variables."""
    config = study.config
    return {
        "kind": config.sampling,
        "replicates": config.replicates if config.sampling != "random" else None,
        "correlation": {pair: {"rank": rank, "normal": gaussian(rank)} for pair, rank in config.correlation.items()},
    }


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
) -> Result:
    """Simulate every draw of a study at every point of its sweep.

    Args:
        study: The study; one with a ``[sweep]`` is swept, see :meth:`Study.without_sweep`.
        out: Results folder to fill as the run goes on; None keeps the result in memory.
        resume: Keep what an earlier run of the same study left in ``out``, and compute what is missing; the study
            may ask for more draws than it did then.
        progress: Called with the lanes done and all lanes after each block.
        block: Lanes of a block at most; None: the engine's choice. Results do not depend on it, nor on the rest.
        tile: Lanes of a tile.
        devices: Number of devices to use.
        cluster: ``tcp://host:port`` of a dask scheduler or ``local:N``; every worker must see ``out``. Devices and
            tiles are then the workers' own choice.
        notify: Called with a line of text when a worker of the cluster is lost or joins.
        local: Folder where a cluster's workers, too, look for the study's ``module:object`` names.

    Raises:
        ConfigError: ``out`` holds something else, is being written, or cannot be written; or the cluster is lost.
    """
    layout = Layout.of(study, block) if block else Layout.of(study)
    if out is None:
        if cluster:
            raise ConfigError("out", "is needed on a cluster: a folder that every worker sees")
        manifest = about_run(study, layout, computing())
        return in_one_piece(study, manifest, Engine(study, layout.lanes, tile, devices), progress)
    with ExitStack() as stack:
        workers = stack.enter_context(connected(cluster, notify)) if cluster else None
        manifest = about_run(study, layout, workers.machinery() if workers else computing())
        target = stack.enter_context(Store(Path(out), study, manifest, resume))
        if not target.finished:
            advance = LanesDone(progress, target.layout, target.pending)
            if workers:
                about = workers.fill(study, target, advance, local)
            else:
                about = fill(study, target, advance, tile, devices)
            target.complete(about)
        result = Result(study, *target.read(), Path(out))
        target.summarise(result.lines())
    return result


def fill(
    study: Study, target: Store, advance: Callable[[int], None], tile: int | None, devices: int | None
) -> dict[str, Any]:
    """Compute what a folder lacks, in this process; what the manifest says of it."""
    began = time.perf_counter()
    engine = Engine(study, target.layout.lanes, tile, devices)
    for box, results, values in execute(engine, target.pending):
        target.chunks.write(box, results, values)
        advance(lanes_in(box))
    return {"times": engine.times(began)}


class LanesDone:
    """Counts the lanes that are done, and passes the count on.

    Args:
        progress: Called with the lanes done and all lanes; None: nobody is.
        layout: All lanes.
        pending: Those that are not done at the beginning.
    """

    def __init__(self, progress: ProgressCallback | None, layout: Layout, pending: list[tuple[slice, ...]]) -> None:
        self.progress, self.total = progress, math.prod(layout.shape)
        self.done = self.total - sum(map(lanes_in, pending))
        self(0)

    def __call__(self, lanes: int) -> None:
        """So many more are done."""
        self.done += lanes
        if self.progress:
            self.progress(self.done, self.total)


def in_one_piece(study: Study, manifest: dict[str, Any], engine: Engine, progress: ProgressCallback | None) -> Result:
    """A run that is kept in memory."""
    began = time.perf_counter()
    layout = Layout.from_dict(manifest["layout"])
    dataset, advance = in_memory(study), LanesDone(progress, layout, layout.blocks())
    for box, results, values in execute(engine, layout.blocks()):
        put(dataset, box, results, values)
        advance(lanes_in(box))
    return Result(study, dataset, manifest | {"complete": True, "times": engine.times(began)})
