"""List scheduling: the order of a block's nodes in which a processor waits least.

A processor looks for work among its next few hundred instructions only. In the order of the trace these often wait for
each other, as each stage of Runge-Kutta's method waits for the one before. List scheduling simulates a machine that
begins three operations in a cycle: a node comes as soon as its operands are known, and among several such nodes the one
with the longest chain to the end of the block comes first. The window limits how far a node may come before one that
precedes it in the trace. The wider it is, the more values are alive at a time, and registers are few.
"""

from collections.abc import Iterator, Sequence
from heapq import heappop, heappush
from itertools import chain

from dssc_jax.lanes.program import Branch, CodeLoop, Node, Value, inner_blocks, operands_of

CYCLES = {"add": 3, "sub": 3, "mul": 3, "div": 15, "sqrt": 20, "rem": 40, "lookup": 20, "foreign": 100}
"""Latency of an operation in cycles, from its beginning until its result is known."""
OTHER_CYCLES = 2  # latency of any other operation
AT_A_TIME = 3  # operations that begin in one cycle


def schedule(nodes: Sequence[Node], window: int) -> list[Node]:
    """Return the nodes of a block in the order in which they are written.

    Args:
        nodes: Nodes, each after the nodes whose values it reads.
        window: Number of places after the first unplaced node among which the next node is chosen; 0: the order stays.
    """
    users = users_of(nodes)
    remaining = remaining_cycles(nodes, users)
    missing_operands = [0] * len(nodes)  # operands of each node that are not placed yet
    for user in chain.from_iterable(users):
        missing_operands[user] += 1

    is_placed = [False] * len(nodes)
    known_at = [0.0] * len(nodes)  # cycle at which all operands of a node are known
    # A node moves from heap to heap: its operands are placed; it also lies within the window; its operands are known.
    free_heap = [i for i in range(len(nodes)) if not missing_operands[i]]  # first place first
    waiting_heap: list[tuple[float, int, int]] = []  # (cycle at which the operands are known, -remaining cycles, node)
    ready_heap: list[tuple[int, int]] = []  # (-remaining cycles, node), so that the longest chain comes first
    order = []
    first_unplaced = 0
    cycle = 0.0
    while len(order) < len(nodes):
        while is_placed[first_unplaced]:
            first_unplaced += 1
        while free_heap and free_heap[0] <= first_unplaced + window:
            i = heappop(free_heap)
            heappush(waiting_heap, (known_at[i], -remaining[i], i))
        if not ready_heap:  # the machine waits for the next operand
            first_known_at, _, _ = waiting_heap[0]
            cycle = max(cycle, first_known_at)
        while waiting_heap and waiting_heap[0][0] <= cycle:
            _, negative_remaining, i = heappop(waiting_heap)
            heappush(ready_heap, (negative_remaining, i))
        _, i = heappop(ready_heap)
        order.append(nodes[i])
        is_placed[i] = True
        for user in users[i]:
            missing_operands[user] -= 1
            known_at[user] = max(known_at[user], cycle + cycles(nodes[i]))
            if not missing_operands[user]:
                heappush(free_heap, user)
        cycle += 1.0 / AT_A_TIME
    return order


def remaining_cycles(nodes: Sequence[Node], users: Sequence[Sequence[int]]) -> list[int]:
    """Return, for each node, the cycles of the longest chain of operations from this node to the end of the block.

    Args:
        nodes: Nodes, each after the nodes whose values it reads.
        users: For each node, the positions of the nodes that read its values, from :func:`users_of`.
    """
    remaining = [0] * len(nodes)
    for i in reversed(range(len(nodes))):
        longest_after = max((remaining[user] for user in users[i]), default=0)
        remaining[i] = cycles(nodes[i]) + longest_after
    return remaining


def users_of(nodes: Sequence[Node]) -> list[list[int]]:
    """Return, for each node of a block, the positions of the nodes that read its values."""
    users: list[list[int]] = [[] for _ in nodes]
    # the position of the node that computes each value, by the value's id
    maker = {id(value): i for i, node in enumerate(nodes) for value in results_of(node)}
    for i, node in enumerate(nodes):
        read_nodes = {maker[id(value)] for value in operands_within(node) if id(value) in maker}
        for read_node in read_nodes:
            users[read_node].append(i)
    return users


def results_of(node: Node) -> Sequence[Value]:
    """Return the values that a node computes for the block in which it stands; none for a record."""
    if isinstance(node, CodeLoop | Branch):
        return node.results
    return (node,) if isinstance(node, Value) else ()


def operands_within(node: Node) -> Iterator[Value]:
    """Yield the values that a node reads, and those that the nodes of its inner blocks read."""
    yield from operands_of(node)
    for block in inner_blocks(node):
        for part in block.nodes:
            yield from operands_within(part)


def cycles(node: Node) -> int:
    """Return the latency of a node in cycles; 0 for loops, branches and records, whose latency is not modelled."""
    return CYCLES.get(node.operation, OTHER_CYCLES) if isinstance(node, Value) else 0
