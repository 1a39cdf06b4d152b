"""A random program: a few inputs, operations on them in order, and what it returns."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import jax
import numpy as np


class Kind(NamedTuple):
    """Type and shape of a value.

    Args:
        dtype: Name of the type.
        shape: Shape within one lane.
    """

    dtype: str
    shape: tuple[int, ...] = ()


@dataclass(frozen=True, eq=False)
class Node:
    """One operation.

    Args:
        operation: Its name in :data:`benchmarks.fuzz.operations.OPERATIONS`.
        operands: Numbers of the values that it reads.
        params: What is fixed: names, axes, inner programs, the number of a constant.
        kind: Type and shape of its result.
    """

    operation: str
    operands: tuple[int, ...]
    params: dict[str, Any]
    kind: Kind


@dataclass
class Program:
    """Inputs, operations and results; values are numbered, the inputs first.

    Args:
        inputs: Types and shapes of the inputs.
        slots: Which column of its type each input reads; empty for an inner program.
        nodes: The operations.
        outputs: Numbers of the values that are returned.
        lane: See :func:`scalars`; None until it is asked for.
    """

    inputs: list[Kind] = field(default_factory=list)
    slots: list[int] = field(default_factory=list)
    nodes: list[Node] = field(default_factory=list)
    outputs: list[int] = field(default_factory=list)
    lane: Any = None

    def kinds(self) -> list[Kind]:
        """Type and shape of each value."""
        return [*self.inputs, *(node.kind for node in self.nodes)]


def traceable(program: Program) -> Any:
    """The program as a function of JAX."""
    from benchmarks.fuzz.operations import OPERATIONS

    def function(*arguments: Any) -> list[Any]:
        values = list(arguments)
        for node in program.nodes:
            values.append(OPERATIONS[node.operation](node.params, *(values[i] for i in node.operands)))
        return [values[i] for i in program.outputs]

    return function


def scalars(program: Program) -> Any:
    """The program as a lane, which JAX traces once: an array that it returns becomes its elements, but a recording."""
    if program.lane is not None:
        return program.lane
    inner = traceable(program)

    def lane(*arguments: Any) -> list[Any]:
        results = []
        for number, value in zip(program.outputs, inner(*arguments), strict=True):
            if np.ndim(value) == 0 or records(program, number):
                results.append(value)
            else:
                flat = jax.lax.reshape(value, (np.size(value),))
                parts = (jax.lax.slice(flat, (i,), (i + 1,)) for i in range(np.size(value)))
                results += [jax.lax.squeeze(part, (0,)) for part in parts]
        return results

    program.lane = jax.jit(lane)
    return program.lane


def records(program: Program, number: int) -> bool:
    """Whether a value is an array that a loop records."""
    node = program.nodes[number - len(program.inputs)] if number >= len(program.inputs) else None
    return node is not None and bool(node.params.get("record"))


def all_nodes(program: Program) -> Sequence[Node]:
    """The operations, those of inner programs included."""
    found = []
    for node in program.nodes:
        found.append(node)
        for value in node.params.values():
            for inner in value if isinstance(value, tuple) else (value,):
                if isinstance(inner, Program):
                    found += all_nodes(inner)
    return found


def text(program: Program, indent: str = "") -> str:
    """The program for a reader."""
    lines = [f"{indent}inputs: " + ", ".join(
        f"v{i}: {kind.dtype}{list(kind.shape) or ''}" for i, kind in enumerate(program.inputs))]  # fmt: skip
    for i, node in enumerate(program.nodes, len(program.inputs)):
        shown, inside = [], []
        for name, value in node.params.items():
            programs = [part for part in (value if isinstance(value, tuple) else (value,)) if isinstance(part, Program)]
            if programs:
                inside += [f"{indent}    {name}:\n{text(part, indent + '    ')}" for part in programs]
            else:
                number = value if np.ndim(value) == 0 or np.size(value) < 12 else f"table of {np.size(value)}"
                shown.append(f"{name}={number!r}" if not isinstance(value, np.ndarray) else f"{name}={number}")
        operands = [f"v{j}" for j in node.operands]
        lines.append(f"{indent}v{i}: {node.kind.dtype}{list(node.kind.shape) or ''} = "
                     f"{node.operation}({', '.join([*operands, *shown])})")  # fmt: skip
        lines += inside
    return "\n".join([*lines, f"{indent}returns " + ", ".join(f"v{i}" for i in program.outputs)])


def abstract(kinds: Sequence[Kind]) -> list[jax.ShapeDtypeStruct]:
    """The kinds as JAX's descriptions."""
    return [jax.ShapeDtypeStruct(kind.shape, jax.numpy.dtype(kind.dtype)) for kind in kinds]
