"""``make bench``: our engine against other programs for the same loops, and how it grows, into docs/performance.md."""

import argparse
import os

from benchmarks.speed import narrow, page, scaling
from benchmarks.speed.contest import OURS, SIZES, C, available, contest
from benchmarks.speed.workloads import CASES, Case
from dssc_jax.lanes.llvm import machine

QUICK = (Case("uav"), Case("uav", precision=32), Case("axis"))


def main() -> None:
    """Measure, tell the terminal what comes, and write the page at the end."""
    parser = argparse.ArgumentParser(description=__doc__, prog="python -m benchmarks.speed")
    parser.add_argument("--quick", action="store_true", help="three loops in three rounds; leaves the page alone")
    parser.add_argument("--with-c", action="store_true", help="ours and C alone, for the page's part on this processor")
    parser.add_argument(
        "--narrow", action="store_true", help="with --with-c, without AVX-512 on a processor that has it"
    )
    parser.add_argument(
        "--processor", action="store_true", help="with --with-c, by processor time, where other programs run, too"
    )
    parser.add_argument("--rounds", type=int, default=9, help="turns of each program (9)")
    options = parser.parse_args()
    if (options.narrow or options.processor) and not options.with_c:
        parser.error("--narrow and --processor need --with-c")
    if options.with_c and machine.vector_bits() not in page.WITH_C:
        parser.error(f"the page has no part for vectors of {machine.vector_bits()} bits")
    if options.narrow:
        os.environ[narrow.VARIABLE] = "1"  # for the contenders' processes
    rounds = 3 if options.quick else options.rounds
    programs = [OURS, C] if options.with_c else available()
    contests = {}
    for case in QUICK if options.quick else CASES:
        clock = "processor" if options.processor else "seconds"
        contests[case] = contest(case, programs, *SIZES[case.loop], rounds, at_once=options.quick, clock=clock)
        print(page.brief(case, contests[case]), flush=True)
    if options.with_c:
        page.write_with_c(contests, options.narrow, options.processor)
    if options.quick or options.with_c:
        return
    print("growth, a mission", flush=True)
    page.write(page.Everything(contests, scaling.curves(), scaling.mission()))


if __name__ == "__main__":
    main()
