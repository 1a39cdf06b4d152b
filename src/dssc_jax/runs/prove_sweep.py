"""Proofs at every point of a study's sweep, in parallel processes."""

import itertools
import json
import multiprocessing
import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from multiprocessing.connection import Connection
from queue import SimpleQueue

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.proofs import SWEEP_BOXES
from dssc_jax.proofs.coverage import AnyProblem, problem_of
from dssc_jax.results.proofs import SweepProofs
from dssc_jax.study import Study

PointOutcome = tuple[JsonObject, JsonObject]
"""Summary and certificate of one point."""


def prove_sweep(
    study: Study,
    *,
    boxes: int = SWEEP_BOXES,
    processes: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SweepProofs:
    """Prove the statement of a study at every point of its sweep, in parallel processes.

    Args:
        study: A study with a sweep; a swept value replaces the law of its parameter.
        boxes: Largest number of boxes of uncertain numbers that are tried at each point.
        processes: Number of processes; None: one for each core. The processes are spawned, so a script that asks for
            several of them needs ``if __name__ == "__main__":``. With 1, this process does the work.
        progress: Called with the points done and the number of points.

    Raises:
        NotCovered: No proof covers this kind of loop; the message gives the reason.
        ConfigError: ``boxes`` or ``processes`` is not positive.
        RuntimeError: A process has died.
    """
    count = processes
    if count is None:
        count = os.cpu_count() or 1
    for name, value in (("boxes", boxes), ("processes", count)):
        if value < 1:
            raise ConfigError(name, f"must be at least 1, got {value}")
    began = time.perf_counter()
    problems = [problem_of(point) for point in sweep_points(study)]
    outcomes: list[PointOutcome] = []
    with ExitStack() as stack:
        if count == 1:
            answers = (prove_point(problem, boxes) for problem in problems)
        else:
            idle: SimpleQueue[Connection] = SimpleQueue()  # connections to idle processes
            for _ in range(min(count, len(problems))):
                idle.put(stack.enter_context(worker(boxes)))
            pool = stack.enter_context(ThreadPoolExecutor(count))  # each thread waits for one process
            answers = pool.map(lambda problem: ask(idle, problem), problems)
        for answer in answers:
            outcomes.append(answer)
            if progress is not None:
                progress(len(outcomes), len(problems))
    summaries = [summary for summary, _ in outcomes]
    certificates = [certificate for _, certificate in outcomes]
    return SweepProofs(study.hash, study.axes, summaries, certificates, time.perf_counter() - began)


def foreign_points(study: Study, certificates: Sequence[JsonObject]) -> list[int]:
    """Indices of the points of a sweep whose certificates were made for another loop than that of the study.

    Args:
        study: The study.
        certificates: The certificate of each point of its sweep.
    """
    indices = []
    for i, (point, certificate) in enumerate(zip(sweep_points(study), certificates, strict=True)):
        problem = json.loads(json.dumps(problem_of(point).to_dict()))  # as a certificate's file would hold it
        if problem_in(certificate) != problem:
            indices.append(i)
    return indices


def problem_in(certificate: object) -> object:
    """The problem that a certificate contains; None if it contains none."""
    return certificate.get("problem") if isinstance(certificate, dict) else None


def prove_point(problem: AnyProblem, boxes: int) -> PointOutcome:
    """Try to prove the statement at one point of a sweep; return its summary and its certificate."""
    from dssc_jax.proofs.prove import prove_problem

    outcome = prove_problem(problem, boxes)
    return outcome.summary(), outcome.certificate()


def answer_all(connection: Connection, boxes: int) -> None:
    """Receive problems, prove them and send the outcomes, until this process is terminated."""
    while True:
        connection.send(prove_point(connection.recv(), boxes))


@contextmanager
def worker(boxes: int) -> Iterator[Connection]:
    """Open a context with a process that proves, and yield the connection to it; the process ends with the context."""
    spawn = multiprocessing.get_context("spawn")
    connection, connection_of_worker = spawn.Pipe()
    process = spawn.Process(target=answer_all, args=(connection_of_worker, boxes), daemon=True)
    process.start()
    connection_of_worker.close()
    try:
        yield connection
    finally:
        process.terminate()
        process.join()
        connection.close()


def ask(idle: "SimpleQueue[Connection]", problem: AnyProblem) -> PointOutcome:
    """Have an idle process prove a problem, and wait for the outcome.

    Args:
        idle: Connections to idle processes.
        problem: The problem to prove.

    Raises:
        RuntimeError: The process has died.
    """
    connection = idle.get()
    try:
        connection.send(problem)
        return connection.recv()
    except (EOFError, OSError):
        raise RuntimeError("a process that proves has ended before its work; is there enough memory?") from None
    finally:
        idle.put(connection)


def sweep_points(study: Study) -> Iterator[Study]:
    """Yield the study at each point of its sweep, with the swept values in place of the laws of their parameters."""
    single = study.without_sweep()
    for values in itertools.product(*study.axes.values()):
        yield single.override(dict(zip(study.axes, values, strict=True)))
