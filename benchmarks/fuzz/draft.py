"""A random program under construction, and how an operation finds its operands."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.fuzz.operations import OPERATIONS
from benchmarks.fuzz.program import Kind, Node, Program, abstract
from benchmarks.fuzz.values import FLOATS, SLOTS, hostile, ordinary

KNOWN_KINDS: dict[Any, Kind | None] = {}
"""Result of each operation on operands of each kind; None: JAX refuses them."""


class Misfit(Exception):
    """JAX does not take these operands."""


class Draft:
    """Adds operations to a program.

    Args:
        rng: Source of all choices.
        inputs: Kinds of the inputs of an inner program; None: inputs are added as they are needed.
    """

    def __init__(self, rng: np.random.Generator, inputs: Sequence[Kind] | None = None) -> None:
        self.rng, self.inner = rng, inputs is not None
        self.wanted: list[tuple[str, int]] = []
        self.inner_inputs = list(inputs or ())
        self.nodes: list[Node] = []
        self.kinds: dict[int, Kind] = dict(enumerate(self.inner_inputs))
        self.fresh = 1000  # numbers of operations, until all inputs are known
        self.fixed = set[int]()

    def chance(self, share: float) -> bool:
        """True in a share of the cases."""
        return bool(self.rng.random() < share)

    def pick(self, choices: Sequence[Any]) -> Any:
        """One of several."""
        return choices[int(self.rng.integers(len(choices)))]

    def add(self, operation: str, operands: Sequence[int] = (), **params: Any) -> int:
        """An operation; the number of its result.

        Raises:
            Misfit: JAX refuses the operands.
        """
        known = self.fixed.issuperset(operands)
        if operation == "convert" and known:
            raise Misfit("JAX itself converts a constant, as NumPy does")
        kind = result_kind(operation, params, [self.kinds[i] for i in operands])
        number, self.fresh = self.fresh, self.fresh + 1
        self.nodes.append(Node(operation, tuple(operands), params, kind))
        self.kinds[number] = kind
        if operation == "constant" or (operation == "stop_gradient" and known):
            self.fixed.add(number)
        return number

    def constant(self, dtype: str, shape: tuple[int, ...] = ()) -> int:
        """A hostile or an ordinary constant, or a table of them."""
        size = int(np.prod(shape))
        numbers = self.rng.choice(hostile(dtype), size) if self.chance(0.6) else ordinary(dtype, size, self.rng)
        return self.add("constant", value=numbers.reshape(shape))

    def input(self, dtype: str) -> int:
        """An input of a type."""
        if self.inner:
            fitting = [i for i in range(len(self.inner_inputs)) if self.kinds[i] == Kind(dtype)]
            return self.pick(fitting) if fitting else self.constant(dtype)
        wanted = dtype, int(self.rng.integers(SLOTS))
        if wanted not in self.wanted:
            self.wanted.append(wanted)
            self.kinds[self.wanted.index(wanted)] = Kind(dtype)
        return self.wanted.index(wanted)

    def scalar(self, dtype: str) -> int:
        """A scalar of a type: a value of before, an input, a constant, or a conversion."""
        fitting = [i for i, kind in self.kinds.items() if kind == Kind(dtype)]
        if fitting and self.chance(0.6):
            return fitting[-1] if self.chance(0.5) else self.pick(fitting)
        sources = [i for i, kind in self.kinds.items() if not kind.shape and i >= 1000 and i not in self.fixed]
        if sources and self.chance(0.15):
            return self.add("convert", [self.pick(sources)], dtype=dtype)
        return self.constant(dtype) if self.chance(0.2) else self.input(dtype)

    def array(self, dtype: str, shape: tuple[int, ...]) -> int:
        """An array of a type and shape: a value of before, a table, or scalars together."""
        fitting = [i for i, kind in self.kinds.items() if kind == Kind(dtype, shape)]
        if fitting and self.chance(0.6):
            return self.pick(fitting)
        if self.chance(0.25):
            return self.constant(dtype, shape)
        size = int(np.prod(shape))
        line = self.add("stack", [self.scalar(dtype) for _ in range(size)])
        return line if len(shape) == 1 else self.add("reshape", [line], shape=shape)

    def index(self) -> int:
        """An integer of any type."""
        dtype = self.pick(("int32", "int64", "uint8", "int8", "uint32", "uint64", "int16", "uint16"))
        if self.chance(0.3):
            return self.add("constant", value=np.array(self.rng.integers(-3, 12)).astype(dtype))
        return self.scalar(dtype)

    def program(self, outputs: Sequence[int]) -> Program:
        """The finished program; its values are numbered anew."""
        inputs = self.inner_inputs if self.inner else [Kind(dtype) for dtype, _ in self.wanted]
        count = len(inputs)

        def renamed(number: int) -> int:
            return number if number < 1000 else number - 1000 + count

        nodes = [Node(n.operation, tuple(map(renamed, n.operands)), n.params, n.kind) for n in self.nodes]
        slots = [slot for _, slot in self.wanted]
        return needed_part(Program(list(inputs), slots, nodes, [renamed(output) for output in outputs]))


def needed_part(program: Program) -> Program:
    """The program without what its outputs do not read; an inner program keeps its inputs."""
    count = len(program.inputs)
    alive = set(program.outputs)
    for number in range(count + len(program.nodes) - 1, count - 1, -1):
        if number in alive:
            alive.update(program.nodes[number - count].operands)
    outer = bool(program.slots)
    inputs = [i for i in range(count) if i in alive or not outer]
    kept = [*inputs, *(i for i in range(count, count + len(program.nodes)) if i in alive)]
    place = {old: new for new, old in enumerate(kept)}
    nodes = [
        Node(node.operation, tuple(place[i] for i in node.operands), node.params, node.kind)
        for number, node in enumerate(program.nodes, count)
        if number in alive
    ]
    slots = [program.slots[i] for i in inputs] if outer else []
    return Program([program.inputs[i] for i in inputs], slots, nodes, [place[i] for i in program.outputs])


def of_body(params: dict[str, Any], kinds: Sequence[Kind]) -> Kind:
    """The kind of an inner program's result."""
    body = params["body"] if "body" in params else params["sides"][0]
    return body.kinds()[body.outputs[0]]


