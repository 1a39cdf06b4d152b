"""The cost of a controller's step: the operations, the longest chain of operations, and the memory."""

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
    """Counts the operations of a program, and finds the longest chain of operations that wait for each other.

    The depth of a value is the length of the longest chain of operations that leads to it, including the operation
    that computes the value.

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
            start: Depth of what the block waits for, such as the condition of a branch.
        """
        counts: Counter[str] = Counter()
        for node in block.nodes:
            if id(node) not in self._reachable:
                continue
            if isinstance(node, Value):
                counts += self.value(node, start)
            elif isinstance(node, CodeLoop):
                counts += self.loop(node, start)
            elif isinstance(node, Branch):
                counts += self.branch(node, start)
        return counts

    def value(self, value: Value, start: int) -> Counter[str]:
        """Count the operation that computes a value, and set the value's depth; arguments as for :meth:`block`."""
        is_free = value.operation in FREE
        operand_depth = self.deepest(value.operands, start)
        self.depths[id(value)] = operand_depth if is_free else operand_depth + 1
        return Counter() if is_free else Counter([value.operation])

    def loop(self, loop: CodeLoop, start: int) -> Counter[str]:
        """Count the operations of a loop's body once; arguments as for :meth:`block`.

        The loop's results are as deep as its deepest initial or next state, because the number of iterations is not
        known.
        """
        self.loops += 1
        counts = self.block(loop.body, self.deepest(loop.initial_states, start))
        self.finish(loop.results, self.deepest([*loop.initial_states, *loop.next_states], start))
        return counts

    def branch(self, branch: Branch, start: int) -> Counter[str]:
        """Count the operations of the side with more of them; arguments as for :meth:`block`."""
        depth = self.deepest([branch.condition], start)
        counts_of_sides = [self.block(side, depth) for side in branch.sides]
        self.finish(branch.results, self.deepest([branch.condition, *branch.values[0], *branch.values[1]], start))
        return max(counts_of_sides, key=Counter.total)

    def deepest(self, values: Iterable[Value], start: int) -> int:
        """The depth at which all of some values are computed, in a block that begins at the depth ``start``.

        A value that has no depth yet, such as an input of the program, counts with the depth 0.
        """
        return max([start, *(self.depths.get(id(value), 0) for value in values)])

    def finish(self, results: Iterable[Value], depth: int) -> None:
        """Set the depth of the results of a loop or branch.

        A loop or branch gives all its results together, once its deepest value is computed.
        """
        self.depths.update({id(result): depth for result in results})


def state_bytes(controller: SampledController) -> int:
    """Bytes of a controller's state, without the flag that it has started."""
    return len(controller.states) * controller.real.itemsize


def parameter_bytes(controller: SampledController) -> int:
    """Bytes of a controller's parameters."""
    return len(controller.parameters) * controller.real.itemsize
