"""Rates of the kernels on a GPU, beside this machine's processor; their bits; crazyflow."""

import os
import subprocess
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from benchmarks.page import put
from benchmarks.speed.contest import Contender, Measured, contest
from benchmarks.speed.others import Other, parsed
from benchmarks.speed.workloads import CASES, Case, study_of
from dssc_jax.engine.batching import Engine, values_of_draws
from dssc_jax.engine.kernels import KERNEL_VARIABLE, Form, gpu_name

PAGE = Path(__file__).parents[2] / "docs" / "performance.md"
SIZES = {"uav": (262_144, 10.0), "axis": (1_048_576, 40.0)}
"""Draws of the kernels and the processor, and seconds of flight."""
COMPARED = 16_384
"""Draws whose bits are compared."""
WORLDS = (65_536, 524_288)
"""Vehicles of crazyflow; the fastest count is reported."""
ROUNDS = 5

KERNEL = Contender("kernel", "engine", {KERNEL_VARIABLE: Form.GPU})
STRICT_KERNEL = Contender("strict kernel", "engine", {KERNEL_VARIABLE: Form.GPU_STRICT})
PROCESSOR = Contender("processor", "engine", every=2)
STRICT_PROCESSOR = Contender("strict processor", "engine", {KERNEL_VARIABLE: Form.STRICT}, every=5)
GPU_OF_JAX = {"JAX_PLATFORMS": "cuda,cpu"}
XLA = Contender("XLA", "scan", GPU_OF_JAX, every=4)


class Bits(NamedTuple):
    """How many numbers of a case's results differ in any bit between the strict kernel and strict arithmetic here."""

    different: int
    compared: int


def bits(case: Case) -> Bits:
    """Compare all results of a case, bit by bit."""
    study = study_of(case, COMPARED, SIZES[case.loop][1])
    values, index = values_of_draws(study, slice(0, COMPARED)), np.arange(COMPARED)
    kernel, processor = (
        Engine(study, COMPARED, kernel=form)(values, index)() for form in (Form.GPU_STRICT, Form.STRICT)
    )
    different = 0
    for name, column in processor.items():
        same = (column == kernel[name]) | (np.isnan(column) & np.isnan(kernel[name]))
        different += int(np.count_nonzero(~same))
    return Bits(different, sum(column.size for column in processor.values()))


def rate(measured: Measured) -> float:
    """The median rate, in millions of lane-steps a second."""
    return median(value for value in measured.rates if value) / 1e6


def rows(cases: Sequence[Case]) -> list[str]:
    """A row of the table for each case."""
    found = []
    for case in cases:
        fast = contest(case, [KERNEL, PROCESSOR, XLA], *SIZES[case.loop], ROUNDS)
        strict = contest(case, [STRICT_KERNEL, STRICT_PROCESSOR], *SIZES[case.loop], ROUNDS)
        same = bits(case)
        kernel, processor, xla = (rate(fast[contender.name]) for contender in (KERNEL, PROCESSOR, XLA))
        cells = [f"{kernel:,.0f}", f"{rate(strict[STRICT_KERNEL.name]):,.0f}", f"{xla:,.0f}", f"{processor:,.0f}"]
        cells += [f"{kernel / xla:.1f}", f"{kernel / processor:.1f}"]
        cells += [f"{fast[contender.name].compile_seconds:.1f}" for contender in (KERNEL, XLA)]
        cells += [f"{same.different:,} of {same.compared:,}"]
        found.append(f"| {case.text} | {' | '.join(cells)} |")
        print(found[-1], flush=True)
    return found


def crazyflow(python: Path) -> Other:
    """crazyflow on this GPU, with the number of vehicles at which it is fastest."""
    program = Path(__file__).parents[1] / "speed" / "simulators.py"
    found, environment = [], os.environ | GPU_OF_JAX
    for worlds in WORLDS:
        command = [python.absolute(), program, "crazyflow", str(worlds)]
        with TemporaryDirectory() as folder:
            done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=folder, env=environment)
        found += parsed(done.stdout)
        print(found[-1], flush=True)
    return max(found, key=lambda other: other.rate)


def part(python: Path | None) -> str:
    """The part of the page."""
    sizes = " and ".join(f"{draws:,} draws of {seconds:g} s of the {loop}" for loop, (draws, seconds) in SIZES.items())
    lines = [
        f"{gpu_name(Form.GPU)}; {sizes}. Millions of lane-steps a second, with the transfer of draws and results,",
        f"medians of {ROUNDS} turns, of 2 for XLA. *XLA* is `jit(vmap(scan))` on the same GPU. *Compiled* is the time",
        "[s] of trace, LLVM and driver, or of XLA, with empty caches. *Bits* counts the numbers in the results of",
        f"{COMPARED:,} draws that differ between the strict kernel and strict arithmetic on the processor.",
        "`python -m benchmarks.gpu --rates` regenerates this part where there is a GPU.",
        "",
        "| | kernel | strict kernel | XLA | processor | / XLA | / processor | compiled | by XLA | bits |",
        "|---|---|---|---|---|---|---|---|---|---|",
        *rows(CASES),
    ]
    if python:
        other = crazyflow(python)
        counts = ", ".join(f"{worlds:,}" for worlds in WORLDS)
        lines += [
            "",
            f"{other.name} {other.version} on this GPU: {other.rate / 1e6:,.0f} million steps of a vehicle a second",
            f"(the fastest of {counts} vehicles); {other.difference}.",
        ]
    return "\n".join(lines)


def write(python: Path | None) -> None:
    """Measure and write the part."""
    put("gpu", part(python), PAGE)
