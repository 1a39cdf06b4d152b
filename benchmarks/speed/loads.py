"""``python -m benchmarks.speed.loads``: whether copies of the same machine code run at the same rate; in docs/lanes.md.

The code of a loop is loaded many times into one process, and each copy runs the same lanes on one core, in turns. A
copy that is slow in every turn is moved to other physical pages: its memory is given back to the system and filled
again, so that its addresses stay what they are. Linux only.
"""

import argparse
import ctypes
import mmap
import time
from pathlib import Path
from statistics import median
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.page import put
from benchmarks.speed.workloads import Case, study_of
from dssc_jax.core.numerics import arithmetic
from dssc_jax.engine.batching import lane_of_study, values_of_draws
from dssc_jax.lanes.interface import ENTRY_POINT, stored_type
from dssc_jax.lanes.llvm import machine
from dssc_jax.lanes.traced_lanes import TracedLanes

PAGE = Path(__file__).parents[2] / "docs" / "lanes.md"
LOOPS = (Case("uav", "euler", 32), Case("uav", "rk4", 64))
DRAWS, DURATION = 512, 4.0  # lanes, and seconds of flight [s]
TURNS = 5
SLOW = 0.75  # of the median rate: below it in every turn, a copy is slow
REFILLS = 4  # of the pages of a slow copy, until it is fast
DISCARD = 4  # MADV_DONTNEED
READ_RUN, READ_WRITE_RUN = 5, 7  # protections of memory


class Loop(NamedTuple):
    """A loop's machine code and its lanes.

    Args:
        code: An object file.
        inputs: Columns of the lanes.
        outputs: Columns of their results.
        width: Lanes of a vector.
        steps: Of all lanes together.
    """

    code: bytes
    inputs: list[np.ndarray]
    outputs: list[np.ndarray]
    width: int
    steps: int

    def rate(self, copy: machine.LoadedCode) -> float:
        """Steps of a lane in a second of the processor, by a copy of the code."""
        began = time.process_time()
        copy.start(self.inputs, self.outputs, DRAWS, self.width, 1)()
        return self.steps / (time.process_time() - began)


def loop_of(case: Case) -> Loop:
    """The machine code of a case, and the draws that it runs."""
    study = study_of(case, DRAWS, DURATION)
    with arithmetic(study.config.loop.precision):
        values = {name: jnp.asarray(column) for name, column in values_of_draws(study, slice(0, DRAWS)).items()}
        arguments = (values, jnp.arange(DRAWS, dtype=jnp.uint32))
        scalars = jax.tree.map(lambda column: column[0], arguments)
        lanes = TracedLanes(lane_of_study(study, axis_name=None), scalars, None, strict=False)
    signature = lanes.signature
    columns = zip(jax.tree.leaves(arguments), signature.inputs, strict=True)
    inputs = [np.ascontiguousarray(np.asarray(column, dtype)) for column, dtype in columns]
    outputs = [np.empty(DRAWS, stored_type(dtype)) for dtype, _ in signature.outputs]
    return Loop(machine.object_code(lanes.text), inputs, outputs, signature.width, DRAWS * study.loop.steps)


def region_of(address: int) -> tuple[int, int]:
    """Begin and size of the mapping of memory that holds an address."""
    for line in Path("/proc/self/maps").read_text().splitlines():
        begin, end = (int(part, 16) for part in line.split()[0].split("-"))
        if begin <= address < end:
            return begin, end - begin
    raise LookupError(hex(address))


def refill(copy: machine.LoadedCode, pages: int) -> mmap.mmap:
    """Put a copy on other physical pages at the same addresses; the memory returned holds pages back meanwhile."""
    begin, size = region_of(copy.address(ENTRY_POINT))
    library = ctypes.CDLL(None, use_errno=True)
    place = ctypes.c_void_p(begin)
    content = ctypes.string_at(begin, size)
    if library.mprotect(place, ctypes.c_size_t(size), READ_WRITE_RUN) != 0:
        raise OSError(ctypes.get_errno(), "mprotect")
    library.madvise(place, ctypes.c_size_t(size), DISCARD)
    held = mmap.mmap(-1, mmap.PAGESIZE * pages)
    held.write(b"x" * len(held))
    ctypes.memmove(begin, content, size)
    library.mprotect(place, ctypes.c_size_t(size), READ_RUN)
    return held


class Copies(NamedTuple):
    """What copies of the same code did.

    Args:
        rates: The best rate of each copy, as a share of the median copy's, sorted.
        moved: Rates of the slow copies after their pages were filled again.
        million: The median copy's rate [million steps of a lane per second].
    """

    rates: list[float]
    moved: list[float]
    million: float


def measured(case: Case, count: int) -> Copies:
    """Load the code of a case many times, and measure every copy."""
    loop = loop_of(case)
    copies = [machine.LoadedCode(loop.code) for _ in range(count)]
    for copy in copies:
        loop.rate(copy)
    best = np.max([[loop.rate(copy) for copy in copies] for _ in range(TURNS)], axis=0)
    middle = median(best)
    moved = []
    held = []
    for place in np.flatnonzero(best < SLOW * middle):
        rate = 0.0
        for turn in range(REFILLS):
            held.append(refill(copies[place], 16 * (turn + 1)))
            rate = max(loop.rate(copies[place]) for _ in range(1 + TURNS))
            if rate >= SLOW * middle:
                break
        moved.append(rate / middle)
    return Copies(sorted(best / middle), moved, middle / 1e6)


def row(case: Case, found: Copies) -> str:
    """A row of the table."""
    slow = [rate for rate in found.rates if rate < SLOW]
    moved = ", ".join(f"{rate:.2f}" for rate in found.moved)
    cells = [
        case.text,
        f"{found.million:.3g}",
        f"{len(slow)} of {len(found.rates)}",
        ", ".join(f"{rate:.2f}" for rate in slow) or "-",
        moved or "-",
    ]
    return f"| {' | '.join(cells)} |"


def main() -> None:
    """Measure and write the part of the page."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.speed.loads")
    parser.add_argument("--copies", type=int, default=100, help="of the code of each loop (100)")
    options = parser.parse_args()
    columns = (
        "",
        "million steps/s",
        f"copies below {SLOW:g} of it",
        "their rates",
        "after the pages were filled again",
    )
    lines = [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]
    for case in LOOPS:
        lines.append(row(case, measured(case, options.copies)))
        print(lines[-1], flush=True)
    put("loads", "\n".join(lines), PAGE)


if __name__ == "__main__":
    main()
