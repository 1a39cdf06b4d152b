"""How a run's time and memory grow: ``python -m benchmarks.speed.scaling LOOP DRAWS SECONDS POINTS`` is one run.

Each run is a process of its own, so that its peak memory is its own; it goes through ``dj.run``, metrics and results
included, and prints a JSON object.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median
from typing import NamedTuple

from benchmarks.speed.contest import environment
from benchmarks.speed.worker import peak
from benchmarks.speed.workloads import Case, study_of
from dssc_jax.lanes.llvm import machine

REPEATS, ENOUGH = 5, 4.0  # runs, or seconds of running after which one is enough
SWEPT = "controller.functions.tau_av"
DRAWS = (1, 10, 100, 1_000, 10_000, 100_000, 1_000_000)
DURATIONS = (5.0, 10.0, 20.0, 40.0, 80.0, 160.0)
POINTS = (1, 4, 16, 64, 256)


class Run(NamedTuple):
    """One run, or several alike of which ``seconds`` is the median.

    Args:
        x: What the curve is over.
        seconds: Of running, without compilation.
        compile_seconds: Of compiling.
        total: Of the first run with everything.
        peak: Peak memory of the process [GB].
        traces: How often the loop was traced.
    """

    x: float
    seconds: float
    compile_seconds: float
    total: float
    peak: float
    traces: int


def one(
    x: float, loop: str, draws: int, duration: float, points: int = 1, devices: int | None = None, keep: bool = False
):
    """A run in a process of its own."""
    limited = {machine.CORES_VARIABLE: str(devices)} if devices else {}
    arguments = [loop, str(draws), str(duration), str(points), *(["keep"] if keep else [])]
    command = [sys.executable, "-m", "benchmarks.speed.scaling", *arguments]
    done = subprocess.run(command, env=environment(limited), capture_output=True, text=True, check=True)
    return Run(x, **json.loads(done.stdout.splitlines()[-1]))


def curves(quick: bool = False) -> dict[str, list[Run]]:
    """Every curve: over draws with each number of devices, over the duration, over sweep points."""
    every = slice(0, 4) if quick else slice(None)
    cores = machine.usable_cores()
    found = {
        f"draws, {count} device{'s' if count > 1 else ''}": [
            one(draws, "axis", draws, 1.0, devices=count) for draws in DRAWS[every]
        ]
        for count in sorted({1, cores})
    }
    found["duration"] = [one(duration, "axis", 16384, duration) for duration in DURATIONS[every]]
    found["points"] = [one(points, "axis", 1024, 10.0, points) for points in POINTS[every]]
    return found


def mission(draws: int = 10_000) -> Run:
    """The UAV's mission of 80 s, results stored."""
    return one(draws, "uav", draws, 80.0, keep=True)


def main(loop: str, draws: str, duration: str, points: str, keep: str = "") -> None:
    """Run, and say what it took."""
    import dssc_jax as dj

    study = study_of(Case(loop), int(draws), float(duration))
    if int(points) > 1:
        study = study.override({"sweep": {SWEPT: {"logspace": [0.01, 0.1, int(points)]}}})
    seconds, first = [], None
    while len(seconds) < REPEATS and sum(seconds) < ENOUGH:
        began = time.perf_counter()
        with tempfile.TemporaryDirectory() as folder:
            result = dj.run(study, out=Path(folder) / "result" if keep else None)
        times = result.manifest["times"]
        total = time.perf_counter() - began
        seconds.append(total - times["compile_seconds"] if keep else times["run_seconds"])
        first = first or {"compile_seconds": times["compile_seconds"], "total": total, "traces": times["traces"]}
    print(json.dumps({"seconds": median(seconds), **(first or {}), "peak": peak()}))


if __name__ == "__main__":
    main(*sys.argv[1:])
