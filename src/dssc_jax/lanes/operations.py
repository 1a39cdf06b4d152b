"""The operations of a lane's program."""

from enum import StrEnum

import numpy as np


class Operation(StrEnum):
    """An operation of a value."""

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
    """Whether a truth value holds in any of the lanes that run together."""
    LOOKUP = "lookup"
    """An element of a table."""
    RARELY = "rarely"
    """With a condition, a value and arguments: the result of a subroutine where the condition holds, else the value."""
    FOREIGN = "foreign"
    """A call of a function of C for each lane, with the function as its detail; its results are its parts."""
    PART = "part"
    """The result of a call at a position."""
    CONSTANT = "constant"
    INPUT = "input"
    STATE = "state"
    """A number that a loop carries, within its body."""
    RESULT = "result"
    """The same after the loop."""
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
