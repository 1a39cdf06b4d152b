"""``python -m benchmarks.lanes PART..``: machine code of lanes against plain XLA, and what compiling takes.

Parts: ``packaged`` (deviation over every packaged study), ``random`` (over 200 random studies), ``compiling`` (seconds
from a study to machine code, each in a process of its own without a cache, and the rate of a noisy study), ``vehicle``
(what the vehicle's program and code consist of). Each writes its part of docs/lanes.md.
"""

import json
import os
import re
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import jax
import numpy as np
import xarray as xr

import dssc_jax as dj
from benchmarks.page import put
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Engine, evaluate, lane_of_study, values_of_draws
from dssc_jax.engine.reference import agreement, recompute
from dssc_jax.lanes.llvm import machine
from dssc_jax.lanes.passes.liveness import reachable
from dssc_jax.lanes.passes.negated_states import loops_of
from dssc_jax.lanes.program import Value, all_blocks
from dssc_jax.lanes.program_cache import CACHE_VARIABLE
from dssc_jax.lanes.traced_lanes import TracedLanes
from dssc_jax.study.library import available_studies

PAGE = Path(__file__).parents[1] / "docs" / "lanes.md"
LANES, LONGEST = 16, 20.0  # draws and seconds of each study that is compared
RANDOM = 200
ROUNDS = 5
AXIS, VEHICLE = (Path(__file__).parent / "speed" / f"{name}.toml" for name in ("axis", "uav"))
SENSOR = {"kind": "noisy", "position_std": 0.01, "velocity_std": 0.01}
COMPILED: dict[str, tuple[Path, dict[str, Any]]] = {
    "1-DOF": (AXIS, {}),
    "1-DOF behind a delay of 150 samples": (AXIS, {"unmodelled": {"kind": "delay", "samples": 150, "memory": 150}}),
    "1-DOF behind a transfer function of order 6": (
        AXIS,
        {
            "unmodelled": {
                "kind": "transfer_function",
                "mu": {"loguniform": [0.02, 1.0]},
                "numerator": [1.0],
                "denominator": [1.0, 6.0, 15.0, 20.0, 15.0, 6.0, 1.0],
            }
        },
    ),
    "UAV": (VEHICLE, {}),
    "UAV with noise": (VEHICLE, {"sensor": SENSOR}),
}


class Deviation(NamedTuple):
    """Deviation of a study's lanes from plain XLA.

    Args:
        median: Relative deviation of a lane's most deviating result, the median over the lanes.
        largest: The same, the largest.
        result: Name of the result that deviates most.
        beyond: Lanes beyond what rounding explains.
        differ: Lanes with another outcome.
    """

    median: float
    largest: float
    result: str
    beyond: int
    differ: int


def compared(study: dj.Study) -> Deviation:
    """Compare a study's lanes with plain XLA."""
    count = study.config.draws
    numbers = values_of_draws(study, slice(0, count))
    results = evaluate(Engine(study, count), numbers, np.arange(count))
    plain = recompute(study, (np.arange(count),))
    dataset = xr.Dataset({name: ("draw", column) for name, column in {**numbers, **results}.items()})
    found = agreement(study, dataset, (np.arange(count),), plain)
    differ = int(np.count_nonzero(results["outcome"] != plain["outcome"]))
    return Deviation(
        float(np.median(found.deviation)),
        float(found.deviation.max()),
        str(found.variable[found.deviation.argmax()]),
        int((found.deviation > found.allowed).sum()),
        differ,
    )


