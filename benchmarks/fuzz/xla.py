"""The referee itself against plain XLA, where XLA computes as IEEE arithmetic does."""

from collections.abc import Sequence

import numpy as np

from benchmarks.fuzz.checking import differences, flattened, inputs_of, single_columns
from benchmarks.fuzz.program import Node, Program, all_nodes
from benchmarks.fuzz.referee import Referee
from benchmarks.fuzz.values import MAIN, TYPES

FUNCTION_ERROR = {"float64": 1e-13, "float32": 1e-5}
"""Relative; XLA's elementary functions have errors of several units in the last place."""

REPLICAS = 16


class Watching(Referee):
    """A referee that notes where a number is subnormal, which XLA takes for a zero."""

    def evaluated(self, program: Program, operands: list[np.ndarray]) -> list[np.ndarray]:
        lanes = len(operands[0])
        self.subnormal = getattr(self, "subnormal", np.zeros(lanes, bool))
        self.note(operands)
        return super().evaluated(program, operands)

    def value(self, node: Node, operands: list[np.ndarray], count: int) -> np.ndarray:
        result = super().value(node, operands, count)
        self.note([*operands, result])
        return result

    def note(self, columns: Sequence[np.ndarray]) -> None:
        """Note the lanes with a subnormal number, or the smallest normal one."""
        for column in columns:
            if column.dtype.name in MAIN:
                small = (np.abs(column) <= np.finfo(column.dtype).tiny) & (column != 0)
                self.subnormal = self.subnormal | small.reshape(len(column), -1).any(1)


def doubts(program: Program, results: Sequence[np.ndarray], count: int) -> str:
    """Where plain XLA contradicts the referee; empty if nowhere."""
    foreign = {name for name in TYPES if name.startswith(("float16", "bfloat", "float8", "complex"))}
    if any(kind.dtype in foreign for kind in (*program.inputs, *(node.kind for node in all_nodes(program)))):
        return ""  # the referee asks XLA itself
    referee, columns = Watching(True, REPLICAS), inputs_of(program, count)
    expected = flattened(referee.results(program, columns))
    clean = ~referee.subnormal.reshape(REPLICAS, count).any(0)
    for result, reference in zip(single_columns(results), expected, strict=True):
        wrong, _ = differences(result, reference, True, 4.0)
        if result.dtype.name in FUNCTION_ERROR:
            near = np.isclose(result, reference[0], rtol=FUNCTION_ERROR[result.dtype.name], atol=0.0, equal_nan=True)
            wrong &= ~near
        wrong &= clean
        if wrong.any():
            lane = int(np.flatnonzero(wrong)[0])
            shown = ", ".join(f"v{i}={column[lane]!r}" for i, column in enumerate(columns))
            return f"{int(wrong.sum())} lanes: {shown}: XLA {result[lane]!r}, the referee {reference[0, lane]!r}"
    return ""
