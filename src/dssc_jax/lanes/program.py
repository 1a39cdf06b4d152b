"""The typed program of one lane: scalar values in static single assignment, within nested blocks.

A value is *varying* if it may differ between lanes, and *uniform* otherwise: time, and all that follows from it alone.
An emitter keeps varying values in vectors of lanes and uniform values in scalars. A block is the body of the program,
of a loop or of one side of a branch.
:mod:`dssc_jax.lanes.builder` builds it.
"""

from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from dssc_jax.lanes.operations import Operation

BOOL = np.dtype(bool)
TOKEN = np.dtype(np.int8)
"""Type of what stands for the content of a slot."""

# Nodes refer to each other: one that printed its parts would print its whole program, many times over.


@dataclass(eq=False, repr=False, slots=True)
class Value:
    """A scalar of one lane.

    Args:
        operation: What it is.
        dtype: Its type.
        operands: The values that it is computed from.
        detail: The constant, the table, the number of the input, the subroutine, the slot, the function of C, the
            position of a part, or the loop or branch with the position in it.
        varying: Whether it may differ between lanes.
        block: Where it is computed; None for a constant.
    """

    operation: Operation
    dtype: np.dtype
    operands: tuple["Value", ...] = ()
    detail: Any = None
    varying: bool = False
    block: "CodeBlock | None" = None


@dataclass(eq=False, repr=False, slots=True)
class CodeBlock:
    """A sequence of values, loops, branches and records.

    Args:
        parent: The surrounding block.
        keeps_operations: Whether operations stay although the surrounding block knows their operands: a branch's side.
    """

    parent: "CodeBlock | None" = None
    keeps_operations: bool = False
    depth: int = 0
    nodes: "list[Node]" = field(default_factory=list)
    value_of_key: dict[Hashable, Value] = field(default_factory=dict)


@dataclass(eq=False, repr=False, slots=True)
class CodeLoop:
    """A loop that tests at its end: do the body as long as ``proceed`` holds.

    Args:
        body: Its block.
        guard: Whether to enter at all; None: always.
        initial_states: Values of the state before the first turn.
        states: The state within the body.
        next_states: The state after a turn.
        proceed: A uniform condition, known in the body.
        results: The state after the loop.
    """

    body: CodeBlock
    guard: Value | None
    initial_states: list[Value]
    states: list[Value] = field(default_factory=list)
    next_states: list[Value] = field(default_factory=list)
    proceed: Value | None = None
    results: list[Value] = field(default_factory=list)


@dataclass(eq=False, repr=False, slots=True)
class Branch:
    """Two sides, of which each lane takes one; a side that no lane takes is skipped.

    Args:
        condition: Whether a lane takes the first side.
        sides: The two blocks.
        values: Results of both sides.
        results: The results.
    """

    condition: Value
    sides: tuple[CodeBlock, CodeBlock]
    values: tuple[list[Value], list[Value]] = ([], [])
    results: list[Value] = field(default_factory=list)


@dataclass(eq=False, repr=False, slots=True)
class Record:
    """Stores a value at a position of a lane's output array, such as one sample of a trajectory.

    Args:
        recording: The array.
        position: Uniform index in the array.
        value: The value.
    """

    recording: "Recording"
    position: Value
    value: Value


@dataclass(eq=False, repr=False, slots=True)
class Recording:
    """An output array of a loop: one :class:`Record` writes it, and no operation of the program reads it.

    Args:
        length: Number of elements.
        dtype: Type of the elements.
    """

    length: int
    dtype: np.dtype


@dataclass(eq=False, repr=False, slots=True)
class Slot:
    """Memory of a lane that a loop reads and writes.

    Args:
        length: Number of its elements.
        dtype: Their type.
    """

    length: int
    dtype: np.dtype


@dataclass(slots=True)
class Program:
    """The program of one lane.

    Args:
        inputs: Types of the lane's numbers.
        body: The outermost block.
        outputs: Its results: scalars, and arrays that a loop records.
    """

    inputs: list[np.dtype]
    body: CodeBlock
    outputs: list[Value | Recording]


@dataclass(eq=False, repr=False, slots=True)
class Subroutine:
    """A function of scalars that stands beside the program and that few lanes need.

    Args:
        name: Its name, unique in the program.
        program: Its body, with one output.
    """

    name: str
    program: Program


Node: TypeAlias = Value | CodeLoop | Branch | Record
"""An entry of a block; the entries run in order."""


def inner_blocks(node: Node) -> tuple[CodeBlock, ...]:
    """The blocks of a loop or branch; other nodes have none."""
    if isinstance(node, CodeLoop):
        return (node.body,)
    return node.sides if isinstance(node, Branch) else ()


def all_blocks(block: CodeBlock) -> Iterator[CodeBlock]:
    """A block and all within it."""
    yield block
    for node in block.nodes:
        for inner in inner_blocks(node):
            yield from all_blocks(inner)


def read_by(node: Node) -> list[Value]:
    """The values that a node reads; not what its blocks read."""
    match node:
        case Value():
            return list(node.operands)
        case Record():
            return [node.position, node.value]
        case Branch():
            return [node.condition, *node.values[0], *node.values[1]]
        case CodeLoop():
            ends = [value for value in (node.guard, node.proceed) if value is not None]
            return [*node.initial_states, *node.next_states, *ends]
    raise TypeError(node)