def of_scan(params: dict[str, Any], kinds: Sequence[Kind]) -> Kind:
    """The kind of a state, or of what is recorded of it."""
    return Kind(kinds[0].dtype, (kinds[1].shape[0],)) if params["record"] else kinds[0]


INNER_RESULT = {**dict.fromkeys(("call", "cond", "switch", "fori", "while"), of_body), "scan": of_scan}
"""Kinds of results of what has inner programs."""


def signature(operation: str, params: dict[str, Any], kinds: Sequence[Kind]) -> Any:
    """A key of what decides the kind of a result, and the code of one operation."""
    fixed = tuple((name, value.tobytes() if isinstance(value, np.ndarray) else value) for name, value in params.items())
    return operation, fixed, tuple(kinds)


def result_kind(operation: str, params: dict[str, Any], kinds: Sequence[Kind]) -> Kind:
    """Type and shape of an operation's result.

    Raises:
        Misfit: JAX refuses the operands.
    """
    if operation == "constant":
        return Kind(params["value"].dtype.name, params["value"].shape)
    if operation in INNER_RESULT:
        return INNER_RESULT[operation](params, kinds)
    key = signature(operation, params, kinds)
    if key not in KNOWN_KINDS:
        try:
            shape = jax.eval_shape(lambda *operands: OPERATIONS[operation](params, *operands), *abstract(kinds))
            found = Kind(jnp.dtype(shape.dtype).name, tuple(shape.shape))
        except (TypeError, ValueError):
            found = None
        KNOWN_KINDS[key] = found
    known = KNOWN_KINDS[key]
    if known is None:
        raise Misfit(operation)
    return known


def is_float(dtype: str) -> bool:
    """Whether a type is a floating-point one."""
    return dtype in FLOATS
