"""``python -m benchmarks.limits``: how far the loops are from the processor's limit; a part of docs/performance.md.

It takes a processor with AVX2 or AVX-512, objdump, and llvm-mca (Debian's package ``llvm``), whose model of the
processor gives the bound of the ports and the cycles with latencies. Cycles are counted by a chain of additions, each
of which takes one, in turn with the loop.
"""

import ctypes
import re
import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import jax
import jax.numpy as jnp
import llvmlite.binding as llvm
import numpy as np

from benchmarks.page import put
from benchmarks.speed.workloads import CASES, Case, study_of
from dssc_jax.core.numerics import arithmetic
from dssc_jax.engine.batching import lane_of_study, values_of_draws
from dssc_jax.lanes.interface import stored_type
from dssc_jax.lanes.llvm import machine
from dssc_jax.lanes.traced_lanes import TracedLanes

PAGE = Path(__file__).parents[1] / "docs" / "performance.md"
MODEL = "znver3"
"""The newest of AMD's that llvm-mca 14 knows; Intel's need another name."""
LARGE = 2000  # bytes of the smallest loop that can be a sample's
ITERATIONS = 20
ROUNDS = 60
SIZES = {"uav": (256, 4.0), "axis": (1024, 20.0)}
"""Draws, and seconds of flight."""
CHAIN = """
define i64 @chain(i64 %n) {
entry:
  br label %loop
loop:
  %i = phi i64 [ 0, %entry ], [ %next, %loop ]
  %x = phi i64 [ 0, %entry ], [ %y, %loop ]
  %y = call i64 asm sideeffect "ADDS", "=r,0"(i64 %x)
  %next = add i64 %i, 1
  %more = icmp ult i64 %next, %n
  br i1 %more, label %loop, label %done
done:
  ret i64 %y
}
""".replace("ADDS", "addq $$1, $0\\0A" * 100)
"""A hundred additions a turn, each of which waits for the one before."""
TURNS = 100_000


class Body(NamedTuple):
    """The instructions of a sample.

    Args:
        code: The instructions, without jumps.
        size: Bytes.
        loads: Instructions that read memory.
        stores: Those that write it.
    """

    code: list[str]
    size: int
    loads: int
    stores: int


class Limit(NamedTuple):
    """Cycles of a sample of a vector of lanes.

    Args:
        body: The instructions.
        width: Lanes of the vector.
        ports: By the busiest port.
        modelled: With latencies, as the model has them.
        measured: On this processor.
    """

    body: Body
    width: int
    ports: float
    modelled: float
    measured: float


def innermost(code: bytes) -> Body:
    """The last large loop of an object file, that over samples: one sample of a vector of lanes."""
    with TemporaryDirectory() as folder:
        file = Path(folder) / "lanes.o"
        file.write_bytes(code)
        command = ["objdump", "-d", "--no-show-raw-insn", str(file)]
        listing = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    function = listing[listing.index("<lanes>:") :].partition("\n\n")[0]  # other sections count their bytes anew
    found = re.findall(r"^\s+([0-9a-f]+):\t(.*)$", function, re.MULTILINE)
    lines = [(int(address, 16), text.split("#")[0].strip()) for address, text in found]
    loops = []
    for address, text in lines:
        jump = re.match(r"j(?!mp)\w+\s+([0-9a-f]+) <lanes", text)
        if jump and address - int(jump[1], 16) > LARGE:
            loops.append((int(jump[1], 16), address))
    start, end = loops[-1]
    inside = [text for address, text in lines if start <= address <= end and not re.match(r"j|call|nop|ret", text)]
    memory = [text for text in inside if "(" in text and not text.startswith("lea")]
    stores = sum(bool(re.search(r"\([^)]*\)$", text)) for text in memory if text.startswith(("vmov", "mov")))
    return Body([re.sub(r"<[^>]*>", "", text) for text in inside], end - start, len(memory) - stores, stores)


def modelled(body: Body) -> tuple[float, float]:
    """Cycles of a sample by the busiest port, and with latencies."""
    command = ["llvm-mca", f"-mcpu={MODEL}", f"-iterations={ITERATIONS}"]
    text = subprocess.run(command, input="\n".join(body.code), capture_output=True, text=True, check=True).stdout
    values = {name: float(value) for name, value in re.findall(r"^([\w ]+): +([\d.]+)$", text, re.MULTILINE)}
    return values["Block RThroughput"], values["Total Cycles"] / ITERATIONS


