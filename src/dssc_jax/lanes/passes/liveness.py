"""Liveness analysis: the values on which a program's results depend."""

from collections import Counter

from dssc_jax.lanes.program import (
    Branch,
    CodeBlock,
    CodeLoop,
    Node,
    Program,
    Record,
    Recording,
    Value,
    all_blocks,
    inner_blocks,
)


def read_inputs(program: Program) -> set[int]:
    """Return the positions of the inputs on which a result of the program depends."""
    alive = reachable(program)
    nodes = (node for block in all_blocks(program.body) for node in block.nodes if id(node) in alive)
    return {int(node.detail) for node in nodes if isinstance(node, Value) and node.operation == "input"}


def reachable(program: Program) -> set[int]:
    """Return the ids of the nodes on which a result of the program depends."""
    visited: set[int] = set()
    records: dict[int, list[Node]] = {}
    collect_records(program.body, (), records)
    pending: list[Node] = [output for output in program.outputs if isinstance(output, Value)]
    for output in program.outputs:
        if isinstance(output, Recording):
            pending += records[id(output)]
    while pending:
        node = pending.pop()
        if id(node) not in visited:
            visited.add(id(node))
            pending += needed_nodes(node)
    return visited


def needed_nodes(node: Node) -> list[Node]:
    """Return the nodes that a node needs directly.

    A loop or branch needs its conditions only. A state or result needs, beside the loop or branch, only the values that
    are assigned to that one state or result, so that unused states are not alive.
    """
    match node:
        case Value(operation="state" | "result", detail=(loop, position)):
            return [loop, loop.initial_states[position], loop.next_states[position]]
        case Value(operation="joined", detail=(branch, position)):
            return [branch, branch.values[0][position], branch.values[1][position]]
        case Value():
            return list(node.operands)
        case CodeLoop():
            return [value for value in (node.guard, node.proceed) if value is not None]
        case Branch():
            return [node.condition]
        case Record():
            return [node.position, node.value]


def collect_records(block: CodeBlock, around: tuple[Node, ...], records: dict[int, list[Node]]) -> None:
    """Find the records of a block and of all blocks within it.

    Args:
        block: The block.
        around: The loops and branches around the block.
        records: The result, which this function fills: for the id of each recording, its records and the loops and
            branches around these.
    """
    for node in block.nodes:
        if isinstance(node, Record):
            records.setdefault(id(node.recording), []).extend([node, *around])
        for inner in inner_blocks(node):
            collect_records(inner, (*around, node), records)


def operation_counts(program: Program) -> dict[str, int]:
    """Count the values by their operation, among the values on which a result depends."""
    alive = reachable(program)
    nodes = (node for block in all_blocks(program.body) for node in block.nodes)
    return dict(Counter(node.operation for node in nodes if isinstance(node, Value) and id(node) in alive))
