"""What other simulators do: ``simulators.py`` under a Python that has them, and how long commands take."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

from benchmarks.speed.contest import ROOT
from dssc_jax import xla

STUDY = "mu_robustness"


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


class Start(NamedTuple):
    """Seconds of commands, start of the process included: help, then a study with an empty cache and a filled one."""

    help: float
    cold: float
    warm: float


def start() -> Start:
    """Time the commands, the cache in a folder of its own."""
    with TemporaryDirectory() as folder:
        environment = {name: value for name, value in os.environ.items() if name not in ("XLA_FLAGS", xla.SWITCH)}
        environment["XDG_CACHE_HOME"] = folder

        def seconds(*words: str) -> float:
            began = time.perf_counter()
            command = [sys.executable, "-m", "dssc_jax.cli", *words]
            subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, check=True)
            return time.perf_counter() - began

        sweeps = (("sweep", STUDY, "--out", str(Path(folder) / name)) for name in ("first", "second"))
        return Start(seconds("--help"), *(seconds(*words) for words in sweeps))
