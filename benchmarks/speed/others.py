"""What other simulators do: ``simulators.py`` under a Python that has them, and how long commands take."""

import json
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from benchmarks.speed.contest import ROOT, environment

STUDY = "mu_robustness"
IMPORTS = "import dssc_jax.study, dssc_jax.runs.run, dssc_jax.console.results"
AGAIN = 5  # starts with a filled cache; their median is told


class Other(NamedTuple):
    """Another simulator.

    Args:
        name: Of its package.
        version: Of its package.
        rate: Steps of a vehicle a second; 0: it did not run.
        difference: What differs from our UAV loop, or why it did not run.
    """

    name: str
    version: str
    rate: float
    difference: str


def simulators(python: Path | None) -> list[Other]:
    """Every simulator that this Python has; none without a Python."""
    if python is None or not python.exists():
        return []
    program = Path(__file__).with_name("simulators.py")
    with TemporaryDirectory() as folder:  # MuJoCo leaves a log where it runs
        done = subprocess.run([python.absolute(), program], capture_output=True, text=True, check=True, cwd=folder)
    return [Other(**json.loads(line)) for line in done.stdout.splitlines() if line.startswith("{")]


class Sweep(NamedTuple):
    """Seconds of a sweep as a command, start of the process included.

    Args:
        table: Until the result is told.
        end: Until the figures are drawn, and the process has ended.
        compiling: Of that, compiling.
        running: Of that, running the loops.
    """

    table: float
    end: float
    compiling: float
    running: float


WAITED = {
    "simulate paper_case1": ("simulate", "paper_case1"),
    "run uav_robustness --draws 16 --set loop.duration=45.0": (
        "run", "uav_robustness", "--draws", "16", "--set", "loop.duration=45.0"),
    "tune tune_uav": ("tune", "tune_uav"),
}  # fmt: skip
"""Commands that people wait for, beside the main study."""


class Start(NamedTuple):
    """Seconds of commands: help, imports alone, the main study with an empty cache, and with a filled one.

    ``waited`` has the seconds of :data:`WAITED` with an empty cache and with a filled one.
    """

    help: float
    imports: float
    cold: Sweep
    warm: Sweep
    waited: dict[str, tuple[float, float]]


def start() -> Start:
    """Time the commands, the cache in a folder of its own."""
    with TemporaryDirectory() as folder:
        own = environment({"XDG_CACHE_HOME": folder})

        def seconds(until: str, *words: str, within: Path = ROOT) -> tuple[float, float]:
            began, told = time.perf_counter(), 0.0
            process = subprocess.Popen([sys.executable, *words], env=own, cwd=within, stdout=subprocess.PIPE, text=True)
            with process:
                for line in process.stdout or ():
                    told = told or (time.perf_counter() - began if line.startswith(until) else 0.0)
            if process.returncode:
                raise RuntimeError(f"{' '.join(words)} ended with status {process.returncode}")
            return told, time.perf_counter() - began

        def sweep(name: str) -> Sweep:
            out = Path(folder) / name
            told, end = seconds("result", "-m", "dssc_jax.cli", "sweep", STUDY, "--out", str(out))
            times = json.loads((out / "manifest.json").read_text())["times"]
            return Sweep(told, end, times["compile_seconds"], times["run_seconds"])

        told = seconds("", "-m", "dssc_jax.cli", "--help")[1]
        imported = sorted(seconds("", "-c", IMPORTS)[1] for _ in range(AGAIN))[AGAIN // 2]
        cold, *warm = (sweep(f"sweep-{i}") for i in range(1 + AGAIN))

        def waited(number: int, words: tuple[str, ...]) -> tuple[float, float]:
            folders = [Path(folder) / f"waited-{number}-{turn}" for turn in range(2)]
            for within in folders:
                within.mkdir()
            first, again = (seconds("", "-m", "dssc_jax.cli", *words, within=within)[1] for within in folders)
            return first, again

        commands = {name: waited(number, words) for number, (name, words) in enumerate(WAITED.items())}
        return Start(told, imported, cold, sorted(warm, key=lambda sweep: sweep.end)[AGAIN // 2], commands)
