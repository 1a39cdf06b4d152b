"""Regenerate the measured part of docs/cluster.md: what a block costs besides its simulation, and 10^9 draws on paper.

The study is the main one, mu_robustness, without its sweep: 12,000 samples a draw.
"""

import argparse
import os
import shutil
import tempfile
import time
from pathlib import Path
from statistics import median

import numpy as np

import dssc_jax as dj
from dssc_jax.console.environment import machine
from dssc_jax.engine.batching import BLOCK, Engine, Layout, computing, execute
from dssc_jax.results.schema import variables
from dssc_jax.results.store import Store
from dssc_jax.runs.cluster import connected
from dssc_jax.runs.run import run_manifest
from dssc_jax.study.library import find_study

PAGE = Path(__file__).parents[1] / "docs" / "cluster.md"
MARK = "<!-- measured: everything below is written by benchmarks/cluster.py -->"
DRAWS = 1e9
TASK_BLOCKS = 16


def nothing(number: int) -> int:
    """A task that does nothing."""
    return number


def blocks(study: dj.Study, folder: Path) -> dict[str, float]:
    """Seconds of simulating, writing and checking a block of 16,384 lanes, and its bytes on disk."""
    layout = Layout.of(study)
    engine = Engine(study, layout.lanes)
    writing = []
    with Store(folder, study, run_manifest(study, layout, computing())) as target:
        for box, results, drawn in execute(engine, target.pending):
            began = time.perf_counter()
            target.chunks.write(box, results, drawn)
            writing.append(time.perf_counter() - began)
        began = time.perf_counter()
        target.chunks.pending()
        checking = (time.perf_counter() - began) / len(layout.blocks())
        files = [file for file in (folder / "data.zarr").rglob("c/*") if file.is_file()]
        size = sum(file.stat().st_size for file in files) / len(layout.blocks())
    return {
        "simulate": engine.clock.run_seconds / len(layout.blocks()),
        "write": median(writing),
        "check": checking,
        "compile": engine.clock.compile_seconds,
        "bytes": size,
        "files": len(files) / len(layout.blocks()),
        "rate": engine.rate,
        "loaded": sum(np.dtype(variable.dtype).itemsize for variable in variables(study).values()),
    }


def tasks(count: int = 2000) -> tuple[float, float]:
    """Seconds of a task that does nothing, of many at once, and of starting two workers."""
    began = time.perf_counter()
    with connected("local:2", print) as workers:
        started = time.perf_counter() - began
        began = time.perf_counter()
        workers.client.gather(workers.client.map(nothing, range(count)))
        return (time.perf_counter() - began) / count, started


def plan(found: dict[str, float], task: float) -> list[str]:
    """10^9 draws on machines like this one."""
    number = int(np.ceil(DRAWS / BLOCK))
    simulate, beside = number * found["simulate"], number * (found["write"] + task / TASK_BLOCKS)
    loaded = f"{DRAWS / 10 * found['loaded'] / 1e9:.0f} GB; fewer `[metrics] names` take less"
    rows = [
        ("blocks of 16,384 draws", f"{number:,}"),
        ("tasks of 16 blocks", f"{-(-number // TASK_BLOCKS):,}"),
        ("simulation", f"{simulate / 3600:.1f} machine hours"),
        ("writing and tasks", f"{beside / 3600:.1f} machine hours, {100 * beside / simulate:.1f} % of the simulation"),
        ("the scheduler's part", f"{number / TASK_BLOCKS * task:.0f} s in all"),
        ("checking every chunk on `--resume`", f"{number * found['check'] / 60:.0f} min"),
        ("on disk", f"{number * found['bytes'] / 1e9:.0f} GB in {number * found['files'] / 1e6:.1f} million files"),
        ("memory to load one of ten folders", loaded),
        ("10 machines", f"{(simulate + beside) / 10 / 3600:.1f} h"),
        ("100 machines", f"{(simulate + beside) / 100 / 3600:.2f} h"),
    ]
    return ["| | |", "|---|---|", *(f"| {name} | {value} |" for name, value in rows)]


def main() -> None:
    options = argparse.ArgumentParser()
    options.add_argument("--blocks", type=int, default=6)
    chosen = options.parse_args()
    study = dj.Study.load(find_study("mu_robustness")).without_sweep().override({"draws": chosen.blocks * BLOCK})
    folder = Path(tempfile.mkdtemp())
    try:
        found = blocks(study, folder / "r")
    finally:
        shutil.rmtree(folder)
    task, started = tasks()
    busy = os.getloadavg()[0]
    lines = [
        MARK,
        "",
        f"Measured by `python benchmarks/cluster.py`. Machine: {machine()}; load {busy:.0f} when it ended.",
        "",
        "| a block of 16,384 draws of `mu_robustness` (60 s at 5 ms) | |",
        "|---|---|",
        f"| simulation | {found['simulate']:.2f} s ({found['rate'] / 1e6:.0f} million draw samples per second) |",
        f"| writing its {found['files']:.0f} chunks, {found['bytes'] / 1e6:.2f} MB | {1e3 * found['write']:.0f} ms |",
        f"| reading and checking them on `--resume` | {1e3 * found['check']:.0f} ms |",
        f"| a dask task, of up to 16 blocks | {1e3 * task:.1f} ms |",
        f"| compilation, once per worker | {found['compile']:.1f} s |",
        f"| starting two workers of `local:2` | {started:.1f} s |",
        "",
        "### Estimate for 10^9 draws",
        "",
        "For machines like this one. A study has at most 10^8 draws, so 10^9 draws need ten seeds and ten folders.",
        "",
        *plan(found, task),
    ]
    before = PAGE.read_text(encoding="utf-8").partition(MARK)[0]
    PAGE.write_text(before + "\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
