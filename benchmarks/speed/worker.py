"""One contender in a process of its own: ``python -m benchmarks.speed.worker FORM LOOP INTEGRATOR BITS DRAWS SECONDS``.

It prints a JSON object once it is ready, after a first run; then it answers each line on its standard input: ``run``
with the seconds that a run took, on the clock and of the processor, ``check FILE`` by writing what it found. Processes
that wait do not disturb, so that the contenders can take turns.
"""

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

BORN = time.time()

import numpy as np  # noqa: E402  (the clock first)

from benchmarks.speed import narrow  # noqa: E402
from benchmarks.speed.workloads import Case, Found, Task, task  # noqa: E402


def peak() -> float:
    """Peak resident memory of this process [GB]; ru_maxrss would be the parent's, too."""
    status = Path("/proc/self/status").read_text().splitlines()
    line = next(line for line in status if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1e6


def timed(make: Callable[[], Callable[[], Found]]) -> tuple[Callable[[], Found], float]:
    """A program, and the seconds that it took to build it, its first run included."""
    began = time.perf_counter()
    program = make()
    program()
    return program, time.perf_counter() - began


def engine(work: Task) -> tuple[Callable[[], Found], float]:
    from benchmarks.speed.ours import tiled

    program, own = tiled(work)
    program()
    return program, own.clock.compile_seconds


def scan(work: Task) -> tuple[Callable[[], Found], float]:
    from benchmarks.speed.ours import plain

    return plain(work)


def unfused(work: Task) -> tuple[Callable[[], Found], float]:
    from benchmarks.speed.ours import plain
    from dssc_jax.engine.plain import plain_options

    return plain(work, plain_options())


def c(work: Task) -> tuple[Callable[[], Found], float]:
    from benchmarks.speed import native

    program, seconds = native.fastest(work, len(os.sched_getaffinity(0)))
    return program, seconds


def numba(work: Task) -> tuple[Callable[[], Found], float]:
    from benchmarks.speed.rivals import parallel

    program, first = timed(lambda: parallel(work))
    _, again = timed(lambda: program)
    return program, first - again


def numpy(work: Task) -> tuple[Callable[[], Found], float]:
    from benchmarks.speed.rivals import batched

    return batched(work), 0.0


FORMS = {"engine": engine, "scan": scan, "unfused": unfused, "c": c, "numba": numba, "numpy": numpy}


def main(form: str, loop: str, integrator: str, bits: str, draws: str, seconds: str) -> None:
    if narrow.WANTED:
        narrow.narrow()
    work = task(Case(loop, integrator, int(bits)), int(draws), float(seconds))
    program, compiling = FORMS[form](work)
    program()
    say({"compile": compiling, "ready": time.time() - BORN, "steps": work.steps})
    for line in sys.stdin:
        order, _, file = line.strip().partition(" ")
        if order == "check":
            with Path(file).open("wb") as target:
                np.savez(target, **program()._asdict())
            say({"peak": peak()})
        else:
            began, used = time.perf_counter(), time.process_time()
            program()
            say({"seconds": time.perf_counter() - began, "processor": time.process_time() - used})


def say(answer: dict[str, float]) -> None:
    """An answer is a line."""
    print(json.dumps(answer), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
