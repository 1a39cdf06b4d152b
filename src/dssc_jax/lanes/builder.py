"""Construction of a lane's program, with simplifications on the way.

An operation on constants is evaluated, and equal operations of a block become one value. An operation is hoisted to the
outermost block in which its operands are known, so that a loop computes nothing that does not change in it. Only the
sides of a branch keep their operations, because a branch exists to skip them.
"""

from collections.abc import Callable, Hashable, Sequence
from typing import Any

import numpy as np

from dssc_jax.lanes.foreign import ForeignFunction
from dssc_jax.lanes.operations import COMPARISONS, Operation, constant_result
from dssc_jax.lanes.program import BOOL, TOKEN, Branch, CodeBlock, CodeLoop, Record, Recording, Slot, Value


class Builder:
    """Builds a program node by node; ``here`` is the block that is being built.

    Args:
        fast: Whether products and quotients may be regrouped (:meth:`_regrouped`), which changes their last bits.
    """

    def __init__(self, fast: bool = False) -> None:
        self.here = CodeBlock()
        self.fast = fast
        self._constants: dict[Hashable, Value] = {}

    def constant(self, number: Any, dtype: np.dtype) -> Value:
        """A constant of a dtype; equal constants are one value."""
        scalar = np.asarray(number).astype(dtype)[()]
        key = dtype, scalar.tobytes()
        if key not in self._constants:
            self._constants[key] = Value(Operation.CONSTANT, dtype, detail=scalar)
        return self._constants[key]

    def input(self, position: int, dtype: np.dtype) -> Value:
        """The input of the lane at a position."""
        return self._placed("input", dtype, (), position, True, self.here)

    def add(self, operation: str, *operands: Value, dtype: np.dtype | None = None, detail: Any = None) -> Value:
        """Add an operation, and return its result; simplifications may return another value.

        Args:
            operation: An :class:`Operation`, or its name.
            operands: The operands.
            dtype: Dtype of the result; None: that of the last operand, or a truth value for a comparison.
            detail: The table of a ``lookup``, the subroutine of a ``rarely``.
        """
        dtype = dtype or (BOOL if operation in COMPARISONS else operands[-1].dtype)
        if operation in ("mul", "abs") and dtype.kind == "f" and all(value.operation == "neg" for value in operands):
            operands = tuple(value.operands[0] for value in operands)
        simple = simplified(operation, operands, dtype)
        if simple is not None:
            return simple
        if all(operand.operation == "constant" for operand in operands):
            constant = constant_result(operation, [operand.detail for operand in operands], dtype, detail)
            if constant is not None:
                return self.constant(constant, dtype)
        if self.fast and dtype.kind == "f" and (product := self._regrouped(operation, operands)) is not None:
            return product
        varying = operation != "any" and any(operand.varying for operand in operands)
        return self._placed(operation, dtype, operands, detail, varying, self._home(operands))

    def memory(self, slot: Slot) -> Value:
        """Reserve a slot full of zeros, and return its token."""
        outermost = self.here
        while outermost.parent is not None:
            outermost = outermost.parent
        return self._placed("memory", TOKEN, (), slot, True, outermost)

    def read(self, slot: Slot, token: Value, index: Value) -> Value:
        """Read an element of a slot; ``token`` stands for the slot's content."""
        return self._placed("read", slot.dtype, (token, index), slot, True, self.here)

    def write(self, slot: Slot, token: Value, index: Value, value: Value, reads: Sequence[Value]) -> Value:
        """Write an element of a slot, and return the new token.

        Args:
            slot: The slot.
            token: The token of the content before.
            index: Uniform index of the element.
            value: The new element.
            reads: Reads of the content before, which must come first.
        """
        return self._placed("write", TOKEN, (token, index, value, *reads), slot, True, self.here)

    def foreign(self, function: ForeignFunction, operands: Sequence[Value]) -> list[Value]:
        """Call a function of C for each lane, and return its results, which count as varying."""
        home = self._home(operands)
        types = [place.dtype for place in function.results]
        call = self._placed(Operation.FOREIGN, types[0], tuple(operands), function, True, home)
        return [self._placed(Operation.PART, t, (call,), position, True, home) for position, t in enumerate(types)]

    def loop(self, initial_states: Sequence[Value], varying: Sequence[bool], guard: Value | None) -> CodeLoop:
        """Begin a loop; :meth:`end_loop` ends it.

        Args:
            initial_states: States before the first turn.
            varying: Whether each state may differ between lanes after a turn.
            guard: Whether to enter the loop; None: always.
        """
        loop = CodeLoop(CodeBlock(self.here, depth=self.here.depth + 1), guard, list(initial_states))
        for position, (value, varies) in enumerate(zip(initial_states, varying, strict=True)):
            state = Value(Operation.STATE, value.dtype, (), (loop, position), varies or value.varying, loop.body)
            loop.states.append(state)
        self.here = loop.body
        return loop

    def end_loop(self, loop: CodeLoop, next_states: Sequence[Value], proceed: Value) -> list[Value]:
        """End a loop, and return its states after it.

        Args:
            loop: The loop that :meth:`loop` began.
            next_states: States after a turn.
            proceed: The uniform condition for another turn.
        """
        loop.next_states = list(next_states)
        loop.proceed = proceed
        self.here = loop.body.parent or loop.body
        self.here.nodes.append(loop)
        loop.results = [
            Value(Operation.RESULT, state.dtype, (), (loop, position), state.varying, self.here)
            for position, state in enumerate(loop.states)
        ]
        return loop.results

    def branch(self, condition: Value, sides: Sequence[Callable[[], list[Value]]]) -> list[Value]:
        """Add a branch, and return its results.

        Args:
            condition: Whether a lane takes the first of the two sides.
            sides: For each side, the function that builds it and returns its results.
        """
        surrounding_block = self.here
        blocks = []
        values = []
        for side in sides:
            self.here = CodeBlock(surrounding_block, keeps_operations=True, depth=surrounding_block.depth + 1)
            values.append(side())
            blocks.append(self.here)
        self.here = surrounding_block
        branch = Branch(condition, (blocks[0], blocks[1]), (values[0], values[1]))
        surrounding_block.nodes.append(branch)
        for position, pair in enumerate(zip(*values, strict=True)):
            varying = condition.varying or any(value.varying for value in pair)
            branch.results.append(
                Value(Operation.JOINED, pair[0].dtype, (), (branch, position), varying, surrounding_block)
            )
        return branch.results

    def record(self, recording: Recording, position: Value, value: Value) -> None:
        """Add the storing of a value at a uniform position of a recording."""
        self.here.nodes.append(Record(recording, position, value))

    def _regrouped(self, operation: str, operands: Sequence[Value]) -> Value | None:
        """The same product or quotient with fewer operations in inner blocks; None if there is none.

        A divisor that is known before a loop is inverted there. Two factors that are known before a third one are
        multiplied there. Sums keep their order, because cancellation depends on it.
        """
        if operation == "div" and self._depth_of(operands[1]) < self._depth_of(operands[0]):
            inverse = self.add("div", self.constant(1.0, operands[1].dtype), operands[1])
            if is_normal_or_varies(inverse):
                return self.add("mul", operands[0], inverse)
        if operation == "mul":
            for product, factor in (operands, operands[::-1]):
                if product.operation == "mul":
                    for late, early in (product.operands, product.operands[::-1]):
                        if max(self._depth_of(early), self._depth_of(factor)) < self._depth_of(late):
                            factors = self.add("mul", early, factor)
                            if is_normal_or_varies(factors):
                                return self.add("mul", late, factors)
        return None

    def _depth_of(self, value: Value) -> int:
        """The depth of the block to which an operation on a value alone is hoisted; -1 for a constant."""
        return -1 if value.operation == "constant" else self._home([value]).depth

    def _home(self, operands: Sequence[Value]) -> CodeBlock:
        """The block to which an operation on some operands is hoisted: the outermost one that may compute it."""
        deepest = max((operand.block.depth for operand in operands if operand.block is not None), default=0)
        block = self.here
        while block.depth > deepest and not block.keeps_operations and block.parent is not None:
            block = block.parent
        return block

    def _placed(
        self, operation: str, dtype: np.dtype, operands: tuple[Value, ...], detail: Any, varying: bool, home: CodeBlock
    ) -> Value:
        """The equal value of the block or of a surrounding one, if there is one; else a new value in the block."""
        key = operation, dtype, tuple(map(id, operands)), detail if isinstance(detail, int) else id(detail)
        block: CodeBlock | None = home
        while block is not None:
            if key in block.value_of_key:
                return block.value_of_key[key]
            block = block.parent
        value = Value(Operation(operation), dtype, operands, detail, varying, home)
        home.value_of_key[key] = value
        home.nodes.append(value)
        return value


