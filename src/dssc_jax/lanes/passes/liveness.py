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
    """Positions of the inputs on which a result depends."""
    alive = reachable(program)
    nodes = (node for block in all_blocks(program.body) for node in block.nodes if id(node) in alive)
    return {int(node.detail) for node in nodes if isinstance(node, Value) and node.operation == "input"}


def reachable(program: Program) -> set[int]:
    """Ids of the nodes on which a result depends."""
    visited: set[int] = set()
    pending: list[Node] = [value for value in program.outputs if isinstance(value, Value)]
    records: dict[int, list[Node]] = {}
    collect_records(program.body, (), records)
    for value in program.outputs:
        pending += records[id(value)] if isinstance(value, Recording) else []
    while pending:
        node = pending.pop()
        if id(node) in visited:
            continue
        visited.add(id(node))
        if isinstance(node, Value):
            pending += node.operands
            if node.operation in ("state", "result"):
                loop, position = node.detail
                pending += [loop, loop.initial_states[position], loop.next_states[position]]
            elif node.operation == "joined":
                branch, position = node.detail
                pending += [branch, branch.values[0][position], branch.values[1][position]]
        elif isinstance(node, CodeLoop):
            pending += [value for value in (node.guard, node.proceed) if value is not None]
        elif isinstance(node, Branch):
            pending.append(node.condition)
        elif isinstance(node, Record):
            pending += [node.position, node.value]
    return visited


def collect_records(block: CodeBlock, around: tuple[Node, ...], records: dict[int, list[Node]]) -> None:
    """Find the records of a block and of those within it.

    Args:
        block: The block.
        around: The loops and branches around the block.
        records: Gets, by the id of each recording, its records and the loops and branches around them.
    """
    for node in block.nodes:
        if isinstance(node, Record):
            records.setdefault(id(node.recording), []).extend([node, *around])
        for inner in inner_blocks(node):
            collect_records(inner, (*around, node), records)


def operation_counts(program: Program) -> dict[str, int]:
    """Number of values by operation, among those on which a result depends."""
    alive = reachable(program)
    nodes = (node for block in all_blocks(program.body) for node in block.nodes)
    return dict(Counter(node.operation for node in nodes if isinstance(node, Value) and id(node) in alive))
