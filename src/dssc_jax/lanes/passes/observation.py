"""Early places for what only observes a loop, such as metrics and the test for divergence.

The trace places these operations at the end of a turn, where they read values that were computed long before. With few
registers, such values are stored in between and loaded again. So each operation of an observer is moved to where its
operands have just become known.
"""

from collections.abc import Sequence, Set

from dssc_jax.lanes.passes.scheduling import operands_within, results_of
from dssc_jax.lanes.program import CodeLoop, Node, Value

ELSEWHERE = 1
"""The bit, in a set of states as an integer, that stands for whatever is no state of the loop, as its condition is."""


def observing_nodes(loop: CodeLoop) -> set[int]:
    """Return the ids of the values of a loop's body on which only observers depend.

    A state is an observer if nothing depends on it but itself and other observers. Sets of states are integers, in
    which bit i + 1 stands for state i.
    """
    reached = reached_states(loop)
    observers = 0
    found = -1
    while found != observers:
        found = observers
        for i, state in enumerate(loop.states):
            if not reached.get(id(state), 0) & ~(observers | 2 << i):
                observers |= 2 << i
    ids = {id(node) for node in loop.body.nodes if isinstance(node, Value)}
    return {node for node in ids & reached.keys() if not reached[node] & ~observers}


def reached_states(loop: CodeLoop) -> dict[int, int]:
    """Return, by the id of each value in a loop's body, the set of next states that depend on the value.

    A set is an integer, in which bit i + 1 stands for state i and the bit :data:`ELSEWHERE` for anything else.
    """
    reached = {id(loop.proceed): ELSEWHERE}
    for i, value in enumerate(loop.next_states):
        reached[id(value)] = reached.get(id(value), 0) | 2 << i
    for node in reversed(loop.body.nodes):
        states = 0 if isinstance(node, Value) else ELSEWHERE
        for result in results_of(node):
            states |= reached.get(id(result), 0)
        for operand in operands_within(node):
            reached[id(operand)] = reached.get(id(operand), 0) | states
    return reached


def placed_early(order: Sequence[Node], early: Set[int]) -> list[Node]:
    """Reorder nodes so that some of them come as soon as their operands are known; the others keep their order.

    Args:
        order: Nodes, each after the nodes whose values it reads.
        early: Ids of the nodes to move.
    """
    group_of: dict[int, int] = {}  # by the id of a value
    groups: list[list[Node]] = [[]]  # of nodes that stay where they are, each with the early ones that follow it
    for node in order:
        if id(node) in early:
            group = max((group_of.get(id(operand), 0) for operand in operands_within(node)), default=0)
            groups[group].append(node)
        else:
            group = len(groups)
            groups.append([node])
        for result in results_of(node):
            group_of[id(result)] = group
    return [node for group in groups for node in group]
