"""A process that runs units of programs: it reads them from its standard input, and may not survive one.

Each line of input is a unit: seeds, and whether to compare plain XLA, too; or seeds to run by plain XLA alone. Each
line of output tells a stage that begins, or the counts and findings of the unit.
"""

import json
import sys
import time
from collections import Counter
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np

from benchmarks.fuzz.checking import (
    MODES,
    WIDTHS,
    Entry,
    Gate,
    by_xla,
    checked,
    computed,
    culprit,
    falls_back,
    lanes_of,
    xla_fails,
)  # fmt: skip
from benchmarks.fuzz.generate import SINGLES, generate
from benchmarks.fuzz.program import all_nodes, text
from benchmarks.fuzz.xla import doubts

MOST_FALL_BACKS = 100
"""Refusals whose warnings a process looks at; one of each kind."""

REFUSALS: set[str] = set()


def tell(**message: Any) -> None:
    """A line of output."""
    print(json.dumps(message), flush=True)


class Unit:
    """Runs programs that are compiled together.

    Args:
        seeds: Their seeds.
        with_xla: Whether to compare plain XLA with the referee, too.
    """

    def __init__(self, seeds: Sequence[int], with_xla: bool) -> None:
        self.seeds, self.with_xla = seeds, with_xla
        self.counts: Counter[str] = Counter()
        self.operations: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.findings: list[dict[str, Any]] = []
        self.gate = Gate()

    def run(self) -> None:
        """All programs in both kinds of arithmetic."""
        entries = []
        for seed in self.seeds:
            program = generate(seed)
            if program is None:
                continue
            self.counts["programs"] += 1
            self.counts["alone"] += seed < SINGLES
            self.operations.update({node.operation for node in all_nodes(program)} - {"constant"})
            entry = Entry(seed, program)
            if self.accepted(entry):
                entries.append(entry)
        self.counts["compiled"] += len(entries)
        by_lanes: dict[int, list[Entry]] = {}
        for entry in entries:
            by_lanes.setdefault(lanes_of(entry.seed), []).append(entry)
        for mode, strict in MODES.items():
            for group in by_lanes.values():
                tell(stage=mode)
                self.compare(group, strict, WIDTHS[self.seeds[0] % len(WIDTHS)])
        if self.with_xla:
            tell(stage="xla")
            for entry in entries:
                count = lanes_of(entry.seed)
                try:
                    results = by_xla(entry.program, count)
                except Exception:  # a rule of JAX's vmap fails on some operands, such as bounds of a clamp
                    self.counts["refused by xla"] += 1
                    continue
                self.counts["with xla"] += 1
                found = doubts(entry.program, results, count)
                if found:
                    self.counts["xla differs"] += 1
                    self.find("plain XLA", entry, "xla", found, text(entry.program))

    def accepted(self, entry: Entry) -> bool:
        """Whether the compiler takes a program; if it refuses, whether it does so with a warning."""
        try:
            reason = self.gate.refusal(entry.program)
        except Exception as problem:
            self.counts["crashed"] += 1
            self.find("exception", entry, "translation", f"{type(problem).__name__}: {problem}", text(entry.program))
            return False
        if not reason:
            return True
        self.counts["fell back"] += 1
        kind = reason.split(" in ")[0] + ":" + reason.rsplit(": ", 1)[-1]
        self.refused[kind[:120]] += 1
        if kind not in REFUSALS and len(REFUSALS) < MOST_FALL_BACKS:
            REFUSALS.add(kind)
            tell(stage="fall-back")
            problem = falls_back(entry.program)
            self.counts["fall-backs looked at"] += 1
            if problem:
                self.counts["without warning"] += 1
                self.find("fall-back", entry, "fast", problem, text(entry.program))
        return False

    def compare(self, entries: Sequence[Entry], strict: bool, width: int | None) -> None:
        """Compile programs together, halving them if LLVM takes offence at one, and compare their results."""
        mode = "strict" if strict else "fast"
        try:
            results = computed([entry.program for entry in entries], lanes_of(entries[0].seed), strict, width)
        except Exception as problem:
            if len(entries) == 1:
                self.counts["crashed"] += 1
                told = f"{type(problem).__name__}: {problem}"[:400]
                self.find("exception", entries[0], mode, told, text(entries[0].program))
                return
            half = len(entries) // 2
            self.compare(entries[:half], strict, width)
            self.compare(entries[half:], strict, width)
            return
        for entry, columns in zip(entries, results, strict=True):
            verdict = checked(entry, columns, not strict)
            self.counts["results"] += verdict.compared
            self.counts["unclear results"] += verdict.skipped
            if verdict.wrong:
                self.counts["wrong"] += 1
                self.find("wrong", entry, mode, verdict.wrong, culprit(entry.program, entry.seed, strict, width))

    def find(self, kind: str, entry: Entry, mode: str, said: str, program: str) -> None:
        """Note a finding."""
        self.findings.append({"kind": kind, "seed": entry.seed, "mode": mode, "said": said, "program": program})


def run_plainly(seeds: Sequence[int]) -> None:
    """Run programs by plain XLA alone, and tell that this process has survived it."""
    for seed in seeds:
        program = generate(seed)
        if program is not None:
            xla_fails(program)
    tell(stage="survived")


def main() -> int:
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_traceback_filtering", "off")
    np.seterr(all="ignore")
    tell(stage="ready")
    for line in sys.stdin:
        asked = json.loads(line)
        if asked.get("plain"):
            run_plainly(asked["seeds"])
            continue
        began, unit = time.perf_counter(), Unit(asked["seeds"], asked["xla"])
        unit.run()
        tell(
            counts=unit.counts,
            operations=unit.operations,
            refused=unit.refused,
            findings=unit.findings,
            seconds=time.perf_counter() - began,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
