"""``python -m benchmarks.flight PART..``: the controllers in C against the strict analysis, bit by bit.

Parts: ``bits`` (every kind of controller, row and sampled form, on x86-64 by gcc and clang and on 64-bit ARM under
qemu, and on 32-bit ARM in float32, with few samples in float64 too; --draws and --samples of each), ``cost``
(operations, memory and cycles of a step), ``hostile`` (a million hostile samples for every controller, with
sanitizers).
Each writes its part of docs/flight.md. The recordings are never stored: they are piped into all benches at once.
"""

import argparse
import queue
import re
import subprocess
import tempfile
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax.flight_code.cost import parameter_bytes, state_bytes, step_cost
from dssc_jax.flight_code.folder import FlightFolder
from tests.flight_code.test_code import cases, table

PAGE = Path(__file__).parents[1] / "docs" / "flight.md"
BENCHES = {
    "x86-64, gcc": ("bench", []),
    "x86-64, clang": ("bench-clang", []),
    "aarch64 (qemu)": ("bench-arm64", ["qemu-aarch64", "-L", "/usr/aarch64-linux-gnu"]),
    "armhf (qemu)": ("bench-armhf", ["qemu-arm", "-L", "/usr/arm-linux-gnueabihf"]),
}
EMULATED = "armhf (qemu)"  # qemu emulates float64 there: minutes for more samples than these
MOST_EMULATED = 1_000_000
WAITING = 8  # parts of a recording that wait for a bench
DURATION = 100.0  # s, 10,000 samples


class Bits(NamedTuple):
    """What the benches say of one controller.

    Args:
        name: The controller.
        precision: Bits of a number.
        samples: Draws times samples.
        differing: Values that differ, by bench.
        compared: Values compared by each bench.
    """

    name: str
    precision: int
    samples: int
    differing: dict[str, int]
    compared: int


def studies(precision: int) -> Iterator[tuple[str, dj.Study]]:
    """A study of every kind of controller, row and sampled form, with 10,000 samples."""
    for case in cases():
        controller, differentiator, _ = case.values
        content: dict[str, Any] = table(controller, differentiator, precision)
        content["loop"]["duration"] = DURATION
        yield f"{case.id} ({differentiator['kind']})", dj.Study.from_table(content)


def written(folder: FlightFolder, place: Path) -> None:
    """Write the texts of a folder."""
    for name, text in folder.texts().items():
        (place / name).write_text(text)


def benches_of(precision: int, samples: int) -> dict[str, tuple[str, list[str]]]:
    """The benches that run so many samples in a precision, with the program that runs each."""
    emulated = precision == 32 or samples <= MOST_EMULATED
    return {label: command for label, command in BENCHES.items() if emulated or label != EMULATED}


