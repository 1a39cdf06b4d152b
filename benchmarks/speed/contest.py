"""The contenders take turns at one task, each in a process of its own; rates, ratios and what a process costs."""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import numpy as np

from benchmarks.speed import native, rivals
from benchmarks.speed.workloads import Case, Found, agree, disagreement
from dssc_jax.lanes.llvm import machine

ROOT = Path(__file__).parents[2]
SIZES = {"uav": (4096, 10.0), "axis": (16384, 40.0)}
"""Draws, and seconds of flight."""


class Contender(NamedTuple):
    """A program to time.

    Args:
        name: As tables have it.
        form: Which program of ``worker.FORMS``.
        environment: Beside the common one.
        every: It runs in one round of so many.
    """

    name: str
    form: str
    environment: dict[str, str] = {}  # noqa: RUF012  (never changed)
    every: int = 1


OURS = Contender("dssc_jax", "engine")
ONE_DEVICE = Contender("dssc_jax, one device", "engine", {machine.CORES_VARIABLE: "1"})
PLAIN = Contender("jit(vmap(scan))", "scan", every=4)
UNFUSED = Contender("jit(vmap(scan)), no fusion", "unfused", every=4)
C = Contender("C", "c")
NUMBA = Contender("Numba", "numba")
NUMPY = Contender("NumPy", "numpy", every=4)


def available() -> list[Contender]:
    """Every contender that this machine can run, ours first."""
    found = [OURS, ONE_DEVICE, PLAIN, UNFUSED]
    found += [C] if native.compiler() else []
    found += [NUMBA] if rivals.has_numba() else []
    return [*found, NUMPY]


def environment(more: dict[str, str]) -> dict[str, str]:
    """That of a process of its own: this one's without what importing the package has added to it, and ``more``."""
    added = (machine.CORES_VARIABLE,)
    path = os.pathsep.join([str(ROOT), *filter(None, [os.environ.get("PYTHONPATH")])])
    return {name: value for name, value in os.environ.items() if name not in added} | {"PYTHONPATH": path} | more


class Worker:
    """A contender's process."""

    def __init__(self, contender: Contender, case: Case, draws: int, duration: float, cache: str) -> None:
        arguments = [contender.form, case.loop, case.integrator, str(case.precision), str(draws), str(duration)]
        self.contender = contender
        self.process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.speed.worker", *arguments],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env=environment({"XDG_CACHE_HOME": cache} | contender.environment),
        )

    def answer(self) -> dict[str, float]:
        """The next line that it says.

        Raises:
            RuntimeError: it is gone.
        """
        assert self.process.stdout is not None
        line = self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self.contender.name} ended with status {self.process.wait()}")
        return json.loads(line)

    def ask(self, order: str) -> dict[str, float]:
        """Its answer to an order."""
        assert self.process.stdin is not None
        self.process.stdin.write(order + "\n")
        self.process.stdin.flush()
        return self.answer()

    def found(self, folder: Path) -> tuple[Found, float]:
        """What it finds, and its peak memory [GB]."""
        file = folder / "found.npz"
        peak = self.ask(f"check {file}")["peak"]
        with np.load(file) as arrays:
            return Found(**{name: arrays[name] for name in Found._fields}), peak

    def __enter__(self) -> "Worker":
        return self

    def __exit__(self, *error: object) -> None:
        self.process.__exit__(None, None, None)


class Measured(NamedTuple):
    """What was seen of one contender.

    Args:
        rates: Lane-steps a second, round by round; None where it sat out.
        compile_seconds: Of its compiler, whichever that is.
        ready: Seconds from the start of its process to its first result.
        peak: Peak memory of its process [GB].
        difference: Largest relative difference of a metric from ours.
    """

    rates: list[float | None]
    compile_seconds: float
    ready: float
    peak: float
    difference: float


def contest(
    case: Case,
    contenders: Sequence[Contender],
    draws: int,
    duration: float,
    rounds: int,
    at_once: bool = False,
    clock: str = "seconds",
) -> dict[str, Measured]:
    """Let the contenders take turns.

    Args:
        case: What they run.
        contenders: Ours first: the others' results are compared with it.
        draws: How many draws.
        duration: Of how many seconds.
        rounds: How often each has its turn.
        at_once: Start all processes together, which spoils their times of compilation but is sooner done.
        clock: ``seconds`` for rates, or ``processor`` for rates of one core, which other processes disturb less.

    Raises:
        RuntimeError: a contender's results differ from ours by more than rounding.
    """
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        workers, ready = [], []
        for contender in contenders:
            cache = str(folder / f"cache-{len(workers)}")
            workers.append(stack.enter_context(Worker(contender, case, draws, duration, cache)))
            if not at_once:
                ready.append(workers[-1].answer())
        ready = ready or [worker.answer() for worker in workers]
        rates: list[list[float | None]] = [[] for _ in workers]
        for turn in range(rounds):
            for i, worker in enumerate(workers):
                sits_out = turn % worker.contender.every
                rates[i].append(None if sits_out else ready[i]["steps"] / worker.ask("run")[clock])
        found = [worker.found(folder) for worker in workers]
    measured = {}
    for worker, speed, first, (results, peak) in zip(workers, rates, ready, found, strict=True):
        difference, name = disagreement(found[0][0], results), worker.contender.name
        if not agree(case, found[0][0], results):
            raise RuntimeError(f"{case.text}: {name} differs from {contenders[0].name} by {difference:.1e}")
        measured[name] = Measured(speed, first["compile"], first["ready"], peak, difference)
    return measured


def ratios(of: Measured, to: Measured) -> np.ndarray:
    """Ratio of two contenders' rates, round by round where both ran."""
    return np.array([a / b for a, b in zip(of.rates, to.rates, strict=True) if a and b])


def quartiles(values: Any) -> tuple[float, float, float]:
    """Lower quartile, median, upper quartile."""
    low, middle, high = np.percentile([value for value in values if value is not None], [25, 50, 75])
    return float(low), float(middle), float(high)
