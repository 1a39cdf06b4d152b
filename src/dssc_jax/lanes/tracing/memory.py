"""Arrays that a loop carries and accesses one element at a time, at an index that is the same in all lanes.

Such an array stays in the memory of a vector of lanes: an access costs one instruction, however long the array is. An
access is an operation on a *token*, a value that stands for the content of the array at that point of the program. So
every pass keeps the order of the accesses.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jax.extend.core import ClosedJaxpr, Jaxpr, JaxprEqn, Var

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.program import Slot, Value
from dssc_jax.lanes.tracing.varying import parts_of_scan
from dssc_jax.lanes.unsupported import Unsupported

SMALLEST = 8
"""Smallest length of an array that stays in memory; the elements of a shorter array become scalars."""
LARGEST = 8192
"""Largest length of an array that stays in memory."""
INDEX_TYPE = np.dtype(np.int32)


@dataclass(eq=False)
class Memory:
    """The content of a slot at a point of the program.

    Args:
        slot: The slot.
        token: The value that stands for the content.
        reads: The reads of this content so far; a write must come after them.
        is_overwritten: Whether a later content has replaced this one.
    """

    slot: Slot
    token: Value
    reads: list[Value] = field(default_factory=list)
    is_overwritten: bool = False

    @property
    def shape(self) -> tuple[int]:
        """Shape of the array."""
        return (self.slot.length,)

    def successor(self, token: Value) -> "Memory":
        """Mark this content as overwritten, and return the content that replaces it.

        Args:
            token: The token of the new content, which a write or a loop returns.
        """
        self.is_overwritten = True
        return Memory(self.slot, token)

    def require_current(self) -> None:
        """Require that no later content has replaced this one.

        Raises:
            Unsupported: A later content has replaced this one.
        """
        if self.is_overwritten:
            raise Unsupported("an array that is read after it was written")

    def read(self, build: Builder, index: Value) -> Value:
        """Return the element at an index, which is clamped to the array.

        Raises:
            Unsupported: The index differs between lanes, or a later content has replaced this one.
        """
        self.require_current()
        value = build.read(self.slot, self.token, clamped_position(build, index, self.slot.length))
        self.reads.append(value)
        return value

    def write(self, build: Builder, index: Value, value: Value) -> "Memory":
        """Write a value at an index, which is clamped to the array; return the new content.

        Raises:
            Unsupported: The index differs between lanes, or a later content has replaced this one.
        """
        self.require_current()
        position = clamped_position(build, index, self.slot.length)
        return self.successor(build.write(self.slot, self.token, position, value, self.reads))

    def initial_token(self) -> Value:
        """Return the token of this content, as the initial state of a loop that carries the array.

        Raises:
            Unsupported: The content was read before the loop, which may overwrite it, or was replaced already.
        """
        self.require_current()
        if self.reads:
            raise Unsupported("an array that is read before a loop writes it")
        return self.token


def clamped_position(build: Builder, index: Value, length: int) -> Value:
    """Return an index clamped to 0, ..., length - 1, as JAX clamps it, and converted to :data:`INDEX_TYPE`.

    Raises:
        Unsupported: The index differs between lanes.
    """
    if index.varying:
        raise Unsupported("an array of the time loop at an index that differs between lanes")
    not_negative = build.add("max", index, build.constant(0, index.dtype))
    clamped_index = build.add("min", not_negative, build.constant(length - 1, index.dtype))
    return build.add("convert", clamped_index, dtype=INDEX_TYPE)


def move_to_memory(build: Builder, initial_state: Sequence[Any], body: Jaxpr, first_state: int) -> list[Any]:
    """Return the initial state of a loop, with a :class:`Memory` in place of each array that can stay in memory.

    Such an array begins with zeros only, and the body accesses single elements of the array alone.

    Args:
        build: The builder.
        initial_state: The initial state.
        body: The loop's body.
        first_state: Position of the first state among the body's operands.
    """
    states = []
    for position, value in enumerate(initial_state):
        dtype = dtype_of_zeros(value)
        if dtype is not None and stays_in_place(body, first_state + position, position):
            slot = Slot(len(value), dtype)
            states.append(Memory(slot, build.memory(slot)))
        else:
            states.append(value)
    return states


def dtype_of_zeros(value: Any) -> np.dtype | None:
    """Return the dtype of a one-dimensional array of floating-point zeros (+0) of a length that stays in memory.

    The result is None for any other value.
    """
    if not isinstance(value, np.ndarray) or value.ndim != 1 or not SMALLEST <= len(value) <= LARGEST:
        return None
    numbers = distinct_constants(value) if value.dtype == object else value
    if numbers is None or numbers.dtype.kind != "f":
        return None
    bits = numbers.view(f"u{numbers.itemsize}")  # -0 has a bit that is set
    return None if np.any(bits) else numbers.dtype


def distinct_constants(values: np.ndarray) -> np.ndarray | None:
    """Return the different numbers in an array of constants; None if an element is no constant."""
    distinct = {id(element): element for element in values}.values()
    if any(not isinstance(element, Value) or element.operation != "constant" for element in distinct):
        return None
    return np.array([element.detail for element in distinct])


def stays_in_place(body: Jaxpr, operand: int, result: int) -> bool:
    """Whether a loop's body only accesses single elements of an array, and returns the array as one certain result.

    Args:
        body: The body.
        operand: Position of the array among the body's operands.
        result: Position of the result as which the body returns the array.
    """
    return versions(body, body.invars[operand]) == [result]


def versions(jaxpr: Jaxpr, array: Var) -> list[int] | None:
    """Find the results of a program that are later versions of an array: the array, perhaps with changed elements.

    Args:
        jaxpr: The program.
        array: The variable of the array.

    Returns:
        The positions of these results; None if the program does more with the array than access single elements.
    """
    version_variables: set[Any] = {array}
    for equation in jaxpr.eqns:
        operand_positions = positions_among(equation.invars, version_variables)
        if not operand_positions:
            continue
        result_positions = versions_after_equation(equation, operand_positions)
        if result_positions is None:
            return None
        version_variables |= {equation.outvars[i] for i in result_positions}
    return positions_among(jaxpr.outvars, version_variables)


def positions_among(atoms: Sequence[Any], variables: set[Any]) -> list[int]:
    """Return the positions of the operands or results that are in a set of variables.

    Literals are left out first, because they have no hash.
    """
    return [i for i, atom in enumerate(atoms) if isinstance(atom, Var) and atom in variables]


def versions_after_equation(equation: JaxprEqn, operand_positions: list[int]) -> list[int] | None:
    """Find the results of one equation that are later versions of an array.

    Args:
        equation: The equation.
        operand_positions: Positions of the array, or of later versions of it, among the operands.

    Returns:
        The positions of these results, [] if the equation only reads elements; None if it does anything else with the
        array than access single elements.
    """
    name = equation.primitive.name
    params = equation.params
    if name == "dynamic_slice":
        reads_one_element = operand_positions == [0] and tuple(params["slice_sizes"]) == (1,)
        return [] if reads_one_element else None
    if name == "dynamic_update_slice":
        writes_one_element = operand_positions == [0] and getattr(equation.invars[1].aval, "shape", None) == (1,)
        return [0] if writes_one_element else None
    if len(operand_positions) > 1 or name == "cond":
        return None
    operand = operand_positions[0]
    if name == "while":
        return versions_after_while(equation, operand)
    if name == "scan":
        constants, count = parts_of_scan(equation)
        state = operand - constants
        return versions_after_loop(params["jaxpr"].jaxpr, operand, state) if 0 <= state < count else None
    inner = params.get("jaxpr", params.get("call_jaxpr"))
    if not isinstance(inner, ClosedJaxpr | Jaxpr):
        return None
    program = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
    return versions(program, program.invars[operand]) if len(program.invars) == len(equation.invars) else None


def versions_after_while(equation: JaxprEqn, operand: int) -> list[int] | None:
    """Find the result of a while loop that is the later version of an array which the loop carries.

    Args:
        equation: The loop; its operands are the condition's constants, the body's constants, and the initial states.
        operand: Position of the array among the operands.

    Returns:
        A list of the one position; None if the loop does not carry the array, if its condition does more than read
        single elements, or if its body does more than access single elements.
    """
    params = equation.params
    head_constants = params["cond_nconsts"]
    state = operand - head_constants - params["body_nconsts"]
    if state < 0:
        return None
    head = params["cond_jaxpr"].jaxpr
    if versions(head, head.invars[head_constants + state]) != []:
        return None
    return versions_after_loop(params["body_jaxpr"].jaxpr, operand - head_constants, state)


def versions_after_loop(body: Jaxpr, operand: int, state: int) -> list[int] | None:
    """Find the result of a loop that is the later version of an array which the loop carries.

    Args:
        body: The loop's body.
        operand: Position of the array among the body's operands.
        state: Position of the array among the loop's states.

    Returns:
        ``[state]``; None if the body does more with the array than access single elements.
    """
    return [state] if stays_in_place(body, operand, state) else None
