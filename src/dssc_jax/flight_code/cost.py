"""The cost of a controller's step: operations, the longest chain of them, and memory."""

from collections import Counter
from collections.abc import Iterable
from typing import NamedTuple

from dssc_jax.flight_code.controller import COMMAND, SampledController
from dssc_jax.lanes.passes.liveness import reachable
from dssc_jax.lanes.program import Branch, CodeBlock, CodeLoop, Program, Value

FREE = ("input", "constant", "bitcast", "state", "result", "joined", "any")
"""Operations without an instruction of arithmetic."""


class StepCost(NamedTuple):
    """The cost of one step.

    A branch counts as its side with more operations. The operations of a loop count once, because the number of its
    iterations is not known in advance.

    Args:
        operations: Number of operations by name.
        chain: Length of the longest chain of operations, each of which needs the result of the one before.
        loops: Number of loops.
    """

    operations: dict[str, int]
    chain: int
    loops: int


def step_cost(controller: SampledController, telemetry: bool = False) -> StepCost:
    """The cost of a controller's step, with or without its telemetry."""
    program = controller.step.program
    first_info = len(controller.states) + len(COMMAND)  # states and command come first, then telemetry
    outputs = program.outputs if telemetry else program.outputs[:first_info]
    return program_cost(Program(program.inputs, program.body, outputs))


def program_cost(program: Program) -> StepCost:
    """The cost of one run of a program."""
    count = OperationCount(program)
    operations = count.block(program.body, start=0)
    longest_chain = max(count.depths.values(), default=0)
    return StepCost(dict(sorted(operations.items())), longest_chain, count.loops)


class OperationCount:
    """Counts the operations of a program.

    The depth of a value is the length of the longest chain of operations that it needs, its own included.

    Args:
        program: The program.
    """

    def __init__(self, program: Program) -> None:
        """Begin without depths and loops."""
        self.depths: dict[int, int] = {}  # by the id of the value
        self.loops = 0
        self._reachable = reachable(program)

    def block(self, block: CodeBlock, start: int) -> Counter[str]:
        """Count the operations of a block by name.

        Args:
            block: The block.
            start: Depth at which its first operations can begin.
        """
        counts: Counter[str] = Counter()
        for node in block.nodes:
            if id(node) not in self._reachable:
                continue
            if isinstance(node, Value):
                operations = 0 if node.operation in FREE else 1
                self.depths[id(node)] = self.deepest(node.operands, start) + operations
                if operations:
                    counts[node.operation] += operations
            elif isinstance(node, CodeLoop):
                self.loops += 1
                counts += self.block(node.body, self.deepest(node.initial_states, start))
                self.finish(node.results, self.deepest([*node.initial_states, *node.next_states], start))
            elif isinstance(node, Branch):
                depth = self.deepest([node.condition], start)
                counts_of_sides = [self.block(side, depth) for side in node.sides]
                counts += max(counts_of_sides, key=Counter.total)
                self.finish(node.results, self.deepest([node.condition, *node.values[0], *node.values[1]], start))
        return counts

    def deepest(self, values: Iterable[Value], start: int) -> int:
        """The depth at which all of some values are computed, in a block that begins at the depth ``start``."""
        return max([start, *(self.depths.get(id(value), 0) for value in values)])

    def finish(self, results: Iterable[Value], depth: int) -> None:
        """Set the depth of the results of a loop or branch."""
        self.depths.update({id(result): depth for result in results})


def state_bytes(controller: SampledController) -> int:
    """Bytes of a controller's state, without the flag that it has started."""
    return len(controller.states) * controller.real.itemsize


def parameter_bytes(controller: SampledController) -> int:
    """Bytes of a controller's parameters."""
    return len(controller.parameters) * controller.real.itemsize
