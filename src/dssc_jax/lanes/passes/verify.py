"""Verification of a program's form, which every pass must preserve."""

import numpy as np

from dssc_jax.lanes.operations import ARITHMETIC, COMPARISONS, Operation
from dssc_jax.lanes.program import BOOL, TOKEN, Branch, CodeBlock, CodeLoop, Program, Record, Slot, Value, operands_of

SAME_TYPE = frozenset(ARITHMETIC) | {Operation.DIV, Operation.REM}
"""Operations whose operands and result have one type."""
OPERAND_COUNTS = {
    **dict.fromkeys(("neg", "abs", "sqrt", "floor", "ceil", "round", "trunc", "not", "convert", "bitcast", "any"), 1),
    "lookup": 1,
    "memory": 0,
    "part": 1,
    "select": 3,
}
"""Number of operands of operations that do not have two; of ``input``, ``rarely``, ``write``, ``foreign`` it varies."""


class InvalidProgram(Exception):
    """A program that breaks a rule of its form, because of an error in the translation or in a pass."""


def verify(program: Program) -> None:
    """Check the form of a program: types, order of definitions, single assignment, uniform conditions of loops.

    Raises:
        InvalidProgram: A rule is broken; the message names the operation and the rule.
    """
    defined: set[int] = set()
    verify_block(program.body, defined)
    for output in program.outputs:
        if isinstance(output, Value):  # a recording is written by a record
            require_defined(output, defined, reader="an output")


def verify_block(block: CodeBlock, defined: set[int]) -> None:
    """Check a block, and add its values to those that may be read.

    Args:
        block: The block.
        defined: Ids of the values that may be read; this function adds the block's values.

    Raises:
        InvalidProgram: A rule is broken.
    """
    for node in block.nodes:
        match node:
            case Value():
                verify_value(node, defined)
                define(node, defined)
            case CodeLoop():
                verify_loop(node, defined)
            case Branch():
                verify_branch(node, defined)
            case Record():
                for value in operands_of(node):
                    require_defined(value, defined, "a record")
                require(not node.position.varying, node.position, "a record's position must be uniform")


def verify_value(value: Value, defined: set[int]) -> None:
    """Check operands, dtypes and uniformity of a single value.

    Args:
        value: The value.
        defined: Ids of the values that may be read.

    Raises:
        InvalidProgram: A rule is broken.
    """
    operation = value.operation
    operands = value.operands
    require(isinstance(operation, Operation), value, "is no operation")
    for operand in operands:
        require_defined(operand, defined, operation)
    if operation not in (Operation.INPUT, Operation.RARELY, Operation.WRITE, Operation.FOREIGN):
        count = OPERAND_COUNTS.get(operation, 2)
        require(len(operands) == count, value, "takes {} operands, got {}", count, len(operands))
    types = [operand.dtype for operand in operands]
    if operation in SAME_TYPE:
        require(set(types) == {value.dtype}, value, "operands and result must have one type, got {}", types)
    elif operation in COMPARISONS:
        require(value.dtype == BOOL and len(set(types)) == 1, value, "must compare one type, got {}", types)
    elif operation == Operation.SELECT:
        require(types[0] == BOOL and types[1:] == [value.dtype] * 2, value, "must select its own type, got {}", types)
    elif operation == Operation.BITCAST:
        require(types[0].itemsize == value.dtype.itemsize, value, "must keep the number of bits")
    elif operation == Operation.ANY:
        require(types[0] == value.dtype == BOOL, value, "must be of truth values")
    elif operation == Operation.RARELY:
        require(types[:2] == [BOOL, value.dtype], value, "must have a condition and a value of its type")
    elif operation in (Operation.MEMORY, Operation.READ, Operation.WRITE):
        verify_access(value)
    elif operation == Operation.FOREIGN:
        require(types == [place.dtype for place in value.detail.operands], value, "must have its types, got {}", types)
    elif operation == Operation.PART:
        places = operands[0].detail.results
        require(operands[0].operation == Operation.FOREIGN, value, "must be of a call")
        require(places[value.detail].dtype == value.dtype, value, "must have the type of the result")
    elif operation == Operation.LOOKUP:
        require(types[0].kind in "iu", value, "must have an index")
        require(isinstance(value.detail, np.ndarray) and value.detail.ndim == 1, value, "must have a table")
    if operation not in (Operation.INPUT, Operation.ANY):
        varying = any(operand.varying for operand in operands)
        require(value.varying or not varying, value, "is uniform, and an operand varies between lanes")


