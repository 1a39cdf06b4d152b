"""What a step of a controller costs: operations, the longest chain of them, and memory."""

from typing import NamedTuple

from dssc_jax.flight_code.controller import COMMAND, SampledController
from dssc_jax.lanes.needed import reachable
from dssc_jax.lanes.program import Branch, CodeBlock, CodeLoop, Program, Value

FREE = ("input", "constant", "bitcast", "state", "result", "joined", "any")
"""Values that no instruction of arithmetic computes."""


class StepCost(NamedTuple):
    """The cost of one step.

    Args:
        operations: How often each operation occurs on the longest path; of a branch, the side with more.
        chain: Operations in the longest chain in which each needs the last one's result.
        loops: Loops, whose turns are not known ahead; their operations are counted once.
    """

    operations: dict[str, int]
    chain: int
    loops: int


def step_cost(controller: SampledController, telemetry: bool = False) -> StepCost:
    """The cost of a step, with or without telemetry."""
    program = controller.step.program
    count = len(controller.states) + len(COMMAND)
    return program_cost(
        Program(program.inputs, program.body, program.outputs if telemetry else program.outputs[:count])
    )


def program_cost(program: Program) -> StepCost:
    """The cost of a program."""
    alive = reachable(program)
    depths: dict[int, int] = {}
    loops = 0

    def visit(block: CodeBlock, outside: int) -> dict[str, int]:
        """Operations of a block whose values come after ``outside`` others."""
        nonlocal loops
        counts: dict[str, int] = {}
        for node in block.nodes:
            if id(node) not in alive:
                continue
            if isinstance(node, Value):
                last = max((depths.get(id(operand), 0) for operand in node.operands), default=0)
                paid = node.operation not in FREE
                depths[id(node)] = max(last, outside) + paid
                if paid:
                    counts[node.operation] = counts.get(node.operation, 0) + 1
            elif isinstance(node, CodeLoop | Branch):
                loops += isinstance(node, CodeLoop)
                read = [node.condition] if isinstance(node, Branch) else node.begin
                before = max([outside, *(depths.get(id(value), 0) for value in read)])
                bodies = node.sides if isinstance(node, Branch) else (node.body,)
                inner = max((visit(body, before) for body in bodies), key=lambda each: sum(each.values()))
                ends = [*node.values[0], *node.values[1]] if isinstance(node, Branch) else node.then
                after = max([before, *(depths.get(id(value), 0) for value in ends)])
                depths.update({id(result): after for result in node.results})
                for name, number in inner.items():
                    counts[name] = counts.get(name, 0) + number
        return counts

    counts = visit(program.body, 0)
    return StepCost(dict(sorted(counts.items())), max(depths.values(), default=0), loops)


def state_bytes(controller: SampledController) -> int:
    """Bytes of the state, without the flag whether it has started."""
    return len(controller.states) * controller.real.itemsize


def parameter_bytes(controller: SampledController) -> int:
    """Bytes of the parameters."""
    return len(controller.parameters) * controller.real.itemsize
