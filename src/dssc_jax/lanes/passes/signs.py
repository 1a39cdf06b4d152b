"""Values whose sign bit is known to be 0, also that of a NaN. Their order is that of their bits as integers."""

import numpy as np

from dssc_jax.lanes.program import Value


def is_unsigned(value: Value, within: frozenset[tuple[int, int]] = frozenset()) -> bool:
    """Whether a floating-point number has no sign, such as |x| and the largest of several.

    Args:
        value: The number.
        within: States of loops, by the loop's identity and their position, of which it is already assumed: a state has
            no sign if it begins without and a turn does not add one.
    """
    match value.operation:
        case "abs":
            return True
        case "constant":
            return bool(value.detail >= 0) and not np.signbit(value.detail)
        case "max":
            return all(is_unsigned(operand, within) for operand in value.operands)
        case "select":
            return all(is_unsigned(case, within) for case in value.operands[1:])
        case "state" | "result":
            loop, position = value.detail
            state = id(loop), position
            ends = loop.begin[position], loop.following[position]
            return state in within or all(is_unsigned(end, within | {state}) for end in ends)
    return False
