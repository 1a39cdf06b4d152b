"""What a program's results should be: each operation by itself, by NumPy or by a kernel of XLA, under disturbances.

Where arithmetic has a rounding of its own choice (elementary functions, sums in any order, contraction in fast
arithmetic) the program is evaluated several times, each time with other errors of the admitted size. Where all agree
the result must be that one; their spread bounds a floating-point result; where they contradict each other, nothing
can be said.
"""

from typing import Any

import jax
import numpy as np

from benchmarks.fuzz import sums
from benchmarks.fuzz.arithmetic import EXACT, FUNCTIONS, UNITS, function_value, stepped
from benchmarks.fuzz.draft import signature
from benchmarks.fuzz.moving import MOVING, scatter
from benchmarks.fuzz.operations import OPERATIONS
from benchmarks.fuzz.program import Kind, Node, Program
from benchmarks.fuzz.values import MAIN
from benchmarks.fuzz.whole import NUMPY, WHOLE, bitcast, converted

REPLICAS = 8
FAST_UNITS = {"add": 1, "sub": 1, "mul": 2, "div": 2, "square": 2, "reciprocal": 2, "sqrt": 1}
"""Units in the last place by which contraction and regrouping change an operation, in fast arithmetic."""

KERNELS: dict[Any, Any] = {}
BATCH = 1544
"""Elements of each call of a kernel of XLA, which is compiled once for each operation."""


