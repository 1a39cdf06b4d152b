"""The C program: written out for a study, compiled when it runs, called through ctypes."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from statistics import median
from tempfile import mkdtemp
from time import perf_counter
from typing import Any

import numpy as np

from benchmarks.speed import narrow
from benchmarks.speed.workloads import Found, Task, agree

SOURCES = Path(__file__).parent / "c"
COMMON = ("-O3", "-march=native", *narrow.FLAGS, "-pthread", "-shared", "-fPIC", f"-I{SOURCES}")
STRICT = ("-fno-math-errno", "-fno-trapping-math")
LOOSE = ("-ffast-math",)
TRIALS = 5


def compiler() -> str | None:
    """GCC, whose vector extensions the program uses, if this machine has it."""
    return shutil.which("gcc")


def version() -> str:
    """First line of what the compiler says of itself."""
    return subprocess.run([compiler() or "gcc", "--version"], capture_output=True, text=True).stdout.splitlines()[0]


def vector_bytes() -> int:
    """Bytes of this machine's vectors."""
    if narrow.WANTED:
        return 32
    flags = Path("/proc/cpuinfo").read_text() if Path("/proc/cpuinfo").exists() else ""
    return 64 if " avx512f" in flags else 32 if " avx" in flags else 16


def initialiser(value: Any) -> str:
    """Numbers, tuples and NamedTuples of them as a C initialiser."""
    if isinstance(value, tuple):
        names = getattr(value, "_fields", None)
        parts = [f".{name} = {initialiser(part)}" for name, part in zip(names or value, value, strict=True) if names]
        return "{" + ", ".join(parts or map(initialiser, value)) + "}"
    return repr(float(value))


def numbers(task: Task, lanes: int) -> str:
    """What a task's program is compiled with: numbers.h."""
    defined = {
        "BITS": task.case.precision,
        "LANES": lanes,
        "PLANT": f'"{task.case.loop}.h"',
        "EULER": int(task.case.integrator == "euler"),
        "SAMPLE_TIME": repr(task.study.loop.sample_time),
        "NUMBERS": initialiser(task.shared),
    }
    return "".join(f"#define {name} {value}\n" for name, value in defined.items())


@lru_cache
def library(content: str, options: tuple[str, ...]) -> ctypes.CDLL:
    """The program with this numbers.h.

    Raises:
        RuntimeError: it does not compile; the compiler's words.
    """
    folder = Path(mkdtemp(prefix="dssc-bench-"))
    (folder / "numbers.h").write_text(content)
    source, target = str(SOURCES / "closed_loop.c"), str(folder / "closed_loop.so")
    command = [compiler() or "gcc", *COMMON, *options, f"-I{folder}", source, "-o", target, "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode:
        raise RuntimeError(done.stderr)
    loaded = ctypes.CDLL(target)
    shutil.rmtree(folder)
    return loaded


class Results(ctypes.Structure):
    """``results`` of dssc.h."""

    _fields_ = (
        ("metrics", ctypes.c_void_p),
        ("outcome", ctypes.c_void_p),
        ("ended", ctypes.c_void_p),
        ("draws", ctypes.c_long),
    )


def program(task: Task, threads: int, options: tuple[str, ...] = STRICT) -> Callable[[], Found]:
    """The C program on a task's draws; each call runs it."""
    lanes = vector_bytes() * 8 // task.case.precision
    own = library(numbers(task, lanes), options)
    at_once = own.at_once()
    real = {64: np.float64, 32: np.float32}[task.case.precision]
    count, channels = task.draws.shape[1], len(task.study.loop.channels)
    padded = -(-count // at_once) * at_once
    draws = np.ascontiguousarray(np.pad(task.draws, ((0, 0), (0, padded - count)), mode="edge"), dtype=real)

    def call() -> Found:
        metrics = np.empty((3, channels, padded), dtype=real)
        outcome, ended = np.zeros(padded, dtype=np.int32), np.zeros(padded, dtype=np.int32)
        out = Results(metrics.ctypes.data, outcome.ctypes.data, ended.ctypes.data, padded)
        own.run(ctypes.c_void_p(draws.ctypes.data), ctypes.c_long(task.study.loop.steps), out, ctypes.c_int(threads))
        return Found(metrics[..., :count], outcome[:count], ended[:count])

    return call


def fastest(task: Task, threads: int) -> tuple[Callable[[], Found], float]:
    """The program with the faster of two sets of options, if both agree, and the seconds of one compilation."""
    began = perf_counter()
    strict = program(task, threads, STRICT)
    compiling = perf_counter() - began
    loose = program(task, threads, LOOSE)
    if not agree(task.case, strict(), loose()):
        return strict, compiling
    seconds: dict[Callable[[], Found], list[float]] = {strict: [], loose: []}
    for _ in range(TRIALS):
        for call, times in seconds.items():
            began = perf_counter()
            call()
            times.append(perf_counter() - began)
    return min(seconds, key=lambda call: median(seconds[call])), compiling