def is_normal_or_varies(factor: Value) -> bool:
    """Whether a factor may be used in a regrouped product: a constant must be a normal number, any other value may."""
    if factor.operation != "constant":
        return True
    return bool(np.finfo(factor.dtype).tiny <= abs(factor.detail) < np.inf)


def simplified(operation: str, operands: Sequence[Value], dtype: np.dtype) -> Value | None:
    """The operand that always equals the result of an operation, to the last bit; None if there is none."""
    first_operand = operands[0]
    if operation in ("convert", "bitcast") and first_operand.dtype == dtype:
        return first_operand
    if operation == "any" and first_operand.operation == "constant":
        return first_operand
    if operation == "rarely" and first_operand.operation == "constant" and not first_operand.detail:
        return operands[1]
    if operation == "select":
        if operands[1] is operands[2]:
            return operands[1]
        if first_operand.operation == "constant":
            return operands[1] if first_operand.detail else operands[2]
    if operation in ("and", "or"):
        for operand, other in (operands, operands[::-1]):
            is_truth = operand.operation == "constant" and operand.dtype == BOOL
            if operand is other or (is_truth and operand.detail == (operation == "and")):
                return other
    if operation == "mul":
        for factor, other in (operands, operands[::-1]):
            if factor.operation == "constant" and factor.detail == 1:
                return other
    return None
