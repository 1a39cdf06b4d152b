"""The operations of a lane's program."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Any

import numpy as np


class Operation(StrEnum):
    """An operation that computes a value of a lane's program; a note below a name adds what the name does not say."""

    ADD = "add"
    SUB = "sub"
    MUL = "mul"
    DIV = "div"
    """Integers are truncated towards zero, as in ``rem``."""
    REM = "rem"
    NEG = "neg"
    ABS = "abs"
    SQRT = "sqrt"
    MAX = "max"
    MIN = "min"
    FLOOR = "floor"
    CEIL = "ceil"
    ROUND = "round"
    TRUNC = "trunc"
    AND = "and"
    OR = "or"
    XOR = "xor"
    NOT = "not"
    SHL = "shl"
    SHR = "shr"
    """Keeps the sign of a signed integer."""
    EQ = "eq"
    NE = "ne"
    LT = "lt"
    LE = "le"
    GT = "gt"
    GE = "ge"
    SELECT = "select"
    """The second operand where the first is true, else the third."""
    CONVERT = "convert"
    BITCAST = "bitcast"
    ANY = "any"
    """Whether a truth value is true in any of the lanes that run together."""
    LOOKUP = "lookup"
    """An element of a table."""
    RARELY = "rarely"
    """The result of a subroutine where a condition is true, else a value; operands: condition, value, arguments."""
    MEMORY = "memory"
    """A slot of memory, full of zeros; the token of its content."""
    READ = "read"
    """An element of a slot; operands: token, index."""
    WRITE = "write"
    """The token after an element of a slot was written; operands: token, index, value, and earlier reads."""
    FOREIGN = "foreign"
    """A call of a function of C for each lane, with the function as its detail; ``part`` gives its results."""
    PART = "part"
    """One result of a call of a function of C, with its position as the detail."""
    CONSTANT = "constant"
    INPUT = "input"
    STATE = "state"
    """A number that a loop carries, within its body."""
    RESULT = "result"
    """A number that a loop carries, after the loop."""
    JOINED = "joined"
    """The result of a branch."""


COMPARISONS: dict[str, np.ufunc] = {
    "eq": np.equal, "ne": np.not_equal, "lt": np.less, "le": np.less_equal, "gt": np.greater, "ge": np.greater_equal,
}  # fmt: skip
"""Operations whose result is a truth value, and NumPy's function of each."""

ARITHMETIC: dict[str, np.ufunc] = {
    "add": np.add, "sub": np.subtract, "mul": np.multiply, "neg": np.negative, "abs": np.abs, "sqrt": np.sqrt,
    "max": np.maximum, "min": np.minimum, "floor": np.floor, "ceil": np.ceil, "round": np.rint, "trunc": np.trunc,
    "and": np.bitwise_and, "or": np.bitwise_or, "xor": np.bitwise_xor, "not": np.invert, "shl": np.left_shift,
    "shr": np.right_shift,
}  # fmt: skip
"""Operations whose result has the type of their operands, and NumPy's function of each."""


def constant_result(operation: str, numbers: Sequence[Any], dtype: np.dtype, detail: Any) -> Any:
    """Compute the result of an operation on constants, once when the program is built.

    Args:
        operation: The operation.
        numbers: The constants.
        dtype: Dtype of the result.
        detail: The table of a ``lookup``; not used by other operations.

    Returns:
        The result; None if the operation must run on the machine, because NumPy could give another result.
    """
    with np.errstate(all="ignore"):
        if operation in COMPARISONS:
            return COMPARISONS[operation](*numbers)
        if operation in ARITHMETIC:
            return ARITHMETIC[operation](*numbers)
        if operation == "div" and dtype.kind == "f":
            return np.divide(*numbers)
        if operation == "convert" and not (dtype.kind in "iu" and numbers[0].dtype.kind == "f"):
            return np.asarray(numbers[0]).astype(dtype)
        if operation == "bitcast":
            return np.asarray(numbers[0]).view(dtype)
        if operation == "lookup":
            return detail[numbers[0]]
    return None
