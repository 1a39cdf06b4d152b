"""Runs on several processes or machines by dask.distributed; each task computes and writes a range of blocks.

A worker compiles once, and writes its chunks to the results folder, which all workers must be able to access. Blocks
are independent of each other, and a block that is written twice has the same data. So a worker that dies costs only
time.
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
CONNECTION_TIMEOUT = 30.0  # s, for an answer of the scheduler
IGNORE_INTERRUPTS = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"  # Ctrl-C reaches workers, too
WORKER_TIMEOUT = 600.0  # s without a worker, after which a run gives up: a job queue may take minutes
POLL = 1.0  # s between two checks of the workers
TASKS = 8  # tasks of a worker, if there are enough blocks
MOST_BLOCKS = 16  # of a task


@dataclass(frozen=True)
class Job:
    """All that a worker needs to know about a run; it is sent with every task.

    Args:
        table: Table of the study as JSON.
        folder: Absolute path of the results folder.
        block: Shape of a block.
        local: Folder from which the study's modules may also be imported; None: no such folder.
        native: Native code that the study may load, by absolute paths and digests.
    """

    table: str
    folder: str
    block: tuple[int, ...]
    local: str | None
    native: tuple[NativeFile, ...] = ()


@dataclass(frozen=True)
class Share:
    """What a worker did in one task.

    Args:
        worker: Address of the worker.
        lanes: Number of lanes that the worker computed and wrote.
        seconds: Time in which the lanes ran [s].
        compile_seconds: Time of all compilations since the worker started [s].
        traces: Number of traces of the loop since the worker started.
    """

    worker: str
    lanes: int
    seconds: float
    compile_seconds: float
    traces: int


_device_lock = Lock()


@lru_cache(maxsize=1)
def prepare_worker(job: Job) -> tuple[Engine, Chunks]:
    """Engine and access to the results folder of a worker; created for the first task of a job, and then cached."""
    if job.local:
        allow_imports(job.local)
    for native in job.native:
        allow_native(native.file, native.sha256)
    study = Study.from_table(json.loads(job.table))
    layout = Layout(Layout.of(study).shape, job.block)
    return Engine(study, layout.lanes), Chunks(Path(job.folder), study, layout, "r+")


def compute(job: Job, blocks: list[Block]) -> Share:
    """Run one task on a worker: compute some blocks, and write them to the results folder.

    Args:
        job: The run to which the blocks belong.
        blocks: The blocks.

    Returns:
        The work that was done, with its times.

    Raises:
        ConfigError: The worker cannot load the study, or cannot reach or write the folder.
    """
    from distributed import get_worker

    with _device_lock:  # the threads of a worker share one device
        try:
            engine, chunks = prepare_worker(job)
        except ConfigError as error:
            raise error.within(f"worker {get_worker().address}") from None
        seconds_before = engine.clock.run_seconds
        for block, results, law_values in execute(engine, blocks):
            chunks.write(block, results, law_values)
        clock = engine.clock
        return Share(
            worker=get_worker().address,
            lanes=sum(map(lanes_in, blocks)),
            seconds=clock.run_seconds - seconds_before,
            compile_seconds=clock.compile_seconds,
            traces=clock.traces,
        )


class Cluster:
    """The workers of a scheduler, which compute a run's blocks.

    Args:
        client: A ``distributed.Client`` that is connected to the scheduler.
        address: Address of the scheduler as the user states it.
        notify: Called with a line of text when a worker is lost or joins.
        local: See :class:`Job`.
    """

    def __init__(self, client: Any, address: str, notify: Callable[[str], None], local: str | None = None) -> None:
        """Record which workers are present."""
        self.client = client
        self.address = address
        self.notify = notify
        self.local = local
        self.lost: list[str] = []  # addresses of lost workers
        self._present = self._workers()
        self._checked_at = time.monotonic()  # of the last check of the workers [s]
        self._seen_at = self._checked_at  # of the last check that found a worker [s]

    def _workers(self) -> set[str]:
        """Addresses of the present workers."""
        return set(self.client.nthreads())

    def machinery(self) -> Manifest:
        """Versions, device and compiler settings of the workers, which must agree.

        Raises:
            ConfigError: The workers differ, or a worker cannot import this package.
        """
        try:
            machines = self.client.run(computing)
        except ImportError as error:
            raise ConfigError(OPTION, f"the workers lack this package: {error}") from error
        first, *other_workers = machines  # addresses
        for worker in other_workers:
            differences = machinery_differences(machines[first], machines[worker])
            if differences:
                text = f"workers {first} and {worker} would not give bit-identical results: {listed(differences)}"
                raise ConfigError(OPTION, text)
        return machines[first]

    def fill(self, target: Store, advance: Callable[[int], None]) -> Manifest:
        """Compute the missing blocks of a results folder.

        Args:
            target: The folder, locked by this process.
            advance: Called with the number of lanes of each finished task.

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
        times = sum_times(shares, study.loop.steps, time.perf_counter() - began)
        return {"times": times, "cluster": {"address": self.address, "workers": workers, "lost": self.lost}}

    def _finished_shares(self, job: Job, tasks: list[list[Block]]) -> Iterator[Share]:
        """Submit tasks, and yield the share of each task when it finishes; raises the errors of :meth:`fill`."""
        distributed = importlib.import_module("distributed")
        unfinished = {self.client.submit(compute, job, blocks, pure=False) for blocks in tasks}
        try:
            while unfinished:
                try:
                    finished, unfinished = distributed.wait(unfinished, timeout=POLL, return_when="FIRST_COMPLETED")
                except TimeoutError:  # no task has finished since
                    finished = set()
                if time.monotonic() > self._checked_at + POLL or not unfinished:
                    self._check_workers()
                for future in finished:
                    yield future.result()
        except distributed.KilledWorker as error:
            raise ConfigError(OPTION, f"{error.last_worker.address} and others died of one task; {GO_ON}") from error
        except (CancelledError, FutureCancelled, TimeoutError, distributed.comm.CommClosedError) as error:
            raise ConfigError(OPTION, f"the scheduler at {self.address} was lost; {GO_ON}") from error

    def _check_workers(self) -> None:
        """Notify the user of workers that were lost or joined since the last check.

        Raises:
            ConfigError: There has been no worker for :data:`WORKER_TIMEOUT`.
        """
        now = time.monotonic()
        present = self._workers()
        for worker in sorted(self._present - present):
            self.lost.append(worker)
            self.notify(f"worker {worker} was lost; its unfinished blocks go to others")
        for worker in sorted(present - self._present):
            self.notify(f"worker {worker} joined")
        self._present = present
        self._checked_at = now
        if present:
            self._seen_at = now
        if now > self._seen_at + WORKER_TIMEOUT:
            raise ConfigError(OPTION, f"no worker for {WORKER_TIMEOUT:g} s; {GO_ON}")


