"""Workers in processes of their own, restarted when a program ends one."""

import json
import math
import os
import subprocess
import sys
import threading
import time
from collections import Counter, deque
from typing import Any

from benchmarks.fuzz.generate import generate
from benchmarks.fuzz.program import text
from dssc_jax.lanes.program_cache import CACHE_VARIABLE

Work = tuple[list[int], bool]
REPORT_EVERY = 50
DONE = "done"
"""The stage of a unit whose results have come."""

COMMAND = [sys.executable, "-m", "benchmarks.fuzz.worker"]


class Crew:
    """Runs units in several workers.

    Args:
        work: Seeds of each unit, and whether plain XLA runs them, too.
        workers: Processes.
        minutes: No further unit begins after this time; None: all do.
    """

    def __init__(self, work: list[Work], workers: int, minutes: float | None = None) -> None:
        self.waiting, self.workers = deque(work), workers
        self.end = math.inf if minutes is None else time.monotonic() + 60.0 * minutes
        self.counts: Counter[str] = Counter()
        self.operations: Counter[str] = Counter()
        self.refused: Counter[str] = Counter()
        self.findings: list[dict[str, Any]] = []
        self.lock, self.done = threading.Lock(), 0

    def run(self) -> None:
        """All units."""
        threads = [threading.Thread(target=self.serve) for _ in range(self.workers)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()

    def taken(self) -> Work | None:
        """The next unit."""
        with self.lock:
            return self.waiting.popleft() if self.waiting and time.monotonic() < self.end else None

    def serve(self) -> None:
        """Give units to a worker until none is left."""
        worker = started()
        while (unit := self.taken()) is not None:
            stage = self.last_stage(worker, unit)
            if stage != DONE:
                worker.wait()
                self.ended(unit, stage, worker.returncode)
                worker = started()
        assert worker.stdin is not None
        worker.stdin.close()
        worker.wait()

    def last_stage(self, worker: Any, unit: Work) -> str:
        """The stage in which a worker ended; :data:`DONE` if it survived the unit, whose results are then counted."""
        stage = ""
        try:
            worker.stdin.write(json.dumps({"seeds": unit[0], "xla": unit[1]}) + "\n")
            worker.stdin.flush()
            for line in worker.stdout:
                message = json.loads(line)
                if "counts" in message:
                    self.count(message)
                    return DONE
                stage = message["stage"]
        except BrokenPipeError:
            pass
        return stage

    def count(self, message: dict[str, Any]) -> None:
        """Add what a worker found."""
        with self.lock:
            self.counts.update(message["counts"])
            self.operations.update(message["operations"])
            self.refused.update(message["refused"])
            self.findings += message["findings"]
            self.done += 1
            if self.done % REPORT_EVERY == 0:
                short = {name: self.counts[name] for name in ("programs", "compiled", "fell back", "wrong", "crashed")}
                print(self.done, "units,", len(self.waiting), "waiting:", short, file=sys.stderr, flush=True)

    def ended(self, unit: Work, stage: str, code: int) -> None:
        """A unit that ended its worker: its halves next, or the one program that did it.

        A program that ends plain XLA, alone in a process, is not a crash of the lanes. Where XLA only compares, the
        program runs again without it; a program that fell back has nothing else to run it.
        """
        seeds, with_xla = unit
        by_plain_xla = len(seeds) == 1 and stage in ("xla", "fall-back") and ends_xla(seeds[0])
        with self.lock:
            if len(seeds) > 1:
                half = len(seeds) // 2
                self.waiting.extendleft([(seeds[half:], with_xla), (seeds[:half], with_xla)])
                return
            if by_plain_xla:
                self.counts["ended by xla"] += 1
                if stage == "xla":
                    self.waiting.appendleft((seeds, False))
                else:
                    self.counts["programs"] += 1
                    self.counts["fell back"] += 1
                return
            self.counts["programs"] += 1
            self.counts["crashed"] += 1
            program = generate(seeds[0])
            shown = text(program) if program else ""
            found = {"kind": "end of the process", "seed": seeds[0], "mode": "", "said": f"exit code {code}"}
            self.findings.append({**found, "program": shown})


def ends_xla(seed: int) -> bool:
    """Whether plain XLA, in a process of its own, ends with a program."""
    worker = started()
    told, _ = worker.communicate(json.dumps({"seeds": [seed], "plain": True}) + "\n")
    return '"survived"' not in told


def started() -> Any:
    """A worker."""
    environment = {**os.environ, CACHE_VARIABLE: "off", "JAX_PLATFORMS": "cpu"}
    return subprocess.Popen(COMMAND, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                            stderr=subprocess.DEVNULL, text=True)  # fmt: skip
