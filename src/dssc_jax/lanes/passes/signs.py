"""Values whose sign bit is known to be 0, also that of a NaN. Their order is that of their bits as integers."""

import numpy as np

from dssc_jax.lanes.program import Value


def is_unsigned(value: Value, assumed_states: frozenset[tuple[int, int]] = frozenset()) -> bool:
    """Whether a floating-point number has no sign, such as |x| and the largest of several.

    Args:
        value: The number.
        assumed_states: States of loops that are already assumed to have no sign, by the loop's identity and their
            position: a state has no sign if it begins without one and a turn does not add one.
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
