"""Runs on several processes or machines by dask.distributed; each task computes and writes a range of blocks.

A worker compiles once and writes its own chunks to the common results folder, which all workers must be able to
access. Blocks are independent, and writing one twice gives the same data, so a worker that dies costs only time.
"""

import importlib
import json
import logging
import os
import time
from asyncio import CancelledError
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError as FutureCancelled
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from threading import Lock
from typing import Any

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native.allowed import allow_native
from dssc_jax.engine.batching import Block, Engine, Layout, computing, execute, lanes_in
from dssc_jax.lanes.llvm import machine
from dssc_jax.results.blocks import Chunks
from dssc_jax.results.manifest import Manifest, listed, machinery_differences
from dssc_jax.results.store import Store
from dssc_jax.study import Study
from dssc_jax.study.importing import allow_imports
from dssc_jax.study.native import NativeFile, native_files

GO_ON = "finished blocks are kept, `resume` continues from them"
LOCAL_SCHEME = "local:"
OPTION = "cluster"
CONNECT = 30.0  # s for the scheduler to answer
DEAF = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"  # Ctrl-C reaches all; the first process ends them
PATIENCE = 600.0  # s without a worker before giving up: a queue may take its time
POLL = 1.0  # s between looks at who is there
TASKS = 8  # least number of tasks of a worker
MOST_BLOCKS = 16  # blocks of a task


@dataclass(frozen=True)
class Job:
    """The data that a worker needs; sent with every task and cached by the worker.

    Args:
        table: The study's table as JSON.
        folder: The results folder, absolute.
        block: Shape of its blocks.
        local: Folder from which the study's ``module:object`` names may be imported.
        native: The native code that the study's run may load, by absolute files and digests.
    """

    table: str
    folder: str
    block: tuple[int, ...]
    local: str | None
    native: tuple[NativeFile, ...] = ()


@dataclass(frozen=True)
class Share:
    """The work done by a worker in one task.

    Args:
        worker: Its address.
        lanes: Lanes computed and written.
        seconds: Time spent running them.
        compile_seconds: Time that the worker has spent compiling since it started.
        traces: How often it has traced the loop since then.
    """

    worker: str
    lanes: int
    seconds: float
    compile_seconds: float
    traces: int


_one_at_a_time = Lock()


@lru_cache(maxsize=1)
def prepared(job: Job) -> tuple[Engine, Chunks]:
    """A worker's engine and its access to the folder, created once per job."""
    if job.local:
        allow_imports(job.local)
    for native in job.native:
        allow_native(native.file, native.sha256)
    study = Study.from_table(json.loads(job.table))
    layout = Layout(Layout.of(study).shape, job.block)
    return Engine(study, layout.lanes), Chunks(Path(job.folder), study, layout, "r+")


def compute(job: Job, blocks: list[Block]) -> Share:
    """Run one task on the worker: compute blocks and write them."""
    from distributed import get_worker

    with _one_at_a_time:  # a worker with several threads still has one device to share
        try:
            engine, chunks = prepared(job)
        except ConfigError as error:
            raise error.within(f"worker {get_worker().address}") from None
        seconds_before = engine.clock.run_seconds
        for block, results, law_values in execute(engine, blocks):
            chunks.write(block, results, law_values)
        clock = engine.clock
        lanes = sum(map(lanes_in, blocks))
        return Share(
            get_worker().address, lanes, clock.run_seconds - seconds_before, clock.compile_seconds, clock.traces
        )