def verify_access(value: Value) -> None:
    """Check the dtypes and the index of an operation on a slot: ``memory``, ``read`` or ``write``.

    Raises:
        InvalidProgram: A rule is broken.
    """
    slot = value.detail
    require(isinstance(slot, Slot), value, "must have a slot")
    result_type = slot.dtype if value.operation == Operation.READ else TOKEN
    require(value.dtype == result_type, value, "type is wrong")
    if value.operation != Operation.MEMORY:
        token, index, *written_and_reads = value.operands  # a read has only the first two
        require(token.dtype == TOKEN, value, "must begin with a token")
        require(index.dtype == np.dtype(np.int32) and not index.varying, value, "must have a uniform index")
        writes_type = not written_and_reads or written_and_reads[0].dtype == slot.dtype
        require(writes_type, value, "must write the slot's type")


def verify_loop(loop: CodeLoop, defined: set[int]) -> None:
    """Check a loop, its body and its states, and add its results to ``defined``, the ids of values that may be read."""
    for value in loop.initial_states:
        require_defined(value, defined, "a loop's begin")
    if loop.guard is not None:
        require_defined(loop.guard, defined, "a loop's guard")
        require(
            loop.guard.dtype == BOOL and not loop.guard.varying, loop.guard, "a guard must be a uniform truth value"
        )
    defined_in_body = set(defined)
    for state in loop.states:
        define(state, defined_in_body)
    verify_block(loop.body, defined_in_body)
    parts = (loop.initial_states, loop.states, loop.next_states, loop.results)
    require(len({len(part) for part in parts}) == 1, None, "a loop's states must be complete")
    for initial_state, state, next_state, result in zip(*parts, strict=True):
        require_defined(next_state, defined_in_body, "a loop's state")
        types = {value.dtype for value in (initial_state, state, next_state, result)}
        require(len(types) == 1, state, "a state must keep its type, got {}", types)
        is_consistent = state.varying or not (initial_state.varying or next_state.varying)
        require(is_consistent, state, "is uniform, and its values vary")
        require(result.varying == state.varying, result, "must vary as the state does")
        define(result, defined)
    proceed = loop.proceed
    assert proceed is not None
    require_defined(proceed, defined_in_body, "a loop's condition")
    require(proceed.dtype == BOOL and not proceed.varying, proceed, "a loop's condition must be a uniform truth value")


def verify_branch(branch: Branch, defined: set[int]) -> None:
    """Check a branch and its sides, and add its results to ``defined``, the ids of the values that may be read."""
    require_defined(branch.condition, defined, "a branch's condition")
    require(branch.condition.dtype == BOOL, branch.condition, "a branch's condition must be a truth value")
    for side, values in zip(branch.sides, branch.values, strict=True):
        defined_in_side = set(defined)
        verify_block(side, defined_in_side)
        for value in values:
            require_defined(value, defined_in_side, "a branch's value")
    for first, second, result in zip(*branch.values, branch.results, strict=True):
        require(first.dtype == second.dtype == result.dtype, result, "both sides must have its type")
        define(result, defined)


def define(value: Value, defined: set[int]) -> None:
    """Add a value to ``defined``, the ids of the values that may be read.

    Raises:
        InvalidProgram: The value is defined already.
    """
    require(id(value) not in defined, value, "is defined twice")
    defined.add(id(value))


def require_defined(value: Value, defined: set[int], reader: str) -> None:
    """Require that a value is a constant or is defined before it is read.

    Args:
        value: The value.
        defined: Ids of the values that may be read.
        reader: What reads the value, in words for the message.

    Raises:
        InvalidProgram: The value is neither.
    """
    is_defined = value.operation == Operation.CONSTANT or id(value) in defined
    require(is_defined, value, "is read by {} before it is set", reader)


def require(holds: bool, value: Value | None, rule: str, *details: object) -> None:
    """Require that a rule holds.

    Args:
        holds: Whether the rule holds.
        value: The value that the rule is about; None: the whole program.
        rule: The rule in words, with a place ``{}`` for each detail.
        details: Objects to put in these places.

    Raises:
        InvalidProgram: The rule does not hold.
    """
    if not holds:
        subject = "the program" if value is None else f"'{value.operation}' of type {value.dtype}"
        raise InvalidProgram(f"{subject}: {rule.format(*details)}")
