"""C's expressions of the single operations of a program, with the bits of strict machine code.

Integers are computed as unsigned ones, for which C defines every overflow, and their bits are then taken as signed
again. Functions that C's library does not compute exactly are written out, from sums and comparisons alone.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from dssc_jax.lanes.program import BOOL, Value
from dssc_jax.lanes.unsupported import Unsupported

TERNARY, OR, AND, XOR, EQUAL, COMPARE, SHIFT, SUM, PRODUCT, UNARY, ATOM = 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11
"""Precedences, lowest first."""

SIGNS = {
    "add": ("+", SUM), "sub": ("-", SUM), "mul": ("*", PRODUCT), "div": ("/", PRODUCT), "eq": ("==", EQUAL),
    "ne": ("!=", EQUAL), "lt": ("<", COMPARE), "le": ("<=", COMPARE), "gt": (">", COMPARE), "ge": (">=", COMPARE),
    "and": ("&", AND), "or": ("|", OR), "xor": ("^", XOR),
}  # fmt: skip
LOGIC = {"and": ("&&", AND), "or": ("||", OR), "xor": ("!=", EQUAL), "eq": ("==", EQUAL), "ne": ("!=", EQUAL)}

HELPERS = {
    "maximum": """static {T} maximum{x}({T} a, {T} b)  /* not a number if either is; of zeros +0 */
{{
    if (a == 0 && b == 0) {{
        return a + b;
    }}
    return a != a ? a : (a > b ? a : b);
}}""",
    "minimum": """static {T} minimum{x}({T} a, {T} b)  /* not a number if either is; of zeros -0 */
{{
    if (a == 0 && b == 0) {{
        return -(-a - b);
    }}
    return a != a ? a : (a < b ? a : b);
}}""",
    "nearest": """static {T} nearest{x}({T} x)  /* the nearest whole number, halves to even */
{{
    const {T} whole = {digits};  /* from here on every number is whole */
    const {T} size = {fabs}(x);
    const {T} rounded = size < whole ? (size + whole) - whole : size;
    return x < 0 ? -rounded : (x > 0 ? rounded : x);
}}""",
    "round_down": """static {T} round_down{x}({T} x)
{{
    const {T} near = nearest{x}(x);
    return near > x ? near - 1 : near;
}}""",
    "round_up": """static {T} round_up{x}({T} x)
{{
    const {T} near = nearest{x}(x);
    return near < x ? -(-near - 1) : near;
}}""",
    "toward_zero": """static {T} toward_zero{x}({T} x)
{{
    const {T} near = nearest{x}({fabs}(x));
    const {T} below = near > {fabs}(x) ? near - 1 : near;
    return x < 0 ? -below : (x > 0 ? below : x);
}}""",
    "bits_of": """static {I} bits_of{x}({T} x)
{{
    union {{ {T} number; {I} bits; }} same;
    same.number = x;
    return same.bits;
}}""",
    "number_of": """static {T} number_of{x}({I} bits)
{{
    union {{ {T} number; {I} bits; }} same;
    same.bits = bits;
    return same.number;
}}""",
}
"""Definitions in C of functions of floating-point numbers that operations may need."""

HELPERS_NEEDED = {"round_down": "nearest", "round_up": "nearest", "toward_zero": "nearest", "quotient": "signed"}

INTEGER_HELPERS = {
    "signed": """static {I} signed_{w}({U} bits)
{{
    union {{ {I} number; {U} bits; }} same;
    same.bits = bits;
    return same.number;
}}""",
    "shift_right": """static {I} shift_right_{w}({I} x, {I} count)  /* keeps the sign */
{{
    return x < 0 ? ~(~x >> count) : x >> count;
}}""",
    "quotient": """static {I} quotient_{w}({I} a, {I} b)  /* towards zero; b is not 0 */
{{
    return b == -1 ? signed_{w}(0u - ({U})a) : a / b;
}}""",
    "remainder": """static {I} remainder_{w}({I} a, {I} b)  /* has the sign of a; b is not 0 */
{{
    return b == -1 ? 0 : a % b;
}}""",
    "truncated": """static {I} truncated_{w}{x}({T} x)  /* 0 for what is not a number, the extremes beyond the range */
{{
    if (x != x) {{
        return 0;
    }}
    if (x >= {top}) {{
        return {I_max};
    }}
    if (x < -{top}) {{
        return {I_min};
    }}
    return ({I})x;
}}""",
}
"""Definitions in C of functions of integers that operations may need, for any width."""


def c_type(dtype: np.dtype) -> str:
    """C's type of a dtype."""
    if dtype == BOOL:
        return "bool"
    if dtype.kind == "f":
        return {4: "float", 8: "double"}[dtype.itemsize]
    return f"{'u' if dtype.kind == 'u' else ''}int{8 * dtype.itemsize}_t"


