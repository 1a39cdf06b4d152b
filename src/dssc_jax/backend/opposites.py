"""States of loops that are always the negative of another state, such as DSSC's command u = -u_av.

No loop needs to carry both. Zeros may change their sign by it, so this is for fast arithmetic alone.
"""

from collections.abc import Iterator
from itertools import permutations

from dssc_jax.backend.program import Branch, CodeBlock, CodeLoop, Program, Value

Pair = tuple[int, int, int]
"""Identity of a loop, position of a state, position of its negative."""


def join_opposites(program: Program) -> None:
    """Change a program so that no loop carries a state and its negative."""
    loops = list(loops_of(program.body))
    pairs = {(id(loop), *pair) for loop in loops for pair in permutations(range(len(loop.states)), 2)}
    # What holds before the first turn, and after a turn if it held before it, holds always.
    while kept := {(id(loop), *pair) for loop in loops for pair in holding_pairs(loop, pairs)}:
        if kept == pairs:
            break
        pairs = kept
    for loop in loops:
        negatives: dict[int, int] = {}
        for position, negative in sorted(holding_pairs(loop, kept)):  # the text of a program is the key of its code
            if not {position, negative} & negatives.keys() and negative not in negatives.values():
                negatives[negative] = position
        if negatives:
            remove(loop, negatives)


def loops_of(block: CodeBlock) -> Iterator[CodeLoop]:
    """All loops within a block."""
    for node in block.nodes:
        if isinstance(node, CodeLoop):
            yield node
            yield from loops_of(node.body)
        elif isinstance(node, Branch):
            for side in node.sides:
                yield from loops_of(side)


def holding_pairs(loop: CodeLoop, pairs: set[Pair]) -> Iterator[tuple[int, int]]:
    """The pairs of a loop that hold before it and after a turn, if ``pairs`` hold within it and elsewhere."""
    for owner, one, other in pairs:
        if owner == id(loop) and all(opposite(x[one], x[other], pairs) for x in (loop.begin, loop.then)):
            yield one, other


def opposite(one: Value, other: Value, pairs: set[Pair]) -> bool:
    """Whether the second value is the negative of the first."""
    if other.operation == "neg" and other.operands[0] is one:
        return True
    if one.operation == other.operation == "constant":
        return one.dtype == other.dtype and one.dtype.kind == "f" and one.detail == -other.detail
    if one.operation == other.operation and one.operation in ("state", "result"):
        (owner, position), (other_owner, negative) = one.detail, other.detail
        return owner is other_owner and (id(owner), position, negative) in pairs
    return False


def remove(loop: CodeLoop, negatives: dict[int, int]) -> None:
    """Compute states from their negatives, in the body and behind the loop."""
    outside = loop.body.parent
    assert outside is not None
    behind = outside.nodes.index(loop) + 1
    for values, block, place in ((loop.states, loop.body, 0), (loop.results, outside, behind)):
        changed = [values[negative] for negative in negatives]
        for value, position in zip(changed, negatives.values(), strict=True):
            value.operation, value.operands, value.detail = "neg", (values[position],), None
        block.nodes[place:place] = changed
    for values in (loop.begin, loop.states, loop.then, loop.results):
        values[:] = [value for position, value in enumerate(values) if position not in negatives]
    for values in (loop.states, loop.results):
        for position, value in enumerate(values):
            value.detail = loop, position
