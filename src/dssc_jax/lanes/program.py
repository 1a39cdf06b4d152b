"""The typed program of one lane: scalar values in static single assignment, within nested blocks.

A value is *varying* if it may differ between lanes, and *uniform* otherwise: time, and all that follows from it alone.
An emitter keeps varying values in vectors of lanes and uniform values in scalars. A block is the body of the program,
of a loop or of one side of a branch. :mod:`dssc_jax.lanes.builder` builds programs.
"""

from collections.abc import Hashable, Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from dssc_jax.lanes.operations import Operation

BOOL = np.dtype(bool)
"""Dtype of truth values."""
TOKEN = np.dtype(np.int8)
"""Dtype of tokens. A token stands for the content of a slot at a point of the program; its number means nothing."""

# Nodes refer to each other, so a printed node would contain its whole program many times: they have no repr.


@dataclass(eq=False, repr=False, slots=True)
class Value:
    """A scalar of one lane.

    Args:
        operation: The operation that computes the value.
        dtype: Dtype of the value.
        operands: The operands of the operation.
        detail: What the operation needs beside its operands: the number of a ``constant``, the table of a ``lookup``,
            the position of an ``input`` or ``part``, the subroutine of a ``rarely``, the slot of a ``memory``, ``read``
            or ``write``, the function of a ``foreign``. For a ``state`` or ``result`` it is (loop, position), for a
            ``joined`` (branch, position). None for other operations.
        varying: Whether the value may differ between lanes.
        block: The block that computes the value; None for a constant.
    """

    operation: Operation
    dtype: np.dtype
    operands: tuple["Value", ...] = ()
    detail: Any = None
    varying: bool = False
    block: "CodeBlock | None" = None


@dataclass(eq=False, repr=False, slots=True)
class CodeBlock:
    """A sequence of values, loops, branches and records, which run in order.

    Args:
        parent: The surrounding block; None: this is the body of the program.
        keeps_operations: Whether operations stay here even if the surrounding block could compute them, as in the side
            of a branch.
        depth: Number of surrounding blocks.
        nodes: The sequence.
        value_of_key: The block's values, by a key of operation, dtype, operands and detail, so that equal operations
            become one value.
    """

    parent: "CodeBlock | None" = None
    keeps_operations: bool = False
    depth: int = 0
    nodes: "list[Node]" = field(default_factory=list)
    value_of_key: dict[Hashable, Value] = field(default_factory=dict)


@dataclass(eq=False, repr=False, slots=True)
class CodeLoop:
    """A loop that tests at its end: it repeats its body as long as ``proceed`` is true.

    Args:
        body: The body.
        guard: Condition of the first turn, the same in all lanes; None: there is always a first turn.
        initial_states: States before the first turn.
        states: States within the body.
        next_states: States after a turn.
        proceed: Condition of another turn, the same in all lanes: a value of the body or an earlier one.
        results: States after the loop.
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
    """A branch with two sides, of which each lane takes one; a side that no lane takes is skipped.

    Args:
        condition: Whether a lane takes the first side.
        sides: The blocks of the two sides.
        values: For each side, the values that become the results of the branch if a lane takes this side.
        results: The results of the branch, after it.
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
        position: Index in the array, the same in all lanes.
        value: The value that is stored.
    """

    recording: "Recording"
    position: Value
    value: Value


@dataclass(eq=False, repr=False, slots=True)
class Recording:
    """An output array of a loop: one :class:`Record` writes the array, and no operation of the program reads it.

    Args:
        length: Number of elements.
        dtype: Type of the elements.
    """

    length: int
    dtype: np.dtype


@dataclass(eq=False, repr=False, slots=True)
class Slot:
    """An array in the memory of a lane, which a loop reads and writes one element at a time.

    Args:
        length: Number of elements.
        dtype: Dtype of the elements.
    """

    length: int
    dtype: np.dtype


@dataclass(slots=True)
class Program:
    """The program of one lane.

    Args:
        inputs: Dtypes of the lane's inputs.
        body: The outermost block.
        outputs: The lane's results: scalars, and arrays that a loop records.
    """

    inputs: list[np.dtype]
    body: CodeBlock
    outputs: list[Value | Recording]


@dataclass(eq=False, repr=False, slots=True)
class Subroutine:
    """A function of scalars beside the program, which is called only if a lane needs it.

    Args:
        name: Name of the subroutine, unique in the program.
        program: The subroutine's own program, with one output.
    """

    name: str
    program: Program


Node: TypeAlias = Value | CodeLoop | Branch | Record
"""An entry of a block; the entries run in order."""


def inner_blocks(node: Node) -> tuple[CodeBlock, ...]:
    """Return the blocks within a loop or branch; an empty tuple for other nodes."""
    if isinstance(node, CodeLoop):
        return (node.body,)
    return node.sides if isinstance(node, Branch) else ()


def all_blocks(block: CodeBlock) -> Iterator[CodeBlock]:
    """Yield a block and all blocks within it, outer blocks first."""
    yield block
    for node in block.nodes:
        for inner in inner_blocks(node):
            yield from all_blocks(inner)


def operands_of(node: Node) -> list[Value]:
    """Return the values that a node itself refers to; values that only the nodes of its inner blocks read are left out.

    Raises:
        TypeError: The argument is no node.
    """
    match node:
        case Value():
            return list(node.operands)
        case Record():
            return [node.position, node.value]
        case Branch():
            return [node.condition, *node.values[0], *node.values[1]]
        case CodeLoop():
            conditions = [value for value in (node.guard, node.proceed) if value is not None]
            return [*node.initial_states, *node.next_states, *conditions]
    raise TypeError(node)
