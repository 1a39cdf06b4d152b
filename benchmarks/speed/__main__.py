"""``python -m benchmarks.speed``: our engine against other programs for the same loops, into docs/performance.md."""

import argparse
import sys

from benchmarks.speed.contest import NUMBA, OURS, PLAIN, SIZES, C, Measured, available, contest, quartiles, ratios
from benchmarks.speed.workloads import Case
from dssc_jax.console import machine
from dssc_jax.xla import usable_cores

PAGE = "docs/performance.md"
QUICK = (Case("uav", "rk4", 64), Case("uav", "rk4", 32), Case("axis", "rk4", 64))
CASES = (*(Case(loop, method, bits) for loop in SIZES for method in ("rk4", "euler") for bits in (64, 32)),)


def rows(case: Case, found: dict[str, Measured]) -> list[str]:
    """A case's rows: rate and quartiles, compiling, first result, memory, and our rate over theirs."""
    ours, lines = found[OURS.name], []
    for name, measured in found.items():
        low, middle, high = quartiles(measured.rates)
        share = "" if measured is ours else f"{quartiles(ratios(ours, measured))[1]:.2f}"
        cells = (f"{case.text}", name, f"{middle / 1e6:.3g}", f"{low / 1e6:.3g} to {high / 1e6:.3g}", share)
        costs = (f"{measured.compile_seconds:.1f}", f"{measured.ready:.1f}", f"{measured.peak:.2f}")
        lines.append("| " + " | ".join((*cells, *costs)) + " |")
    return lines


def page(table: list[str], rounds: int) -> str:
    """The whole page."""
    head = (
        "| loop | program | rate [10^6/s] | quartiles | ours over it | compiling [s] | first result [s] | memory [GB] |"
    )
    return f"""# Performance

How fast the closed loops are, beside other programs that compute the same. The rate is that of lane-steps: one draw
advanced by one control sample of 5 ms with one substep. All programs use both cores, run the same drawn vehicles or
plants, and their metrics are compared with ours before a time counts. They take turns, {rounds} rounds, in one run;
rates are medians, ratios are medians of the rounds' ratios.

{head}
|---|---|---|---|---|---|---|---|
{chr(10).join(table)}

* **{PLAIN.name}** is the form that one would write first, without this package's compiler flags, tiles and shared values.
* **{C.name}** is written by hand for these two loops: vectors of 512 bits where the machine has them, two threads,
  reciprocals hoisted, `gcc -O3 -march=native`. **{NUMBA.name}** is one draw's loop in plain Python, compiled, `prange` over draws.
  **NumPy** is the loop over time with arrays of all draws.
* uav is the full vehicle with four DSSC channels; axis is one degree of freedom with a lag of second order. Both measure
  rms and largest error and the command's total variation on every channel.
* The trigonometric functions that replace the compiler's own, `numerics.atan` and `atan2`, are within 2 ulp in both
  precisions (`tests/test_numerics.py`).

Written by `make bench` on {machine()}.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="three loops, few rounds; prints, and leaves the page alone"
    )
    parser.add_argument("--rounds", type=int, default=9)
    options = parser.parse_args()
    rounds = 3 if options.quick else options.rounds
    table = []
    for case in QUICK if options.quick else CASES:
        draws, duration = SIZES[case.loop]
        found = contest(case, available(), draws, duration, rounds, at_once=options.quick)
        table += rows(case, found)
        print("\n".join(rows(case, found)), file=sys.stderr, flush=True)
    if not options.quick:
        with open(PAGE, "w", encoding="utf-8") as target:
            target.write(page(table, rounds))
    print(f"{len(table)} programs timed on {usable_cores()} cores")


if __name__ == "__main__":
    main()