def table(header: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table."""
    header = list(header)
    lines = [header, ["---"] * len(header), *map(list, rows)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def shortened(study: dj.Study) -> dj.Study:
    """A study with few draws, and short if its windows and events allow that."""
    few = study.override({"draws": LANES})
    try:
        return few.override({"loop.duration": min(study.config.loop.duration, LONGEST)})
    except ConfigError:
        return few


def packaged() -> str:
    """Every packaged study, its first point."""
    rows = []
    for name, path in available_studies().items():
        study = shortened(dj.Study.load(path).without_sweep())
        found = compared(study)
        sizes = f"{found.median:.1g}", f"{found.largest:.1g}"
        rows.append([f"`{name}`", *sizes, f"`{found.result}`", str(found.beyond), str(found.differ)])
        print(*rows[-1], flush=True)
    header = ["study", "median", "largest", "of the result", "lanes beyond rounding", "outcomes that differ"]
    return (
        f"Relative deviation of a lane's results from those of plain XLA, {LANES} draws, of {LONGEST:g} s where the\n"
        "study allows it. A lane is beyond rounding if it deviates by more than a hundred times what a change of its\n"
        "numbers' last bits does. The super-twisting algorithm chatters around sigma = 0, where its largest\n"
        "`sampling_ratio` depends on the last bits.\n\n" + table(header, rows)
    )


def random_ones() -> str:
    """Random studies of all kinds of parts."""
    from tests.test_programs import random_studies

    deviations, beyond, differ, lanes = [], 0, 0, 0
    for number, parts in enumerate(random_studies(seed=1, count=RANDOM)):
        study = dj.Study.from_table(parts)
        found = compared(study)
        deviations.append(found.largest)
        beyond, differ, lanes = beyond + found.beyond, differ + found.differ, lanes + study.config.draws
        if found.beyond or found.differ:
            print(number, found, parts, flush=True)
    return (
        f"{RANDOM} random studies of {lanes:,} draws in all, every kind of controller, plant, reference, sensor,\n"
        "differentiator, unmodelled dynamics and disturbance among them:\n"
        f"{beyond} lanes deviate from plain XLA by more than rounding explains, {differ} have another outcome.\n"
        f"Of the studies' largest relative deviations the median is {median(deviations):.1g}, and\n"
        f"{sum(value < 1e-9 for value in deviations)} are below 1e-9."
    )


def seconds_to_compile(name: str) -> float:
    """Seconds from a study to machine code, tracing included."""
    path, changes = COMPILED[name]
    study = dj.Study.load(path).without_sweep().override({"draws": 64, **changes})
    with jax.enable_x64(True):
        jax.block_until_ready(jax.numpy.zeros(1))
        engine = Engine(study, 64)
        began = time.perf_counter()
        engine.compiled()
        return time.perf_counter() - began


def compiling() -> str:
    """Seconds of compilation in fresh processes, and the rate with noise over that without."""
    rows = []
    for name in COMPILED:
        command = [sys.executable, "-m", "benchmarks.lanes", "one", name]
        own = {**os.environ, CACHE_VARIABLE: "off"}
        runs = [subprocess.run(command, env=own, capture_output=True, text=True, check=True) for _ in range(3)]
        rows.append([name, f"{median(json.loads(run.stdout) for run in runs):.2f}"])
        print(*rows[-1], flush=True)
    return (
        "From a study to machine code in a fresh process without a cache, median of 3:\n\n"
        + table(["loop", "seconds"], rows)
        + f"\n\nThe vehicle with a noisy sensor advances at {noisy_share():.2f} of the rate without noise: each draw\n"
        f"makes its own random numbers, the same bits as `jax.random`. Vectors have {machine.vector_bits()} bits."
    )


def noisy_share() -> float:
    """Rate of the vehicle with noise over that without, interleaved, median of :data:`ROUNDS`."""
    quiet = dj.Study.load(VEHICLE).override({"draws": 1024, "loop.duration": 10.0})
    values, index = values_of_draws(quiet, slice(0, 1024)), np.arange(1024)
    engines = [Engine(study, 1024) for study in (quiet, quiet.override({"sensor": SENSOR}))]
    seconds: list[list[float]] = [[], []]
    for turn in range(1 + ROUNDS):
        for engine, times in zip(engines, seconds, strict=True):
            began = time.perf_counter()
            engine(values, index)()
            if turn:
                times.append(time.perf_counter() - began)
    return median(one / other for one, other in zip(*seconds, strict=True))


def vehicle() -> str:
    """What the vehicle's program consists of, and its code for one and two hardware vectors of lanes."""
    study = dj.Study.load(VEHICLE)
    with jax.enable_x64(True):
        arguments = dict.fromkeys(study.laws, jax.ShapeDtypeStruct((), np.float64)), jax.ShapeDtypeStruct((), np.uint32)
        one, two = (
            TracedLanes(lane_of_study(study), arguments, n * machine.vector_bits() // 64, False) for n in (1, 2)
        )
    alive, loops = reachable(one.program), loops_of(one.program.body)
    loop = max(loops, key=lambda each: len(each.body.nodes))
    nodes = [node for block in all_blocks(loop.body) for node in block.nodes if id(node) in alive]
    values = [node for node in nodes if isinstance(node, Value)]
    counts = Counter(value.operation for value in values if value.varying)
    lanes = f"{one.signature.width} and {two.signature.width} lanes"
    codes = [instructions(machine.assembly(each.text)) for each in (one, two)]
    on_stack = [sum("(%rsp)" in line for line in code) for code in codes]
    rows = [
        ["operations of a sample that differ between lanes", f"{counts.total():,}"],
        ["products, sums, quotients, roots among them",
         f"{counts['mul']:,}, {counts['add'] + counts['sub']:,}, {counts['div']}, {counts['sqrt']}"],
        ["uniform operations of a sample, 8 samples at a time", str(sum(not value.varying for value in values))],
        ["states of the time loop", str(sum(id(state) in alive for state in loop.states))],
        ["lines of LLVM's text", f"{len(one.text.splitlines()):,}"],
        [f"instructions, {lanes}", " and ".join(f"{len(code):,}" for code in codes)],
        ["of these, read or write the stack", " and ".join(f"{count:,}" for count in on_stack)],
        ["bytes of the object file", " and ".join(f"{len(machine.object_code(each.text)):,}" for each in (one, two))],
    ]  # fmt: skip
    return (
        "`benchmarks/speed/uav.toml`, Runge-Kutta of order 4, float64, 12 metrics, with vectors of\n"
        f"{machine.vector_bits()} bits:\n\n" + table(["", ""], rows)
    )


def instructions(assembly: str) -> list[str]:
    """The instructions of a listing."""
    return [line.strip() for line in assembly.splitlines() if re.match(r"\t[a-z]", line)]


PARTS = {"vehicle": vehicle, "packaged": packaged, "random": random_ones, "compiling": compiling}


def main(arguments: list[str]) -> None:
    """Measure the given parts, or all."""
    if arguments[:1] == ["one"]:
        print(json.dumps(seconds_to_compile(arguments[1])))
        return
    for part in arguments or PARTS:
        put(part, PARTS[part](), PAGE)


if __name__ == "__main__":
    main(sys.argv[1:])
