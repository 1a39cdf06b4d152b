"""Other simulators beside our engine, into a part of docs/performance.md: ``python -m benchmarks.speed.others PYTHON``.

Every simulator runs in a Python of its users, under ``simulators.py``; our engine and they take turns.
"""

import argparse
import json
import subprocess
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import NamedTuple

from benchmarks.page import put
from benchmarks.speed.contest import OURS, ROOT, SIZES, Worker
from benchmarks.speed.workloads import Case

PAGE = ROOT / "docs" / "performance.md"
CASES = (Case("uav"), Case("uav", precision=32))


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


def simulators(python: Path) -> list[Other]:
    """Every simulator that this Python has.

    Raises:
        CalledProcessError: this Python cannot run the program.
    """
    program = Path(__file__).with_name("simulators.py")
    with TemporaryDirectory() as folder:  # MuJoCo leaves a log where it runs
        done = subprocess.run([python.absolute(), program], capture_output=True, text=True, check=True, cwd=folder)
    return parsed(done.stdout)


def parsed(text: str) -> list[Other]:
    """The simulators of which ``simulators.py`` tells."""
    return [Other(**json.loads(line)) for line in text.splitlines() if line.startswith("{")]


def measured(pythons: list[Path], rounds: int) -> tuple[list[list[float]], list[list[Other]]]:
    """Rates of our cases, and all simulators, round by round."""
    ours: list[list[float]] = []
    others: list[list[Other]] = []
    with ExitStack() as stack:
        folder = stack.enter_context(TemporaryDirectory())
        workers = [stack.enter_context(Worker(OURS, case, *SIZES["uav"], folder)) for case in CASES]
        steps = [worker.answer()["steps"] for worker in workers]
        for _ in range(rounds):
            ours.append([count / worker.ask("run")["seconds"] for count, worker in zip(steps, workers, strict=True)])
            others.append([other for python in pythons for other in simulators(python)])
            print(ours[-1], others[-1], flush=True)
    return ours, others


def row(name: str, rates: tuple[float, ...], difference: str) -> str:
    """A row of the table, in millions of steps a second."""
    return f"| {name} | {median(rates) / 1e6:.3g} | {difference} |"


def main() -> None:
    """Measure and write the part."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.speed.others")
    parser.add_argument("pythons", nargs="+", type=Path, metavar="PYTHON", help="a Python that has a simulator")
    parser.add_argument("--rounds", type=int, default=3, help="turns of each simulator (3)")
    options = parser.parse_args()
    ours, others = measured(options.pythons, options.rounds)
    lines = ["| simulator | million steps per second | what differs |", "|---|---|---|"]
    for case, rates in zip(CASES, zip(*ours, strict=True), strict=True):
        lines.append(row(f"dssc_jax, {case.text}", rates, "the contest's vehicle, with all that the others lack"))
    for turns in zip(*others, strict=True):
        rates = tuple(turn.rate for turn in turns)
        lines.append(row(f"{turns[0].name} {turns[0].version}", rates, turns[0].difference))
    lines += ["", f"Medians of turns ({options.rounds}), on all cores where a cell does not say one."]
    put("simulators", "\n".join(lines), PAGE)


if __name__ == "__main__":
    main()
