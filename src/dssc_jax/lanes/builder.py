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
        fast: Whether products and quotients may be regrouped (:meth:`_regrouped`). This changes their last bits.
    """

    def __init__(self, fast: bool = False) -> None:
        """Begin with an empty body."""
        self.here = CodeBlock()
        self.fast = fast
        self._constants: dict[Hashable, Value] = {}

    def constant(self, number: Any, dtype: np.dtype) -> Value:
        """Return a number as a constant of a dtype; numbers of equal dtype and bits give the same value."""
        scalar = np.asarray(number).astype(dtype)[()]  # [()]: NumPy's scalar in place of an array of shape ()
        key = dtype, scalar.tobytes()  # the bits, since -0 equals 0 and NaN does not equal itself
        if key not in self._constants:
            self._constants[key] = Value(Operation.CONSTANT, dtype, detail=scalar)
        return self._constants[key]

    def input(self, position: int, dtype: np.dtype) -> Value:
        """Return the input at a position among the lane's inputs; its value may differ between lanes."""
        return self._place("input", dtype, (), detail=position, varying=True, home=self.here)

    def add(self, operation: str, *operands: Value, dtype: np.dtype | None = None, detail: Any = None) -> Value:
        """Add an operation, and return its result; if a simplification applies, return an equal value instead.

        Args:
            operation: An :class:`Operation`, or its name.
            operands: The operands.
            dtype: Dtype of the result; None: a truth value for a comparison, else the dtype of the last operand.
            detail: The table of a ``lookup`` or the subroutine of a ``rarely``; None for other operations.
        """
        dtype = dtype or (BOOL if operation in COMPARISONS else operands[-1].dtype)
        if operation in ("mul", "abs") and dtype.kind == "f" and all(value.operation == "neg" for value in operands):
            operands = tuple(value.operands[0] for value in operands)  # (-x)(-y) = xy, |-x| = |x|
        simple = simplified(operation, operands, dtype)
        if simple is not None:
            return simple
        if all(operand.operation == "constant" for operand in operands):
            constant = constant_result(operation, [operand.detail for operand in operands], dtype, detail)
            if constant is not None:
                return self.constant(constant, dtype)
        if self.fast and dtype.kind == "f":
            regrouped = self._regrouped(operation, operands)
            if regrouped is not None:
                return regrouped
        # the result of "any" is the same in all lanes, though its operand varies
        varying = operation != "any" and any(operand.varying for operand in operands)
        return self._place(operation, dtype, operands, detail=detail, varying=varying, home=self._home(operands))

    def memory(self, slot: Slot) -> Value:
        """Reserve a slot of memory, full of zeros, in the program's outermost block; return the token of its content.

        A token stands for the content of a slot at one moment. It orders reads and writes: each takes a token as an
        operand, and a write returns a new one.
        """
        body = self.here
        while body.parent is not None:
            body = body.parent
        return self._place("memory", TOKEN, (), detail=slot, varying=True, home=body)

    def read(self, slot: Slot, token: Value, index: Value) -> Value:
        """Read the element of a slot at an index; ``token`` stands for the slot's content at that moment."""
        return self._place("read", slot.dtype, (token, index), detail=slot, varying=True, home=self.here)

    def write(self, slot: Slot, token: Value, index: Value, value: Value, reads: Sequence[Value]) -> Value:
        """Write an element of a slot, and return the token of the content after the write.

        Args:
            slot: The slot.
            token: The token of the content before the write.
            index: Index of the element, the same in all lanes.
            value: The new element.
            reads: Reads of the content before the write. They become operands, so that they run first.
        """
        return self._place("write", TOKEN, (token, index, value, *reads), detail=slot, varying=True, home=self.here)

    def foreign(self, function: ForeignFunction, operands: Sequence[Value]) -> list[Value]:
        """Call a function of C in each lane; return one value for each result, assumed to differ between lanes."""
        home = self._home(operands)
        types = [place.dtype for place in function.results]
        call = self._place(Operation.FOREIGN, types[0], tuple(operands), detail=function, varying=True, home=home)
        return [
            self._place(Operation.PART, dtype, (call,), detail=position, varying=True, home=home)
            for position, dtype in enumerate(types)
        ]

    def loop(self, initial_states: Sequence[Value], varying: Sequence[bool], guard: Value | None) -> CodeLoop:
        """Begin a loop and build its body from here on; :meth:`end_loop` ends it.

        Args:
            initial_states: States before the first turn.
            varying: Whether each state may differ between lanes after a turn.
            guard: Condition for the first turn, the same in all lanes; None: the loop always has a first turn.
        """
        loop = CodeLoop(CodeBlock(self.here, depth=self.here.depth + 1), guard, list(initial_states))
        for position, (value, varies) in enumerate(zip(initial_states, varying, strict=True)):
            state_varies = varies or value.varying
            loop.states.append(
                Value(Operation.STATE, value.dtype, detail=(loop, position), varying=state_varies, block=loop.body)
            )
        self.here = loop.body
        return loop

    def end_loop(self, loop: CodeLoop, next_states: Sequence[Value], proceed: Value) -> list[Value]:
        """End a loop, and return its states after it.

        Args:
            loop: The loop that :meth:`loop` began.
            next_states: States after a turn.
            proceed: Condition for another turn, the same in all lanes.
        """
        loop.next_states = list(next_states)
        loop.proceed = proceed
        self.here = loop.body.parent or loop.body  # the body of a loop always has a parent
        self.here.nodes.append(loop)
        loop.results = [
            Value(Operation.RESULT, state.dtype, detail=(loop, position), varying=state.varying, block=self.here)
            for position, state in enumerate(loop.states)
        ]
        return loop.results

    def branch(self, condition: Value, sides: Sequence[Callable[[], list[Value]]]) -> list[Value]:
        """Add a branch, and return its results.

        Args:
            condition: Whether a lane takes the first of the two sides.
            sides: Two functions, each of which builds one side and returns the results of that side.
        """
        surrounding_block = self.here
        blocks = []
        values = []
        for build_side in sides:
            self.here = CodeBlock(surrounding_block, keeps_operations=True, depth=surrounding_block.depth + 1)
            values.append(build_side())
            blocks.append(self.here)
        self.here = surrounding_block
        branch = Branch(condition, (blocks[0], blocks[1]), (values[0], values[1]))
        surrounding_block.nodes.append(branch)
        for position, (first, second) in enumerate(zip(*values, strict=True)):
            varying = condition.varying or first.varying or second.varying
            detail = branch, position
            branch.results.append(
                Value(Operation.JOINED, first.dtype, detail=detail, varying=varying, block=surrounding_block)
            )
        return branch.results

    def record(self, recording: Recording, position: Value, value: Value) -> None:
        """Store a value in a recording whenever the present block runs; all lanes store at the same position."""
        self.here.nodes.append(Record(recording, position, value))

    def _regrouped(self, operation: str, operands: Sequence[Value]) -> Value | None:
        """Return an equal product or quotient with fewer operations in inner blocks; None if no such form is known.

        Equal means: up to rounding. Sums are never regrouped, because the order of a sum decides what cancels.

        Args:
            operation: The operation; any other than "div" and "mul" gives None.
            operands: The operands, floating-point numbers.
        """
        if operation == "div":
            dividend, divisor = operands
            return self._quotient_by_inverse(dividend, divisor)
        if operation == "mul":
            for first, second in (operands, operands[::-1]):
                regrouped = self._product_with_square(first, second) or self._product_outside_in(first, second)
                if regrouped is not None:
                    return regrouped
        return None

    def _product_with_square(self, product: Value, root: Value) -> Value | None:
        """Return (x root) root as x |y|, where root is the square root of |y|; None for other operands."""
        if root.operation != "sqrt" or product.operation != "mul" or root not in product.operands:
            return None
        (radicand,) = root.operands
        first, second = product.operands
        factor = second if first is root else first
        return self.add("mul", factor, radicand) if radicand.operation == "abs" else None

    def _quotient_by_inverse(self, dividend: Value, divisor: Value) -> Value | None:
        """Return the quotient as a product with 1/divisor, which is computed before a loop; else None.

        This requires a divisor that is known in an outer block of the one in which the dividend is known, and an
        inverse that is a normal number if it is a constant.
        """
        if self._depth_of(divisor) >= self._depth_of(dividend):
            return None
        inverse = self.add("div", self.constant(1.0, divisor.dtype), divisor)
        return self.add("mul", dividend, inverse) if is_normal_or_varies(inverse) else None

    def _product_outside_in(self, product: Value, factor: Value) -> Value | None:
        """Return (late early) factor as late (early factor), so that ``early factor`` is hoisted out of a loop.

        Returns:
            The regrouped product; None if ``product`` is no product, if neither of its factors is known in a deeper
            block than the other two numbers, or if the constant early * factor would overflow or underflow.
        """
        if product.operation != "mul":
            return None
        first, second = product.operands
        for late, early in ((first, second), (second, first)):
            if max(self._depth_of(early), self._depth_of(factor)) < self._depth_of(late):
                early_product = self.add("mul", early, factor)
                if is_normal_or_varies(early_product):
                    return self.add("mul", late, early_product)
        return None

    def _depth_of(self, value: Value) -> int:
        """Return the depth of the block to which an operation on this value alone is hoisted; -1 for a constant."""
        return -1 if value.operation == "constant" else self._home([value]).depth

    def _home(self, operands: Sequence[Value]) -> CodeBlock:
        """Return the block to which an operation on some operands is hoisted.

        It is the outermost block in which all operands are known, but never outside a side of a branch.
        """
        deepest = max((operand.block.depth for operand in operands if operand.block is not None), default=0)
        block = self.here
        while block.depth > deepest and not block.keeps_operations and block.parent is not None:
            block = block.parent
        return block

    def _place(
        self,
        operation: str,
        dtype: np.dtype,
        operands: tuple[Value, ...],
        *,
        detail: Any,
        varying: bool,
        home: CodeBlock,
    ) -> Value:
        """Return the value of an operation, as one that exists already or as a new one in the block ``home``.

        An equal value is sought in ``home`` and in the blocks around it.

        Args:
            operation: The operation.
            dtype: Dtype of the result.
            operands: The operands.
            detail: What the operation needs beside its operands.
            varying: Whether the result may differ between lanes.
            home: The block for a new value.
        """
        # values are compared by identity: equal operands are already one object
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
    """Whether a factor may be used in a regrouped product.

    A constant must be a normal number: neither 0, subnormal, infinite nor NaN. Any other value is accepted.
    """
    if factor.operation != "constant":
        return True
    return bool(np.finfo(factor.dtype).tiny <= abs(factor.detail) < np.inf)


