"""Arrays that a loop carries and accesses one element at a time, at an index that is the same in all lanes.

They stay in the memory of a vector of lanes: an access costs one instruction, however long the array is. An access is
an operation on a *token*, which stands for the content at that point of the program, so every pass keeps the order of
the accesses.
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
"""Smallest length of an array that stays in memory; the elements of a shorter one become scalars."""
LARGEST = 8192
INDEX_TYPE = np.dtype(np.int32)


@dataclass(eq=False)
class Memory:
    """The content of a slot at a point of the program.

    Args:
        slot: The slot.
        token: The value that stands for the content.
        reads: The reads of this content so far, after which a later write must come.
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
        """The content after an operation that returns the token; it replaces this content."""
        self.is_overwritten = True
        return Memory(self.slot, token)

    def require_current(self) -> None:
        """Require that no later content has replaced this one.

        Raises:
            Unsupported: One has.
        """
        if self.is_overwritten:
            raise Unsupported("an array that is read after it was written")

    def read(self, build: Builder, index: Value) -> Value:
        """The element at an index.

        Raises:
            Unsupported: The index differs between lanes, or a later content has replaced this one.
        """
        self.require_current()
        value = build.read(self.slot, self.token, clamped_position(build, index, self.slot.length))
        self.reads.append(value)
        return value

    def write(self, build: Builder, index: Value, value: Value) -> "Memory":
        """The content after a value was written at an index.

        Raises:
            Unsupported: The index differs between lanes, or a later content has replaced this one.
        """
        self.require_current()
        position = clamped_position(build, index, self.slot.length)
        return self.successor(build.write(self.slot, self.token, position, value, self.reads))

    def initial_token(self) -> Value:
        """The token with which a loop begins that carries the array.

        Raises:
            Unsupported: The content was read before, and the loop may overwrite it.
        """
        self.require_current()
        if self.reads:
            raise Unsupported("an array that is read before a loop writes it")
        return self.token


def clamped_position(build: Builder, index: Value, length: int) -> Value:
    """An index clamped to 0 .. length - 1, as JAX does it, and converted to :data:`INDEX_TYPE`.

    Raises:
        Unsupported: The index differs between lanes.
    """
    if index.varying:
        raise Unsupported("an array of the time loop at an index that differs between lanes")
    clipped = build.add("max", index, build.constant(0, index.dtype))
    clamped_index = build.add("min", clipped, build.constant(length - 1, index.dtype))
    return build.add("convert", clamped_index, dtype=INDEX_TYPE)


def move_to_memory(build: Builder, initial_state: Sequence[Any], body: Jaxpr, first: int) -> list[Any]:
    """The initial state of a loop, with a :class:`Memory` in place of each array of zeros that can stay in memory.

    Args:
        build: The builder.
        initial_state: The initial state.
        body: The loop's body.
        first: Number of the body's operands before the state.
    """
    states = []
    for position, value in enumerate(initial_state):
        dtype = zeros_of(value)
        if dtype is not None and stays_in_place(body, first + position, position):
            slot = Slot(len(value), dtype)
            value = Memory(slot, build.memory(slot))
        states.append(value)
    return states


def zeros_of(value: Any) -> np.dtype | None:
    """The dtype of a value if it is a one-dimensional array of floating-point zeros of admissible length; else None."""
    if not isinstance(value, np.ndarray) or value.ndim != 1 or not SMALLEST <= len(value) <= LARGEST:
        return None
    elements = value
    if value.dtype == object:
        constants = {id(element): element for element in value}.values()
        if any(not isinstance(element, Value) or element.operation != "constant" for element in constants):
            return None
        elements = np.array([element.detail for element in constants])
    return elements.dtype if elements.dtype.kind == "f" and not np.any(elements.view(f"u{elements.itemsize}")) else None


def stays_in_place(body: Jaxpr, operand: int, result: int) -> bool:
    """Whether a body only accesses single elements of an operand, and returns it as one result alone.

    Args:
        body: The body.
        operand: Position of the operand.
        result: Position of the result.
    """
    return versions(body, body.invars[operand]) == [result]


def versions(jaxpr: Jaxpr, array: Var) -> list[int] | None:
    """Positions of the results that are later versions of an array.

    Returns:
        None if the program does more with the array than access single elements of it.
    """
    version_variables: set[Any] = {array}
    for equation in jaxpr.eqns:
        operands = enumerate(equation.invars)
        operand_positions = [i for i, atom in operands if isinstance(atom, Var) and atom in version_variables]
        if not operand_positions:
            continue
        changed = versions_of(equation, operand_positions)
        if changed is None:
            return None
        version_variables |= {equation.outvars[i] for i in changed}
    return [i for i, atom in enumerate(jaxpr.outvars) if isinstance(atom, Var) and atom in version_variables]


def versions_of(equation: JaxprEqn, operand_positions: list[int]) -> list[int] | None:
    """As :func:`versions`, for one equation.

    Args:
        equation: The equation.
        operand_positions: Positions of the array, or of later versions of it, among the operands.
    """
    name = equation.primitive.name
    params = equation.params
    if name == "dynamic_slice":
        return [] if operand_positions == [0] and tuple(params["slice_sizes"]) == (1,) else None
    if name == "dynamic_update_slice":
        single = getattr(equation.invars[1].aval, "shape", None) == (1,)
        return [0] if operand_positions == [0] and single else None
    if len(operand_positions) > 1 or name == "cond":
        return None
    (operand,) = operand_positions
    if name == "while":
        condition_constants = params["cond_nconsts"]
        state = operand - condition_constants - params["body_nconsts"]
        tests = versions(params["cond_jaxpr"].jaxpr, params["cond_jaxpr"].jaxpr.invars[condition_constants + state])
        if state < 0 or tests != []:
            return None
        return carried_versions(params["body_jaxpr"].jaxpr, operand - condition_constants, state)
    if name == "scan":
        constants, count = parts_of_scan(equation)
        state = operand - constants
        return carried_versions(params["jaxpr"].jaxpr, operand, state) if 0 <= state < count else None
    inner = params.get("jaxpr", params.get("call_jaxpr"))
    if not isinstance(inner, ClosedJaxpr | Jaxpr):
        return None
    program = inner.jaxpr if isinstance(inner, ClosedJaxpr) else inner
    return versions(program, program.invars[operand]) if len(program.invars) == len(equation.invars) else None


def carried_versions(body: Jaxpr, operand: int, state: int) -> list[int] | None:
    """As :func:`versions`, for a loop that carries the array.

    Args:
        body: The loop's body.
        operand: Position of the array among the body's operands.
        state: Position of the array among the loop's states.
    """
    return [state] if stays_in_place(body, operand, state) else None
