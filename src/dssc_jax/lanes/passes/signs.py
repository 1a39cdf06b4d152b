"""Sign analysis: values whose sign bit is always 0, even as a NaN. Their order is that of their bits as integers."""

import numpy as np

from dssc_jax.lanes.program import Value


def is_unsigned(value: Value, assumed_states: frozenset[tuple[int, int]] = frozenset()) -> bool:
    """Whether the sign bit of a floating-point number is always 0, as in |x|.

    A state of a loop has no sign bit if it begins without a sign bit and no turn sets it. This is shown by induction.

    Args:
        value: The number.
        assumed_states: States whose sign bit the induction assumes to be 0, as (id of the loop, position).
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
            if state in assumed_states:
                return True
            assigned_values = loop.initial_states[position], loop.next_states[position]
            return all(is_unsigned(assigned, assumed_states | {state}) for assigned in assigned_values)
    return False
