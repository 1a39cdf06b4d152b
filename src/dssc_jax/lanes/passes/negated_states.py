"""Removal of loop states that are always the negative of another state, such as DSSC's command u = -u_av.

The removal may change the sign of zeros, so only fast arithmetic uses it.
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
    pairs = sorted(opposite_pairs(loops))  # the text of a program is the key of its code, so the order must be fixed
    for loop in loops:
        kept_states: dict[int, int] = {}  # the state from which a removed state is computed, by its position
        for owner, state, negative in pairs:
            is_free = not {state, negative} & kept_states.keys() and negative not in kept_states.values()
            if owner == id(loop) and is_free:
                kept_states[negative] = state
        if kept_states:
            remove(loop, kept_states)


def opposite_pairs(loops: list[CodeLoop]) -> set[Pair]:
    """Return the pairs of states that are opposite in every turn, by induction over the turns.

    The result is the largest set of candidate pairs with two properties: each pair is opposite before the first turn,
    and each pair is opposite after a turn if all pairs of the set are opposite before the turn. To find the set, all
    candidates are assumed to hold at first. A refuted pair then refutes the pairs that were derived from it.
    """
    candidates = {(id(loop), *pair): loop for loop in loops for pair in candidate_pairs(loop)}
    holding = set(candidates)
    refuted = list[Pair]()
    derived_pairs: dict[Pair, list[Pair]] = {}  # by the pair from which they follow
    for pair, loop in candidates.items():
        _, state, negative = pair
        for values in (loop.initial_states, loop.next_states):
            condition = opposite(values[state], values[negative])
            if condition is False or (condition is not True and condition not in candidates):
                refuted.append(pair)
            elif condition is not True:
                derived_pairs.setdefault(condition, []).append(pair)
    while refuted:
        pair = refuted.pop()
        if pair in holding:
            holding.remove(pair)
            refuted += derived_pairs.get(pair, ())
    return holding


def candidate_pairs(loop: CodeLoop) -> Iterator[tuple[int, int]]:
    """Yield the ordered pairs (first, second) of state positions that are worth a test whether second = -first.

    Only states of the same delay are paired (:func:`states_in_delay`): others cannot be opposite in every turn.
    """
    positions_by_delay: dict[int, list[int]] = {}
    for position in range(len(loop.states)):
        positions_by_delay.setdefault(states_in_delay(loop, position), []).append(position)
    for positions in positions_by_delay.values():
        yield from permutations(positions, 2)


def states_in_delay(loop: CodeLoop, position: int) -> int:
    """Return the number of states through which a number, or its negative, moves turn by turn up to this state.

    The number is 1 for a state that each turn computes anew, and k for the last state of a delay by k turns.

    Args:
        loop: The loop.
        position: Position of the state.
    """
    visited = set[int]()
    while position not in visited:
        visited.add(position)
        next_value = loop.next_states[position]
        source = next_value.operands[0] if next_value.operation == "neg" else next_value
        if source.operation != "state":
            break
        source_loop, source_position = source.detail
        if source_loop is not loop:
            break
        position = source_position
    return len(visited)


def loops_of(block: CodeBlock) -> list[CodeLoop]:
    """Return all loops of a block and of the blocks within the block."""
    return [node for inner in all_blocks(block) for node in inner.nodes if isinstance(node, CodeLoop)]


def opposite(value: Value, negated: Value) -> bool | Pair:
    """Tell whether ``negated`` is always -``value``.

    Returns:
        True or False if this is known. Otherwise the values belong to two states of one loop, and the result is the
        pair of these states: the answer is yes if they are opposite.
    """
    if negated.operation == "neg" and negated.operands[0] is value:
        return True
    if value.operation == negated.operation == "constant":
        return value.dtype == negated.dtype and value.dtype.kind == "f" and bool(value.detail == -negated.detail)
    if value.operation == negated.operation and value.operation in ("state", "result"):
        loop, position = value.detail
        negated_loop, negated_position = negated.detail
        return (id(loop), position, negated_position) if loop is negated_loop else False
    return False


def remove(loop: CodeLoop, kept_states: dict[int, int]) -> None:
    """Remove states from a loop, and compute them as negatives of other states, in the body and after the loop.

    Args:
        loop: The loop.
        kept_states: For the position of each removed state, the position of the state that stays and whose negative
            the removed state is.
    """
    surrounding_block = loop.body.parent
    assert surrounding_block is not None
    negatives_in_body = turn_into_negatives(loop.states, kept_states)
    negatives_after_loop = turn_into_negatives(loop.results, kept_states)
    loop.body.nodes[:0] = negatives_in_body  # at its start
    after_loop = surrounding_block.nodes.index(loop) + 1
    surrounding_block.nodes[after_loop:after_loop] = negatives_after_loop
    for values in (loop.initial_states, loop.states, loop.next_states, loop.results):
        values[:] = [value for position, value in enumerate(values) if position not in kept_states]
    for values in (loop.states, loop.results):
        for position, value in enumerate(values):
            value.detail = loop, position


def turn_into_negatives(values: list[Value], kept_states: dict[int, int]) -> list[Value]:
    """Turn the removed states or results of a loop, in place, into negatives of others; return the turned values.

    Args:
        values: The states or results of the loop.
        kept_states: For the position of each removed value, the position of the value whose negative it becomes.
    """
    negatives = []
    for removed, kept in kept_states.items():
        value = values[removed]
        value.operation = Operation.NEG
        value.operands = (values[kept],)
        value.detail = None
        negatives.append(value)
    return negatives
