"""What people wait for at the command line, into a part of docs/performance.md: ``python -m benchmarks.speed.waiting``.

Every command is a process of its own. It runs once with an empty cache and then, taking turns with the others, with the
filled one.
"""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import NamedTuple

from playwright.sync_api import Browser, sync_playwright

from benchmarks.page import put
from benchmarks.speed.contest import ROOT, environment

PAGE = ROOT / "docs" / "performance.md"
TURNS = 3  # with a filled cache; their median is told
STUDY = "mu_robustness"
IMPORTS = "import dssc_jax.study, dssc_jax.runs.run, dssc_jax.console.results"
COMMANDS = (
    ("simulate", "paper_case1"),
    ("run", "uav_robustness", "--draws", "16", "--set", "loop.duration=45.0"),
    ("run", "uav_robustness", "--draws", "256", "--set", "loop.sample_time=0.002", "--set", "loop.duration=45.0"),
    ("tune", "tune_uav"),
    ("sweep", STUDY),
)
"""The main study is the last."""
EXPLORED = ("explore", "uav_robustness", "--no-browser")
PATIENCE = 300_000  # ms


class Waited(NamedTuple):
    """Seconds of a command.

    Args:
        cold: With an empty cache.
        warm: With a filled one, the median of its turns.
    """

    cold: float
    warm: float


class Sweep(NamedTuple):
    """Seconds of the main study, as its own manifest has them.

    Args:
        compiling: Of the compiler.
        running: Of the loops.
    """

    compiling: float
    running: float


@contextmanager
def empty_cache() -> Iterator[dict[str, str]]:
    """The environment of a process whose caches are empty at first, and stay."""
    with TemporaryDirectory() as folder:
        yield environment({"XDG_CACHE_HOME": folder})


def seconds(words: tuple[str, ...], variables: dict[str, str]) -> tuple[float, Sweep | None]:
    """Seconds of a process of Python; of a sweep also what its manifest tells.

    Raises:
        RuntimeError: it failed.
    """
    with TemporaryDirectory() as folder:
        began = time.perf_counter()
        done = subprocess.run([sys.executable, *words], env=variables, cwd=folder, capture_output=True, text=True)
        took = time.perf_counter() - began
        if done.returncode:
            raise RuntimeError(f"{' '.join(words)} ended with status {done.returncode}: {done.stderr}")
        manifests = list(Path(folder).glob("results/*/manifest.json")) if "sweep" in words else []
        times = [json.loads(file.read_text())["times"] for file in manifests]
        return took, Sweep(times[0]["compile_seconds"], times[0]["run_seconds"]) if times else None


def first_picture(browser: Browser, variables: dict[str, str]) -> float:
    """Seconds from the command to the figure of all draws in Chromium."""
    began = time.perf_counter()
    command = [sys.executable, "-m", "dssc_jax.cli", *EXPLORED]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=variables) as server:
        assert server.stdout is not None
        page = browser.new_page()
        page.set_default_timeout(PATIENCE)
        try:
            page.goto(server.stdout.readline().strip())
            page.locator("canvas").first.wait_for()
            return time.perf_counter() - began
        finally:
            page.close()
            server.terminate()


def measured(browser: Browser) -> tuple[dict[str, Waited], tuple[Sweep, Sweep], float, float]:
    """Every command, the sweep's manifest cold and warm, seconds of the help and of the imports."""
    told: dict[str, list[float]] = {}
    sweeps: list[Sweep] = []
    with empty_cache() as variables:
        for turn in range(1 + TURNS):
            for command in COMMANDS:
                took, sweep = seconds(("-m", "dssc_jax.cli", *command), variables)
                told.setdefault(" ".join(command), []).append(took)
                sweeps += [sweep] if sweep else []
            told.setdefault(" ".join(EXPLORED[:2]) + ", to its first figure", []).append(
                first_picture(browser, variables)
            )
            print(f"turn {turn} of {TURNS}: {', '.join(f'{times[-1]:.1f} s' for times in told.values())}", flush=True)
        help_ = median(seconds(("-m", "dssc_jax.cli", "--help"), variables)[0] for _ in range(TURNS))
        imports = median(seconds(("-c", IMPORTS), variables)[0] for _ in range(TURNS))
    waited = {name: Waited(times[0], median(times[1:])) for name, times in told.items()}
    return waited, (sweeps[0], sweeps[-1]), help_, imports


def main() -> None:
    """Measure and write the part."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
        waited, (cold, warm), help_, imports = measured(browser)
        browser.close()
    lines = ["| command | with an empty cache | again |", "|---|---|---|"]
    lines += [f"| `dssc-jax {name}` | {both.cold:.1f} s | {both.warm:.1f} s |" for name, both in waited.items()]
    lines += [
        f"| `dssc-jax --help` | | {help_:.2f} s |",
        f"| imports of a sweep, mostly JAX, pandas and SciPy | | {imports:.1f} s |",
        "",
        f"Of the sweep's seconds, {cold.compiling:.1f} and {warm.compiling:.1f} s are compiling, and "
        f"{cold.running:.1f} and {warm.running:.1f} s running 73,728 loops of 60 s. Medians of {TURNS} turns with a "
        "filled cache, in which the commands alternate. `python -m benchmarks.speed.waiting` regenerates this part.",
    ]
    put("waiting", "\n".join(lines).replace(", to its first figure`", "`, to its first figure"), PAGE)


if __name__ == "__main__":
    main()