class Cluster:
    """Workers of a scheduler.

    Args:
        client: A ``distributed.Client`` connected to it.
        address: The address given by the user.
        notify: Called with a line of text when a worker is lost or joins.
        local: See :class:`Job`.
    """

    def __init__(self, client: Any, address: str, notify: Callable[[str], None], local: str | None = None) -> None:
        self.client = client
        self.address = address
        self.notify = notify
        self.local = local
        self.lost: list[str] = []
        self._present = self._workers()
        self._last_look = time.monotonic()
        self._last_present = self._last_look

    def _workers(self) -> set[str]:
        return set(self.client.nthreads())

    def machinery(self) -> Manifest:
        """Versions, device and compiler settings of the workers, which must agree.

        Raises:
            ConfigError: They differ, or cannot import this package.
        """
        try:
            machines = self.client.run(computing)
        except ImportError as error:
            raise ConfigError(OPTION, f"the workers lack this package: {error}") from error
        reference, *other_workers = machines
        for worker in other_workers:
            differences = machinery_differences(machines[reference], machines[worker])
            if differences:
                text = f"workers {reference} and {worker} would not give bit-identical results: {listed(differences)}"
                raise ConfigError(OPTION, text)
        return machines[reference]

    def fill(self, target: Store, advance: Callable[[int], None]) -> Manifest:
        """Compute the missing blocks of a folder.

        Args:
            target: The folder, locked by this process.
            advance: Called with the number of lanes of every finished task.

        Returns:
            Entries for the manifest: ``times`` and ``cluster``.

        Raises:
            ConfigError: The scheduler or all workers are permanently lost, or a worker cannot write.
        """
        began = time.perf_counter()
        study = target.study
        native = tuple(part._replace(file=part.place or part.file) for part in native_files(study.table))
        job = Job(json.dumps(study.table), str(target.folder.resolve()), target.layout.block, self.local, native)
        workers = len(self._present)
        shares = []
        for share in self._finished_shares(job, block_ranges(target.pending, workers)):
            shares.append(share)
            advance(share.lanes)
        times = summed(shares, study.loop.steps, time.perf_counter() - began)
        return {"times": times, "cluster": {"address": self.address, "workers": workers, "lost": self.lost}}

    def _finished_shares(self, job: Job, tasks: list[list[Block]]) -> Iterator[Share]:
        distributed = importlib.import_module("distributed")
        unfinished = {self.client.submit(compute, job, blocks, pure=False) for blocks in tasks}
        try:
            while unfinished:
                try:
                    finished, unfinished = distributed.wait(unfinished, timeout=POLL, return_when="FIRST_COMPLETED")
                except TimeoutError:
                    finished = set()
                if time.monotonic() > self._last_look + POLL or not unfinished:
                    self._look()
                for future in finished:
                    yield future.result()
        except distributed.KilledWorker as error:
            raise ConfigError(OPTION, f"{error.last_worker.address} and others died of one task; {GO_ON}") from error
        except (CancelledError, FutureCancelled, TimeoutError, distributed.comm.CommClosedError) as error:
            raise ConfigError(OPTION, f"the scheduler at {self.address} was lost; {GO_ON}") from error

    def _look(self) -> None:
        time_of_look = time.monotonic()
        present = self._workers()
        for worker in sorted(self._present - present):
            self.lost.append(worker)
            self.notify(f"worker {worker} was lost; its unfinished blocks go to others")
        for worker in sorted(present - self._present):
            self.notify(f"worker {worker} joined")
        self._present = present
        self._last_look = time_of_look
        if present:
            self._last_present = time_of_look
        if time_of_look > self._last_present + PATIENCE:
            raise ConfigError(OPTION, f"no worker for {PATIENCE:g} s; {GO_ON}")