class Feeder(threading.Thread):
    """Writes the parts of a recording into one bench, so that a slow bench does not hold up the others."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        super().__init__(daemon=True)
        self.parts: queue.Queue[bytes | None] = queue.Queue(WAITING)
        self._process = process
        self.start()

    def run(self) -> None:
        """Write until None comes."""
        assert self._process.stdin is not None
        while (part := self.parts.get()) is not None:
            self._process.stdin.write(part)


def bits_of_study(name: str, study: dj.Study, draws: int, samples: int) -> Bits:
    """Pipe the recording of a study into all benches."""
    with tempfile.TemporaryDirectory() as place:
        folder = FlightFolder(study.override({"draws": max(draws, study.config.draws)}))
        written(folder, Path(place))
        benches = benches_of(study.config.loop.precision, draws * samples)
        subprocess.run(
            ["make", "-j2", *(bench for bench, _ in benches.values())], cwd=place, check=True, capture_output=True
        )
        running = {
            label: subprocess.Popen(
                [*runner, f"./{bench}", "-"], cwd=place, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=False
            )
            for label, (bench, runner) in benches.items()
        }
        feeders = [Feeder(process) for process in running.values()]
        for part in folder.recording(draws, samples):
            for feeder in feeders:
                feeder.parts.put(part)
        for feeder in feeders:
            feeder.parts.put(None)
        counts = {}
        for feeder, (label, process) in zip(feeders, running.items(), strict=True):
            feeder.join()
            printed = process.communicate()[0].decode()
            found = re.search(r"^(\d+) of (\d+) values differ", printed, re.MULTILINE)
            assert found is not None, printed
            counts[label] = int(found[1]), int(found[2])
            print(f"{name}, float{study.config.loop.precision}, {label}: {printed.strip()}", flush=True)
    compared = {total for _, total in counts.values()}
    assert len(compared) == 1
    differing = {label: wrong for label, (wrong, _) in counts.items()}
    return Bits(name, study.config.loop.precision, draws * samples, differing, compared.pop())


def bits(draws: int, samples: int, part: str) -> str:
    """Compare every controller and say what differed."""
    measured = [
        bits_of_study(name, study, draws, samples)
        for precision in (64, 32)
        for name, study in studies(precision)
        if part in name
    ]
    lines = [f"| {draws:,} draws of {samples:,} samples | " + " | ".join(BENCHES) + " |"]
    lines.append("|---" * (len(BENCHES) + 1) + "|")
    for precision in (64, 32):
        chosen = [result for result in measured if result.precision == precision]
        total = sum(result.compared for result in chosen)
        wrong = (
            f"{sum(result.differing[label] for result in chosen)} of {total:,}"
            if label in benches_of(precision, draws * samples)
            else "-"
            for label in BENCHES
        )
        lines.append(f"| float{precision}, {len(chosen)} controllers | " + " | ".join(wrong) + " |")
    names = ", ".join(result.name for result in measured if result.precision == 64)
    return "\n".join([*lines, "", f"Values that differ, of the values compared. The controllers: {names}."])


def cost() -> str:
    """Operations, memory and cycles of a step of every controller in float64."""
    lines = [
        "| controller (differentiator) | operations | quotients, roots | longest chain | state, parameters [bytes] "
        "| stack [bytes] | cycles, least and mean |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, study in studies(64):
        with tempfile.TemporaryDirectory() as place:
            folder = FlightFolder(study)
            written(folder, Path(place))
            (controller,) = folder.code.controllers
            spent = step_cost(controller)
            slow = sum(spent.operations.get(operation, 0) for operation in ("div", "sqrt"))
            stack = subprocess.run(["make", "stack"], cwd=place, check=True, capture_output=True, text=True).stdout
            used = re.findall(r"_step\s+(\d+)", stack)[0]
            ran = subprocess.run(["make", "cycles"], cwd=place, check=True, capture_output=True, text=True).stdout
            fastest, mean = re.findall(r"least (\d+), mean (\d+)", ran)[0]
        row = (name, sum(spent.operations.values()), slow, spent.chain,
               f"{state_bytes(controller)}, {parameter_bytes(controller)}", used, f"{fastest}, {mean}")  # fmt: skip
        lines.append("| " + " | ".join(map(str, row)) + " |")
    return "\n".join(lines)


def hostile(count: int = 1_000_000) -> str:
    """Hostile samples for every controller, with sanitizers."""
    lines = ["| with sanitizers | hostile samples | with a flag | with a wrong flag |", "|---|---|---|---|"]
    for precision in (64, 32):
        totals, controllers = [0, 0, 0], 0
        for name, study in studies(precision):
            with tempfile.TemporaryDirectory() as place:
                written(FlightFolder(study), Path(place))
                subprocess.run(["make", "bench-sanitized"], cwd=place, check=True, capture_output=True)
                command = ["./bench-sanitized", "--hostile", str(count)]
                printed = subprocess.run(command, cwd=place, check=True, capture_output=True, text=True).stdout
            match = re.search(r"(\d+) hostile samples.*: (\d+) with a flag, (\d+) with a wrong flag", printed)
            assert match is not None, printed
            print(f"{name}, float{precision}: {printed.strip()}", flush=True)
            totals = [total + int(count) for total, count in zip(totals, match.groups(), strict=True)]
            controllers += 1
        lines.append(f"| float{precision}, {controllers} controllers | " + " | ".join(f"{n:,}" for n in totals) + " |")
    return "\n".join(lines)


def main() -> None:
    """Measure the given parts."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("parts", nargs="+", choices=["bits", "cost", "hostile"])
    parser.add_argument("--draws", type=int, default=1000)
    parser.add_argument("--samples", type=int, default=10_000)
    parser.add_argument("--only", default="", help="controllers whose name has this part")
    options = parser.parse_args()
    for part in options.parts:
        text = (
            bits(options.draws, options.samples, options.only)
            if part == "bits"
            else {"cost": cost, "hostile": hostile}[part]()
        )
        put(part, text, PAGE)


if __name__ == "__main__":
    main()
