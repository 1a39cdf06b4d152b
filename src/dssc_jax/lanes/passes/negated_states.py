"""Removal of loop states that are always the negative of another state, such as DSSC's command u = -u_av.

It may change the sign of zeros, so it is for fast arithmetic alone.
"""

from collections.abc import Iterator
from itertools import permutations

from dssc_jax.lanes.operations import Operation
from dssc_jax.lanes.program import CodeBlock, CodeLoop, Program, Value, all_blocks

Pair = tuple[int, int, int]
"""Identity of a loop, position of a state, position of its negative."""


def join_opposites(program: Program) -> None:
    """Change a program so that no loop carries both a state and its negative."""
    loops = loops_of(program.body)
    holding = opposite_pairs(loops)
    for loop in loops:
        negatives: dict[int, int] = {}
        for owner, position, negative in sorted(holding):  # the text of a program is the key of its code
            free = not {position, negative} & negatives.keys() and negative not in negatives.values()
            if owner == id(loop) and free:
                negatives[negative] = position
        if negatives:
            remove(loop, negatives)


def opposite_pairs(loops: list[CodeLoop]) -> set[Pair]:
    """The pairs of states that are opposite in every turn, by induction over the turns.

    They are the largest set of candidates in which each pair is opposite before the first turn, and opposite after a
    turn if all pairs of the set are opposite before it.
    """
    candidates = {(id(loop), *pair): loop for loop in loops for pair in candidate_pairs(loop)}
    holding = set(candidates)
    refuted = list[Pair]()
    dependent: dict[Pair, list[Pair]] = {}
    for pair, loop in candidates.items():
        _, value, negated = pair
        for values in (loop.initial_states, loop.next_states):
            condition = opposite(values[value], values[negated])
            if condition is False or (condition is not True and condition not in candidates):
                refuted.append(pair)
            elif condition is not True:
                dependent.setdefault(condition, []).append(pair)
    while refuted:
        pair = refuted.pop()
        if pair in holding:
            holding.remove(pair)
            refuted += dependent.get(pair, ())
    return holding


def candidate_pairs(loop: CodeLoop) -> Iterator[tuple[int, int]]:
    """Ordered pairs of positions of states, of which one may always be minus the other.

    The values of both were computed equally many iterations of the loop ago. Either may replace the other.
    """
    positions_by_delay: dict[int, list[int]] = {}
    for position in range(len(loop.states)):
        positions_by_delay.setdefault(turns_behind(loop, position), []).append(position)
    for positions in positions_by_delay.values():
        yield from permutations(positions, 2)


def turns_behind(loop: CodeLoop, position: int) -> int:
    """Number of states through which a value, or its negative, passes until it is in this state, as in a delay."""
    visited = set[int]()
    while position not in visited:
        visited.add(position)
        next_value = loop.next_states[position]
        source = next_value.operands[0] if next_value.operation == "neg" else next_value
        if source.operation != "state" or source.detail[0] is not loop:
            break
        position = source.detail[1]
    return len(visited)


def loops_of(block: CodeBlock) -> list[CodeLoop]:
    """All loops of a block and of the blocks within it."""
    return [node for inner in all_blocks(block) for node in inner.nodes if isinstance(node, CodeLoop)]


def opposite(value: Value, negated: Value) -> bool | Pair:
    """Whether the second value is the negative of the first; if that depends on a pair of states, the pair."""
    if negated.operation == "neg" and negated.operands[0] is value:
        return True
    if value.operation == negated.operation == "constant":
        return value.dtype == negated.dtype and value.dtype.kind == "f" and bool(value.detail == -negated.detail)
    if value.operation == negated.operation and value.operation in ("state", "result"):
        (loop, position), (other_loop, negative) = value.detail, negated.detail
        return loop is other_loop and (id(loop), position, negative)
    return False


def remove(loop: CodeLoop, negatives: dict[int, int]) -> None:
    """Remove states from a loop, and compute them from their negatives in the body and after the loop.

    Args:
        loop: The loop.
        negatives: Position of the negative that stays, by the position of a state to remove.
    """
    surrounding_block = loop.body.parent
    assert surrounding_block is not None
    after_loop = surrounding_block.nodes.index(loop) + 1
    for values, block, insertion_index in ((loop.states, loop.body, 0), (loop.results, surrounding_block, after_loop)):
        changed = [values[negative] for negative in negatives]
        for value, position in zip(changed, negatives.values(), strict=True):
            value.operation = Operation.NEG
            value.operands = (values[position],)
            value.detail = None
        block.nodes[insertion_index:insertion_index] = changed
    for values in (loop.initial_states, loop.states, loop.next_states, loop.results):
        values[:] = [value for position, value in enumerate(values) if position not in negatives]
    for values in (loop.states, loop.results):
        for position, value in enumerate(values):
            value.detail = loop, position