def block_ranges(blocks: list[Block], workers: int) -> list[list[Block]]:
    """Divide blocks into ranges, one per task."""
    size = min(max(len(blocks) // (TASKS * max(workers, 1)), 1), MOST_BLOCKS)
    return [blocks[i : i + size] for i in range(0, len(blocks), size)]


def summed(shares: list[Share], steps: int, seconds: float) -> dict[str, float]:
    """The times of a run: the workers' rates add up, and their compilations run in parallel."""
    lanes: dict[str, int] = {}
    busy: dict[str, float] = {}
    for share in shares:
        lanes[share.worker] = lanes.get(share.worker, 0) + share.lanes
        busy[share.worker] = busy.get(share.worker, 0.0) + share.seconds
    return {
        "seconds": seconds,
        "compile_seconds": max((share.compile_seconds for share in shares), default=0.0),
        "run_seconds": max(busy.values(), default=0.0),
        "rate": sum(lanes[worker] * steps / busy[worker] for worker in lanes if busy[worker] > 0.0),
        "traces": max((share.traces for share in shares), default=0),
    }


@contextmanager
def connected(address: str, notify: Callable[[str], None], local: str | None = None) -> Iterator[Cluster]:
    """Connect to workers at an address, or start local workers for the duration of the context.

    Args:
        address: ``tcp://host:port`` of a scheduler, or ``local:N`` for N processes on this machine.
        notify: See :class:`Cluster`.
        local: See :class:`Job`.

    Raises:
        ConfigError: The address is wrong, there is no answer, or dask.distributed is not installed.
    """
    count = parsed(address)
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise ConfigError(OPTION, "needs dask.distributed: pip install 'dssc_jax[cluster]'") from None
    with ExitStack() as stack:  # what dask logs of a loss is told in one line instead
        stack.enter_context(distributed.utils.silence_logging_cmgr(logging.CRITICAL))
        place = stack.enter_context(local_cluster(count)) if count else address
        try:
            client = stack.enter_context(distributed.Client(place, timeout=CONNECT))
            client.wait_for_workers(count or 1, timeout=PATIENCE)
        except (OSError, TimeoutError, ValueError) as error:
            raise ConfigError(OPTION, f"no scheduler with workers answers at {address}: {error}") from error
        yield Cluster(client, address, notify, local)


def parsed(address: str) -> int:
    """Number of processes in ``local:N``; 0 for the address of a scheduler.

    Raises:
        ConfigError: It is neither.
    """
    if address.startswith(LOCAL_SCHEME):
        count = address.removeprefix(LOCAL_SCHEME)
        if count.isascii() and count.isdecimal() and 1 <= int(count) <= 1024:
            return int(count)
    elif "://" in address:
        return 0
    raise ConfigError(OPTION, f"must be tcp://HOST:PORT or local:N with 1 <= N <= 1024, got '{address}'")


def local_cluster(count: int) -> Any:
    """Start processes on this machine, spawned and never forked because JAX has threads, with local access only."""
    distributed = importlib.import_module("distributed")
    dask = importlib.import_module("dask")
    dask.config.set({"distributed.worker.multiprocessing-method": "spawn"})
    local_access = {"host": "127.0.0.1", "dashboard": False}
    common = {**local_access, "silence_logs": logging.CRITICAL, "nthreads": 1, "memory_limit": 0, "preload": [DEAF]}
    workers = {}
    for index in range(count):
        options = {**common, "env": worker_environment(index, count)}
        workers[index] = {"cls": distributed.Nanny, "options": options}
    return distributed.SpecCluster(
        scheduler={"cls": distributed.Scheduler, "options": local_access},
        workers=workers,
        silence_logs=logging.CRITICAL,
    )


def worker_environment(index: int, count: int) -> dict[str, str]:
    """A worker's share of the machine: one GPU each where there are any, else an equal part of the cores."""
    gpus = visible_gpus()
    return {
        machine.CORES_VARIABLE: str(max(1, machine.usable_cores() // count)),
        **({"CUDA_VISIBLE_DEVICES": gpus[index % len(gpus)]} if gpus else {}),
    }


def visible_gpus() -> list[str]:
    """The GPUs that a process may use, found without starting JAX, which would occupy one."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return [name for name in visible.split(",") if name]
    numbers = [path.name.removeprefix("nvidia") for path in Path("/dev").glob("nvidia[0-9]*")]
    return sorted(numbers, key=int)