def c_literal(number: Any, dtype: np.dtype) -> str:
    """A number as a literal in C, which compilers read back to the same bits."""
    if dtype == BOOL:
        return "true" if number else "false"
    if dtype.kind in "iu":
        wide = dtype.itemsize == 8
        if int(number) == np.iinfo(dtype).min and dtype.kind == "i":
            return f"INT{8 * dtype.itemsize}_MIN"
        macro = f"{'U' if dtype.kind == 'u' else ''}INT{8 * dtype.itemsize}_C"
        return f"{macro}({int(number)})" if wide or dtype.kind == "u" else str(int(number))
    suffix = "f" if dtype.itemsize == 4 else ""
    if math.isnan(number):
        return f"(0.0{suffix} / 0.0{suffix})"
    if math.isinf(number):
        infinity = "HUGE_VALF" if suffix else "HUGE_VAL"
        return f"-{infinity}" if number < 0 else infinity
    text = repr(float(number)) if dtype.itemsize == 8 else str(np.float32(number))
    return f"{text}{suffix}"


def with_brackets(text: str, precedence: int, surrounding: int) -> str:
    """An expression, in brackets if its precedence is below that of the surrounding operator."""
    return text if precedence >= surrounding else f"({text})"


class Notation:
    """Writes operations in C, and collects the functions that they need.

    Args:
        real: Dtype of the program's floating-point numbers.
    """

    def __init__(self, real: np.dtype) -> None:
        self.real = real
        self._needed: dict[tuple[str, np.dtype | None, str], str] = {}

    def helpers(self) -> list[str]:
        """Definitions of the functions that the operations so far need, in an order that C accepts."""
        return [
            self._needed[key]
            for key in sorted(self._needed, key=lambda key: (key[0] not in HELPERS_NEEDED.values(), str(key)))
        ]

    def require_helper(self, name: str, integer: np.dtype | None = None, real: np.dtype | None = None) -> str:
        """Add a function to those that are needed, and return its name in C.

        Args:
            name: Key in :data:`HELPERS`, or in :data:`INTEGER_HELPERS` if ``integer`` is given.
            integer: Dtype of the function's integers.
            real: Dtype of the function's floating-point numbers; None: that of the program.
        """
        real = self.real if real is None else real
        if name in HELPERS_NEEDED:
            self.require_helper(HELPERS_NEEDED[name], integer, real)
        single = real.itemsize == 4
        width = 8 * (integer.itemsize if integer is not None else real.itemsize)
        replacements = {
            "T": c_type(real), "fabs": "fabsf" if single else "fabs", "w": width, "I": f"int{width}_t",
            "digits": "8388608.0f" if single else "4503599627370496.0", "U": f"uint{width}_t",
            "I_max": f"INT{width}_MAX", "I_min": f"INT{width}_MIN",
            "top": c_literal(real.type(2.0 ** (width - 1)), real), "x": "" if real == self.real else f"_{c_type(real)}",
        }  # fmt: skip
        templates = HELPERS if integer is None else INTEGER_HELPERS
        ending = replacements["x"] if integer is None or name == "truncated" else ""
        self._needed[name, integer, ending] = templates[name].format(**replacements)
        return f"{name}{ending}" if integer is None else f"{name}_{width}{ending}"

    def expression(self, value: Value, operands: Sequence[tuple[str, int]]) -> tuple[str, int]:
        """C's expression of an operation, with the precedence of its outermost operator.

        Args:
            value: The result of the operation.
            operands: C's expression of each operand, with its precedence.

        Raises:
            Unsupported: C has no exact form of it.
        """
        operation = value.operation
        dtype = value.dtype
        source = value.operands[0].dtype if value.operands else dtype
        if operation == "any":
            return operands[0]
        if operation == "select":
            condition, first, second = (with_brackets(*operand, surrounding=OR) for operand in operands)
            return f"{condition} ? {first} : {second}", TERNARY
        if operation == "rarely":
            condition, usual_text = (with_brackets(*operand, surrounding=OR) for operand in operands[:2])
            arguments = ", ".join(text for text, _ in operands[2:])
            return f"{condition} ? {value.detail.name}({arguments}) : {usual_text}", TERNARY
        if operation == "convert":
            return self.conversion(value, source, operands[0])
        if operation == "bitcast":
            return self.same_bits(source, dtype, operands[0])
        if dtype.kind == "f":
            return self.float_operation(value, operands)
        if source == BOOL and operation in LOGIC:
            sign, precedence = LOGIC[operation]
            first, second = (with_brackets(*operand, surrounding=UNARY) for operand in operands)
            return f"{first} {sign} {second}", precedence
        if dtype == BOOL:
            if operation not in SIGNS:
                raise Unsupported(f"'{operation}' of truth values in C")
            sign, precedence = SIGNS[operation]
            first, second = (with_brackets(*operand, surrounding=SHIFT) for operand in operands)
            return f"{first} {sign} {second}", precedence
        return self.integer_operation(value, operands)

    def float_operation(self, value: Value, operands: Sequence[tuple[str, int]]) -> tuple[str, int]:
        """An operation of floating-point numbers; arguments and errors as for :meth:`expression`."""
        operation = value.operation
        single = value.dtype.itemsize == 4
        real = value.dtype
        if operation in SIGNS:
            sign, precedence = SIGNS[operation]
            left_text = with_brackets(*operands[0], surrounding=precedence)
            return f"{left_text} {sign} {with_brackets(*operands[1], surrounding=precedence + 1)}", precedence
        if operation == "neg":
            return f"-{with_brackets(*operands[0], surrounding=ATOM)}", UNARY
        if operation in ("max", "min"):
            first, second = operands
            return f"{self.require_helper(operation + 'imum', real=real)}({first[0]}, {second[0]})", ATOM
        names = {"floor": "round_down", "ceil": "round_up", "round": "nearest", "trunc": "toward_zero"}
        if operation in names:
            return f"{self.require_helper(names[operation], real=real)}({operands[0][0]})", ATOM
        library = {"sqrt": "sqrt", "abs": "fabs", "rem": "fmod"}
        if operation in library:
            arguments = ", ".join(text for text, _ in operands)
            return f"{library[operation]}{'f' if single else ''}({arguments})", ATOM
        raise Unsupported(f"'{operation}' of floating-point numbers in C")

    def integer_operation(self, value: Value, operands: Sequence[tuple[str, int]]) -> tuple[str, int]:
        """An operation of integers; arguments and errors as for :meth:`expression`."""
        operation = value.operation
        dtype = value.dtype
        texts = [text for text, _ in operands]
        unsigned = f"uint{8 * dtype.itemsize}_t"
        helper_names = {"shr": "shift_right", "div": "quotient", "rem": "remainder"}
        if operation in helper_names and dtype.kind == "i":
            return f"{self.require_helper(helper_names[operation], dtype)}({texts[0]}, {texts[1]})", ATOM
        if operation == "neg":
            operation = "sub"
            texts = ["0", texts[0]]
        signs = {**{name: SIGNS[name][0] for name in ("add", "sub", "mul", "and", "or", "xor")}, "shl": "<<"}
        if dtype.kind == "u":
            signs |= {"shr": ">>", "div": "/", "rem": "%"}
        if operation in signs and dtype.itemsize >= 4:
            text = f"({unsigned})({texts[0]}) {signs[operation]} ({unsigned})({texts[1]})"
            return (
                (f"({text})", ATOM) if dtype.kind == "u" else (f"{self.require_helper('signed', dtype)}({text})", ATOM)
            )
        if operation in ("max", "min"):
            sign = ">" if operation == "max" else "<"
            return f"({texts[0]}) {sign} ({texts[1]}) ? ({texts[0]}) : ({texts[1]})", TERNARY
        raise Unsupported(f"'{operation}' of {dtype} in C")

    def conversion(self, value: Value, source: np.dtype, operand: tuple[str, int]) -> tuple[str, int]:
        """A conversion of a number from the dtype ``source``; errors as for :meth:`expression`."""
        dtype = value.dtype
        text, _ = operand
        if source.kind == "f" and dtype.kind in "iu":
            if dtype.kind == "u":
                raise Unsupported(f"conversion of {source} to {dtype} in C")
            return f"{self.require_helper('truncated', dtype, source)}({text})", ATOM
        if source == BOOL:
            unit, zero = (c_literal(dtype.type(number), dtype) for number in (1, 0))
            return f"{with_brackets(*operand, surrounding=OR)} ? {unit} : {zero}", TERNARY
        wraps = source.kind in "iu" and (dtype.itemsize < source.itemsize or (dtype.itemsize == source.itemsize
                                                                              and source.kind == "u"))  # fmt: skip
        if dtype.kind == "i" and wraps:  # C leaves it to the compiler
            unsigned = f"(uint{8 * dtype.itemsize}_t)"
            return (
                f"{self.require_helper('signed', dtype)}({unsigned}{with_brackets(*operand, surrounding=UNARY)})",
                ATOM,
            )
        return f"({c_type(dtype)}){with_brackets(*operand, surrounding=UNARY)}", UNARY

    def same_bits(self, source: np.dtype, dtype: np.dtype, operand: tuple[str, int]) -> tuple[str, int]:
        """The bits of a number as a number of another dtype; errors as for :meth:`expression`.

        Args:
            source: Dtype of the number.
            dtype: The other dtype, of the same size.
            operand: C's expression of the number, with its precedence.
        """
        text, _ = operand
        match source.kind, dtype.kind:
            case "i", "f":
                return f"{self.require_helper('number_of', real=dtype)}({text})", ATOM
            case "u", "f":
                bits = f"{self.require_helper('signed', np.dtype(f'i{dtype.itemsize}'))}({text})"
                return f"{self.require_helper('number_of', real=dtype)}({bits})", ATOM
            case "f", "i":
                return f"{self.require_helper('bits_of', real=source)}({text})", ATOM
            case "f", "u":
                return f"({c_type(dtype)}){self.require_helper('bits_of', real=source)}({text})", UNARY
            case "u", "i":
                return f"{self.require_helper('signed', dtype)}({text})", ATOM
            case "i", "u":
                return f"({c_type(dtype)}){with_brackets(*operand, surrounding=UNARY)}", UNARY
        raise Unsupported(f"the bits of {source} as {dtype} in C")