class Clock:
    """Counts the processor's cycles by a chain of additions."""

    def __init__(self) -> None:
        machine.target_machine()
        llvm.initialize_native_asmparser()
        self._engine = machine.engine_of(machine.parsed_module(CHAIN))
        self._engine.finalize_object()
        self._chain = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)(self._engine.get_function_address("chain"))

    def cycles_per_second(self) -> float:
        """The frequency at this moment."""
        began = time.process_time()
        cycles = self._chain(TURNS)
        return cycles / (time.process_time() - began)


def limit(case: Case, clock: Clock) -> Limit:
    """Bounds and cycles of a case, on one core."""
    draws, duration = SIZES[case.loop]
    study = study_of(case, draws, duration)
    numbers = values_of_draws(study, slice(0, draws))
    with arithmetic(case.precision):
        number = jax.ShapeDtypeStruct((), jnp.result_type(float))
        arguments = dict.fromkeys(study.laws, number), jax.ShapeDtypeStruct((), jnp.uint32)
        traced = TracedLanes(lane_of_study(study), arguments, None, False)
    signature = traced.signature
    code = machine.object_code(traced.text)
    columns = jax.tree.leaves((numbers, np.arange(draws)))
    inputs = [np.ascontiguousarray(column, dtype) for column, dtype in zip(columns, signature.inputs, strict=True)]
    outputs = [np.empty(draws, stored_type(dtype)) for dtype, _ in signature.outputs]
    loaded = machine.LoadedCode(code)
    frequencies = []
    times = []
    for _ in range(ROUNDS):
        frequencies.append(clock.cycles_per_second())
        began = time.process_time()
        loaded.start(inputs, outputs, draws, signature.width, 1)()
        times.append(time.process_time() - began)
    cycles = min(times) * max(frequencies) * signature.width / (draws * study.loop.steps)
    body = innermost(code)
    return Limit(body, signature.width, *modelled(body), cycles)


def row(case: Case, found: Limit) -> str:
    """A row of the table."""
    body = found.body
    cells = [
        case.text,
        str(found.width),
        f"{len(body.code):,}",
        f"{body.loads:,}",
        f"{body.stores:,}",
        f"{body.size / 1024:.1f}",
        f"{found.ports:,.0f}",
        f"{found.modelled:,.0f}",
        f"{found.measured:,.0f}",
        f"{found.ports / found.measured:.0%}",
        f"{found.modelled / found.measured:.0%}",
    ]
    return f"| {' | '.join(cells)} |"


TEXT = """Cycles of one core for a sample of one vector of lanes. *Ports*: the busiest of the processor's pipes has that
much to do, so no order of the same instructions takes less. *Latencies*: a simulation of the loop, in which an
instruction also waits for its operands, and at most 256 are in flight. Both are llvm-mca's model of Zen 3, which is
too slow for the axis. *Measured* is the fastest of {rounds} turns, because neighbours on the core slow it down.
The shares are the model's cycles over the measured ones.

{table}

Two pipes multiply, also with a sum, compare, choose and divide: they are the bound of the vehicle with RK4. With
Euler's method the path of vectors from and to memory is as busy, since two vectors of lanes share 16 registers. The two
pipes that only add have a quarter as much to do. The remaining cycles are waits. The stages of Runge-Kutta's method
depend on each other; a sample has {roots} roots and {quotients} quotients, of which a single pipe computes one at a
time; a spilled value comes back after four cycles or more. The axis has four vectors of lanes and hardly waits.
Measured cycles contain what is computed ahead for eight samples, and the test for ended draws; the bounds do not.
`python -m benchmarks.limits` regenerates this part."""

COLUMNS = (
    *("", "lanes", "instructions", "loads", "stores", "KiB"),
    *("ports", "latencies", "measured", "share, ports", "share, latencies"),
)


def part() -> str:
    """The part of the page."""
    clock = Clock()
    found = {case: limit(case, clock) for case in CASES}
    rows = [row(case, limit) for case, limit in found.items()]
    table = "\n".join([f"| {' | '.join(COLUMNS)} |", "|---" * len(COLUMNS) + "|", *rows])
    vehicle = found[Case("uav")].body.code
    counts = {name: sum(line.startswith(f"v{name}") for line in vehicle) for name in ("sqrt", "div")}
    return TEXT.format(rounds=ROUNDS, table=table, roots=counts["sqrt"], quotients=counts["div"])


def main() -> None:
    """Write the table."""
    put("limits", part(), PAGE)


if __name__ == "__main__":
    main()
