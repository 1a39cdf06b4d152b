"""1,000 random formulas and signals: the package's robustness, the definitions in NumPy, and rtamt. ``make formulas``.

The interpreter that has rtamt is the argument; without one, only the definitions are compared.
"""

import json
import subprocess
import sys
import time
from pathlib import Path

import jax
import numpy as np

from benchmarks.formulas.random_formulas import T_S, random_formula, random_signals, robustness, text_of
from benchmarks.formulas.streamed import lane_of, parsed
from benchmarks.page import put
from dssc_jax import lanes

COUNT = 1000
STEPS = 40
DEFINITIONS = "with the definitions in NumPy, to 1e-13"
RTAMT = "with rtamt, to 1e-13"
SCALES = np.array([1.0, -0.6])
ORACLE = Path(__file__).with_name("rtamt_oracle.py")


def rtamt_text(formula) -> str:
    """The formula in rtamt's notation, with intervals in samples."""
    return text_of(formula, lambda a, b: f"[{a}:{b}]")


def main(interpreter: str | None) -> int:
    """Compare, print the counts, and return 1 if a formula disagrees."""
    rng = np.random.default_rng(2026)
    began = time.perf_counter()
    tasks = []
    agreed = {DEFINITIONS: 0, RTAMT: 0}
    values = []
    for _ in range(COUNT):
        formula = random_formula(rng, 4, 24)
        signals = random_signals(rng, STEPS)
        with jax.enable_x64(True):
            lane = lane_of(parsed(text_of(formula), T_S, STEPS), signals)
            machine, _ = lanes.compile(lane, 1.0, strict=True)(SCALES)
        scaled = [{name: scale * column for name, column in signals.items()} for scale in SCALES]
        expected = [robustness(formula, columns, 0) for columns in scaled]
        agreed[DEFINITIONS] += bool(np.allclose(machine, expected, rtol=1e-13, atol=1e-13))
        values.append(machine)
        for columns in scaled:
            lists = {name: column.tolist() for name, column in columns.items()}
            tasks.append({"text": rtamt_text(formula), **lists})
    if interpreter:
        answer = subprocess.run(
            [interpreter, str(ORACLE)], input=json.dumps(tasks), capture_output=True, text=True, check=True
        ).stdout
        theirs = np.array(json.loads(answer)).reshape(COUNT, len(SCALES))
        close = np.isclose(np.array(values), theirs, rtol=1e-13, atol=1e-13)
        agreed[RTAMT] = int(np.count_nonzero(close.all(1)))
    else:
        del agreed[RTAMT]
    rows = [f"| {name} | {count:,} of {COUNT:,} |" for name, count in agreed.items()]
    table = "\n".join(["| comparison | formulas that agree in both flights |", "| --- | --- |", *rows])
    print(f"{table}\n{time.perf_counter() - began:.0f} s")
    if interpreter:
        put("checked", table, Path(__file__).parents[2] / "docs" / "formulas.md")
    return 0 if set(agreed.values()) == {COUNT} else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1] if len(sys.argv) > 1 else None))
