"""Sign analysis: values whose sign bit is always 0, also as a NaN. Their order is that of their bits as integers."""

import numpy as np

from dssc_jax.lanes.program import Value


def is_unsigned(value: Value, assumed_states: frozenset[tuple[int, int]] = frozenset()) -> bool:
    """Whether the sign bit of a floating-point number is always 0, as that of |x|.

    A state of a loop has no sign if it begins without one and no turn adds one. This is shown by induction.

    Args:
        value: The number.
        assumed_states: States that the induction assumes to have no sign, by the id of the loop and their position.
    """
    match value.operation:
        case "abs":
            return True
        case "constant":
            return bool(value.detail >= 0) and not np.signbit(value.detail)
        case "max":
            return all(is_unsigned(operand, assumed_states) for operand in value.operands)
        case "select":
            return all(is_unsigned(case, assumed_states) for case in value.operands[1:])
        case "state" | "result":
            loop, position = value.detail
            state = id(loop), position
            ends = loop.initial_states[position], loop.next_states[position]
            return state in assumed_states or all(is_unsigned(end, assumed_states | {state}) for end in ends)
    return False