def simplified(operation: str, operands: Sequence[Value], dtype: np.dtype) -> Value | None:
    """Return the operand that always equals the result of an operation, to the last bit; None if no operand does.

    Args:
        operation: The operation.
        operands: The operands.
        dtype: Dtype of the result.
    """
    first = operands[0]
    first_is_constant = first.operation == "constant"
    if operation in ("convert", "bitcast"):
        return first if first.dtype == dtype else None
    if operation == "any":
        return first if first_is_constant else None
    if operation == "rarely":  # its operands: the condition, the usual value, the subroutine's arguments
        return operands[1] if first_is_constant and not first.detail else None
    if operation == "select":
        _, if_true, if_false = operands
        if if_true is if_false:
            return if_true
        if first_is_constant:
            return if_true if first.detail else if_false
    if operation in ("and", "or", "mul"):
        second = operands[1]
        if is_neutral(first, operation) or (first is second and operation != "mul"):
            return second
        if is_neutral(second, operation):
            return first
    return None


def is_neutral(operand: Value, operation: str) -> bool:
    """Whether ``operation`` with this operand returns the other operand.

    This holds for a constant: 1 for "mul", true for "and", false for "or".
    """
    if operand.operation != "constant":
        return False
    if operation == "mul":
        return bool(operand.detail == 1)
    return operand.dtype == BOOL and bool(operand.detail) == (operation == "and")