class Referee:
    """Evaluates programs.

    Args:
        fast: For fast arithmetic.
        replicas: How many times with other errors.
        seed: Of the errors.
    """

    def __init__(self, fast: bool, replicas: int = REPLICAS, seed: int = 0) -> None:
        self.fast, self.replicas, self.rng = fast, replicas, np.random.default_rng(seed)
        self.noisy = 0

    def results(self, program: Program, columns: list[np.ndarray]) -> list[np.ndarray]:
        """The results of a program, of shape (replicas, lanes, ...)."""
        self.noisy = 0
        lanes = len(columns[0])
        with np.errstate(all="ignore"):
            values = self.evaluated(program, [np.tile(column, self.replicas) for column in columns])
        return [value.reshape(self.replicas, lanes, *value.shape[1:]) for value in values]

    def evaluated(self, program: Program, operands: list[np.ndarray]) -> list[np.ndarray]:
        """The results on a batch."""
        values = list(operands)
        for node in program.nodes:
            values.append(self.value(node, [values[i] for i in node.operands], len(operands[0])))
        return [values[i] for i in program.outputs]

    def value(self, node: Node, operands: list[np.ndarray], count: int) -> np.ndarray:
        """The result of an operation on a batch."""
        name, params = node.operation, node.params
        if name in ("constant", "iota"):
            number = params["value"] if name == "constant" else np.arange(params["size"]).astype(params["dtype"])
            return np.broadcast_to(number, (count, *number.shape))
        if name in CONTROL:
            return CONTROL[name](self, params, operands)
        if name in MOVING:
            return MOVING[name](params, *operands)
        kinds = {operand.dtype.name for operand in operands}
        plain = kinds <= set(MAIN) and node.kind.dtype in (*MAIN, "bool")
        if name == "scatter" and kinds <= {*MAIN, *NUMPY}:
            value = scatter(params, *operands)
            if not self.fast or params["name"] == "scatter":
                return value
            return self.signless(self.within(value, sums.scattered_error(operands)))
        if name == "convert" and {*kinds, node.kind.dtype} <= {*MAIN, *NUMPY}:
            return converted(params, operands[0])
        if name in WHOLE and kinds <= set(NUMPY) and node.kind.dtype in NUMPY:
            return WHOLE[name](params, *operands)
        if plain and name in EXACT:
            return self.exact(name, params, operands)
        if name in FUNCTIONS and operands[0].dtype.name in MAIN:
            return self.function(name, operands)
        if plain and name in sums.RULES and params.get("preferred") in (None, operands[0].dtype.name):
            value, error, unclear = sums.RULES[name](params, *operands)
            return self.unclear(self.signless(self.within(value, error)), unclear)
        if name == "bitcast":
            value = bitcast(params, operands[0])
            return self.bits_of_nan(operands[0], kernel(node, operands) if value is None else value)
        value = kernel(node, operands)
        return self.by_kernel(node, operands, value) if {*kinds, node.kind.dtype} & set(MAIN) else value

    def exact(self, name: str, params: dict[str, Any], operands: list[np.ndarray]) -> np.ndarray:
        """An operation in the arithmetic of the machine; fast arithmetic may change its last bits."""
        units = FAST_UNITS.get(name, 0) if self.fast else 0
        if name == "rsqrt":
            units = 2
        if name == "integer_pow":
            units = 2 * abs(params["y"]).bit_length() if self.fast or abs(params["y"]) > 3 else 0
        if self.fast and name in (*FAST_UNITS, "neg", "rem", "rsqrt", "integer_pow"):
            operands = [self.signless(operand) for operand in operands]
        value = EXACT[name](params, *operands)
        if not units:
            return self.signless(value) if self.fast and value.dtype.name in MAIN else value
        finite = np.logical_and.reduce([np.isfinite(operand) & (operand != 0) for operand in operands])
        value = self.signless(self.disturbed(value, units, finite & ~np.isfinite(value), finite & (value == 0)))
        if name != "div":
            return value
        divisor = np.abs(operands[1])
        return self.unclear(value, (divisor > 0) & (divisor * np.finfo(value.dtype).max < 1))  # its inverse overflows

    def function(self, name: str, operands: list[np.ndarray]) -> np.ndarray:
        """An elementary function; the exponent of a power has the type of its base, as JAX converts it."""
        operands = [operand.astype(operands[0].dtype) for operand in np.broadcast_arrays(*operands)]
        value, beyond = function_value(name, operands, operands[0].dtype)
        value = self.disturbed(value, UNITS.get(name, 2), beyond & np.isinf(value), beyond & (value == 0))
        return self.signless(value) if self.fast else value

    def by_kernel(self, node: Node, operands: list[np.ndarray], value: np.ndarray) -> np.ndarray:
        """XLA's result of arithmetic; it says nothing where a number is subnormal."""
        touched = np.zeros(len(value), bool)
        for column in (*operands, value):
            if column.dtype.name in MAIN:
                tiny = np.finfo(column.dtype).tiny
                small = (np.abs(column) < tiny) & (column != 0)
                touched |= small.reshape(len(value), -1).any(1)
        if node.operation == "random":
            if node.params["way"] == "normal":
                return self.disturbed(value, 64, np.zeros(value.shape, bool), np.zeros(value.shape, bool))
            return value
        if value.dtype.name in MAIN and node.operation != "convert":
            never = np.zeros(value.shape, bool)
            value = self.signless(self.disturbed(value, 4, never, never))
        return self.unclear(value, touched)

    # Errors of the admitted size

    def spread(self, shape: tuple[int, ...]) -> np.ndarray:
        """Numbers in [-1, 1] of each replica: 0 in the first, the ends in two, then random ones."""
        factors = self.rng.uniform(-1.0, 1.0, shape)
        parts = factors.reshape(self.replicas, -1)
        parts[0] = 0.0
        if self.replicas > 2:
            parts[1], parts[2] = 1.0, -1.0
        return parts.reshape(shape)

    def disturbed(self, value: np.ndarray, units: Any, overflown: np.ndarray, vanished: np.ndarray) -> np.ndarray:
        """Changed by up to so many units in the last place; what left the type's range may also stay in it."""
        if self.replicas == 1:
            return value
        self.noisy += 1
        factors = self.spread(value.shape)
        steps = np.rint(factors * units)
        usual = np.isfinite(value) & ((value != 0) | vanished)
        moved = np.where(usual, stepped(value, np.where(usual, steps, 0).astype(np.int64)), value)
        most = np.copysign(np.finfo(value.dtype).max, value)
        return np.where(overflown & (factors < 0.0), most, moved)

    def within(self, value: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Changed by up to an absolute error."""
        if self.replicas == 1 or not np.any(error):
            return value
        self.noisy += 1
        with np.errstate(all="ignore"):
            moved = value + (self.spread(value.shape) * np.where(np.isfinite(error), error, 0.0)).astype(value.dtype)
        return np.where(error > 0, moved, value)

    def signless(self, value: np.ndarray) -> np.ndarray:
        """With zeros of either sign."""
        if self.replicas == 1 or value.dtype.name not in MAIN or not np.any(value == 0):
            return value
        flips = (self.rng.random(value.shape) < 0.5) & (self.spread(value.shape) != 0.0)
        return np.where(flips & (value == 0), -value, value)

    def unclear(self, value: np.ndarray, where: np.ndarray) -> np.ndarray:
        """Without a meaning where nothing can be said."""
        if self.replicas == 1 or not np.any(where):
            return value
        places = where.reshape(where.shape + (1,) * (value.ndim - where.ndim))
        if value.dtype.kind not in "fiu" and value.dtype != bool:
            return value
        odd = (np.arange(len(value)) * self.replicas // len(value) % 2 == 1).reshape((-1,) + (1,) * (value.ndim - 1))
        junk = np.array(np.nan if value.dtype.kind == "f" else 77).astype(value.dtype)
        replica = (np.arange(len(value)) * self.replicas // len(value)).reshape(odd.shape)
        finite = np.array(0.7 if value.dtype.kind == "f" else 5).astype(value.dtype)  # a NaN alone would hide others
        if value.dtype == bool:
            return np.where(places & odd, ~value, value)
        largest = np.array(np.inf if value.dtype.kind == "f" else np.iinfo(value.dtype).max).astype(value.dtype)
        nonsense = np.select([replica % 8 == 1, replica % 8 == 3, replica % 8 == 5], [junk, finite, largest], 0)
        nonsense = nonsense.astype(value.dtype)
        return np.where(places & odd, nonsense, value)

    def bits_of_nan(self, operand: np.ndarray, value: np.ndarray) -> np.ndarray:
        """NaN has no bits that anybody promises."""
        if operand.dtype.name in NUMPY:
            return value
        missing = np.isnan(operand if operand.dtype.kind == "c" else operand.astype(np.float64))
        missing = missing.reshape(len(value), -1).any(1)
        if self.replicas == 1 or not missing.any() or value.dtype.kind not in "iu":
            return value
        return self.unclear(value, missing)


def kernel(node: Node, operands: list[np.ndarray]) -> np.ndarray:
    """XLA's result of a single operation."""
    kinds = [Kind(operand.dtype.name, operand.shape[1:]) for operand in operands]
    key = signature(node.operation, node.params, kinds)
    if key not in KERNELS:
        KERNELS[key] = jax.jit(jax.vmap(lambda *scalars: OPERATIONS[node.operation](node.params, *scalars)))
    count, results = len(operands[0]), []
    for start in range(0, count, BATCH):
        parts = [operand[start : start + BATCH] for operand in operands]
        missing = BATCH - len(parts[0])
        if missing:
            parts = [np.concatenate([part, np.repeat(part[-1:], missing, 0)]) for part in parts]
        results.append(np.asarray(KERNELS[key](*parts))[: BATCH - missing])
    return np.concatenate(results)


def chosen(mask: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> np.ndarray:
    """The first values where a mask holds, the second elsewhere."""
    return np.where(mask.reshape(mask.shape + (1,) * (inside.ndim - mask.ndim)), inside, outside)


def call(referee: Referee, params: dict[str, Any], operands: list[np.ndarray]) -> np.ndarray:
    return referee.evaluated(params["body"], operands)[0]


def cond(referee: Referee, params: dict[str, Any], operands: list[np.ndarray]) -> np.ndarray:
    which, *arguments = operands
    first, second = (referee.evaluated(side, arguments)[0] for side in params["sides"])
    return chosen(which, first, second)


def switch(referee: Referee, params: dict[str, Any], operands: list[np.ndarray]) -> np.ndarray:
    which, *arguments = operands
    sides = [referee.evaluated(side, arguments)[0] for side in params["sides"]]
    number = np.clip(which.astype(np.int32), 0, len(sides) - 1)
    value = sides[-1]
    for i, side in enumerate(sides[:-1]):
        value = chosen(number == i, side, value)
    return value


def fori(referee: Referee, params: dict[str, Any], operands: list[np.ndarray]) -> np.ndarray:
    states, constant = operands[:-1], operands[-1]
    for k in range(params["turns"]):
        turn = np.full(len(constant), k, np.int32)
        states = referee.evaluated(params["body"], [turn, *states, constant])
    return states[0]


def while_loop(referee: Referee, params: dict[str, Any], operands: list[np.ndarray]) -> np.ndarray:
    limit, state, *constants = operands
    most = limit.astype(np.int32) & 7
    for k in range(7):
        turn = np.full(len(state), k, np.int32)
        after = referee.evaluated(params["body"], [turn, state, *constants])[0]
        state = chosen(k < most, after, state)
    return state


def scan(referee: Referee, params: dict[str, Any], operands: list[np.ndarray]) -> np.ndarray:
    state, rows, *constants = operands
    order, samples = range(rows.shape[1]), []
    for k in reversed(order) if params["reverse"] else order:
        state = referee.evaluated(params["body"], [rows[:, k], state, *constants])[0]
        samples.append(state)
    return np.stack(samples, 1) if params["record"] else state


CONTROL = {"call": call, "cond": cond, "switch": switch, "fori": fori, "while": while_loop, "scan": scan}
"""Calls, branches and loops, turn by turn."""
