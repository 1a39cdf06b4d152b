"""``python -m benchmarks.fuzz``: random programs of jax.lax as machine code of lanes; writes a part of docs/lanes.md.

Workers that a program ends are started anew, and the program is found by halving its unit.
"""

import argparse
import json
import random
import sys
import time
from collections import Counter
from pathlib import Path

from benchmarks.fuzz.crew import Crew
from benchmarks.fuzz.generate import NAMES, SINGLES
from benchmarks.fuzz.values import TYPES
from benchmarks.page import put

PAGE = Path(__file__).parents[2] / "docs" / "lanes.md"
UNIT_OF_SINGLES, UNIT = 24, 40
XLA_EVERY = 60


def units(programs: int, first: int, with_singles: bool) -> list[tuple[list[int], bool]]:
    """Seeds of units, and whether plain XLA runs them, too."""
    singles = range(SINGLES) if with_singles else range(0)
    many = range(SINGLES + first, SINGLES + first + programs)
    parts = [list(singles[i : i + UNIT_OF_SINGLES]) for i in range(0, len(singles), UNIT_OF_SINGLES)]
    parts += [list(many[i : i + UNIT]) for i in range(0, len(many), UNIT)]
    work = [(part, number % XLA_EVERY == 0) for number, part in enumerate(parts)]
    random.Random(first).shuffle(work)
    return work


def page(counts: Counter[str], operations: Counter[str], minutes: float) -> str:
    """The part of the page."""
    share = counts["unclear results"] / max(1, counts["results"] + counts["unclear results"])
    return (
        f"{counts['programs']:,} programs of 1 to 12 operations of `jax.lax`, {counts['alone']:,} of them of a single\n"
        f"one of {len(NAMES)} in one of {len(TYPES)} types, in fast and in strict arithmetic:\n\n"
        "| programs | compiled | fell back | of these without a warning | wrong | crashed |\n"
        "| --- | --- | --- | --- | --- | --- |\n"
        f"| {counts['programs']:,} | {counts['compiled']:,} | {counts['fell back']:,} | {counts['without warning']} | "
        f"{counts['wrong']} | {counts['crashed']} |\n\n"
        f"{len(operations)} kinds of operations occurred. {counts['results']:,} results were compared; {share:.1%} of\n"
        "all depend on the rounding that fast arithmetic leaves open, or on NaN's bits, and say nothing.\n"
        "Integers, truth values and strict arithmetic must agree in every bit, elementary functions within the\n"
        f"units in the last place that `benchmarks/fuzz/arithmetic.py` lists. Of {counts['with xla']:,}\n"
        f"programs that plain XLA ran, too, {counts['xla differs']} contradicted the referee, mostly in\n"
        "indices beyond 31 bits, which XLA truncates, and subnormal numbers, which it sets to 0. Plain XLA alone\n"
        f"ended its process in {counts['ended by xla']} programs: as it compiles, it divides integers by zero.\n"
        f"It took {minutes:.0f} minutes."
    )


def main() -> int:
    options = argparse.ArgumentParser()
    options.add_argument("--programs", type=int, default=90_000, help="random programs beside those of one operation")
    options.add_argument("--first", type=int, default=0, help="number of the first random program")
    options.add_argument("--no-singles", action="store_true", help="leave out the programs of one operation")
    options.add_argument("--workers", type=int, default=2)
    options.add_argument("--minutes", type=float, default=None, help="begin no further unit after this time")
    options.add_argument("--findings", type=Path, default=None, help="a file for what is found, one JSON a line")
    options.add_argument("--page", action="store_true", help="write the part of docs/lanes.md")
    chosen = options.parse_args()
    work = units(chosen.programs, chosen.first, not chosen.no_singles)
    began = time.perf_counter()
    crew = Crew(work, chosen.workers, chosen.minutes)
    crew.run()
    minutes = (time.perf_counter() - began) / 60.0
    for name, count in crew.refused.most_common(400):
        print(f"{count:7} refused: {name}")
    for name, count in sorted(crew.counts.items()):
        print(f"{count:9,} {name}")
    missing = [name for name in NAMES if name not in crew.operations and name != "moved"]
    print(f"{minutes:.1f} minutes; {len(crew.operations)} operations; not covered: {', '.join(missing) or 'none'}")
    if chosen.findings:
        chosen.findings.write_text("".join(f"{json.dumps(finding)}\n" for finding in crew.findings))
    for finding in crew.findings[:20]:
        print(
            f"\n{finding['kind']} ({finding['mode']}), seed {finding['seed']}: {finding['said']}\n{finding['program']}"
        )
    if chosen.page:
        put("fuzz", page(crew.counts, crew.operations, minutes), PAGE)
    bad = sum(crew.counts[name] for name in ("wrong", "crashed", "without warning"))
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