def block_ranges(blocks: list[Block], workers: int) -> list[list[Block]]:
    """Divide blocks into ranges, one for each task: about :data:`TASKS` or more tasks for each worker."""
    tasks = TASKS * max(workers, 1)
    size = min(max(len(blocks) // tasks, 1), MOST_BLOCKS)
    return [blocks[first : first + size] for first in range(0, len(blocks), size)]


def sum_times(shares: list[Share], steps: int, seconds: float) -> dict[str, float]:
    """The times of a run, for its manifest.

    The rates of the workers add up. Compilations run in parallel, so that the longest one counts.

    Args:
        shares: The work of all tasks.
        steps: Number of samples of a lane.
        seconds: Duration of the run [s].
    """
    lanes: dict[str, int] = {}  # by worker
    busy_seconds: dict[str, float] = {}  # by worker
    for share in shares:
        lanes[share.worker] = lanes.get(share.worker, 0) + share.lanes
        busy_seconds[share.worker] = busy_seconds.get(share.worker, 0.0) + share.seconds
    rates = [lanes[worker] * steps / busy for worker, busy in busy_seconds.items() if busy > 0.0]
    return {
        "seconds": seconds,
        "compile_seconds": max((share.compile_seconds for share in shares), default=0.0),
        "run_seconds": max(busy_seconds.values(), default=0.0),
        "rate": sum(rates),
        "traces": max((share.traces for share in shares), default=0),
    }


@contextmanager
def connected(address: str, notify: Callable[[str], None], local: str | None = None) -> Iterator[Cluster]:
    """Open a context with the workers of a scheduler, or with local processes, which end with the context.

    Args:
        address: ``tcp://host:port`` of a scheduler, or ``local:N`` for N processes on this machine.
        notify: See :class:`Cluster`.
        local: See :class:`Job`.

    Raises:
        ConfigError: The address is wrong, there is no answer, or dask.distributed is not installed.
    """
    count = local_processes(address)
    try:
        distributed = importlib.import_module("distributed")
    except ImportError:
        raise ConfigError(OPTION, "needs dask.distributed: pip install 'dssc_jax[cluster]'") from None
    with ExitStack() as stack:
        # `notify` tells of a lost worker in one line; dask's log would add many
        stack.enter_context(distributed.utils.silence_logging_cmgr(logging.CRITICAL))
        place = stack.enter_context(local_cluster(count)) if count else address
        try:
            client = stack.enter_context(distributed.Client(place, timeout=CONNECTION_TIMEOUT))
            client.wait_for_workers(count or 1, timeout=WORKER_TIMEOUT)
        except (OSError, TimeoutError, ValueError) as error:
            raise ConfigError(OPTION, f"no scheduler with workers answers at {address}: {error}") from error
        yield Cluster(client, address, notify, local)


def local_processes(address: str) -> int:
    """The number of processes N in the address ``local:N``; 0 for the address of a scheduler.

    Raises:
        ConfigError: The address has neither form.
    """
    if address.startswith(LOCAL_SCHEME):
        count = address.removeprefix(LOCAL_SCHEME)
        if count.isascii() and count.isdecimal() and 1 <= int(count) <= 1024:
            return int(count)
    elif "://" in address:
        return 0
    raise ConfigError(OPTION, f"must be tcp://HOST:PORT or local:N with 1 <= N <= 1024, got '{address}'")


def local_cluster(count: int) -> Any:
    """Start a dask cluster of processes on this machine, with local access only.

    The processes are spawned, because a fork would break the threads of JAX. A process of dask watches each of them,
    and starts it again if it dies.
    """
    distributed = importlib.import_module("distributed")
    dask = importlib.import_module("dask")
    dask.config.set({"distributed.worker.multiprocessing-method": "spawn"})
    local_access = {"host": "127.0.0.1", "dashboard": False}
    common = {
        **local_access,
        "silence_logs": logging.CRITICAL,
        "nthreads": 1,
        "memory_limit": 0,  # none
        "preload": [IGNORE_INTERRUPTS],
    }
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
    """Environment variables of worker ``index`` of ``count``: an equal share of the cores, and a GPU if any."""
    environment = {machine.CORES_VARIABLE: str(max(1, machine.usable_cores() // count))}
    gpus = visible_gpus()
    if gpus:
        environment["CUDA_VISIBLE_DEVICES"] = gpus[index % len(gpus)]
    return environment


def visible_gpus() -> list[str]:
    """Names of the GPUs that this process may use, found without JAX, which would occupy one of them."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible is not None:
        return [name for name in visible.split(",") if name]
    numbers = [path.name.removeprefix("nvidia") for path in Path("/dev").glob("nvidia[0-9]*")]
    return sorted(numbers, key=int)
