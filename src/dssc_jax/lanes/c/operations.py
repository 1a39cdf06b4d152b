"""C's expressions of the single operations of a program, with the bits of strict machine code.

Integers are computed as unsigned ones, for which C defines every overflow, and their bits are then taken as signed
again. Functions that C's library does not compute exactly are written out, from sums and comparisons alone.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.lanes.program import BOOL, Value
from dssc_jax.lanes.unsupported import Unsupported

TERNARY, OR, AND, XOR, EQUAL, COMPARE, SHIFT, SUM, PRODUCT, UNARY, ATOM = 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11
"""Precedences of C's operators, lowest first; an atom, such as a name or a call, never needs brackets."""

SIGNS = {
    "add": ("+", SUM), "sub": ("-", SUM), "mul": ("*", PRODUCT), "div": ("/", PRODUCT), "eq": ("==", EQUAL),
    "ne": ("!=", EQUAL), "lt": ("<", COMPARE), "le": ("<=", COMPARE), "gt": (">", COMPARE), "ge": (">=", COMPARE),
    "and": ("&", AND), "or": ("|", OR), "xor": ("^", XOR),
}  # fmt: skip
"""C's operator of an operation of numbers, with its precedence."""
LOGIC = {"and": ("&&", AND), "or": ("||", OR), "xor": ("!=", EQUAL), "eq": ("==", EQUAL), "ne": ("!=", EQUAL)}
"""C's operator of an operation of truth values, with its precedence."""

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
"""Definitions in C of functions of floating-point numbers that operations may need; see :meth:`Notation._replacements`.
"""

HELPERS_NEEDED = {"round_down": "nearest", "round_up": "nearest", "toward_zero": "nearest", "quotient": "signed"}
"""The function that another one calls, by the name of the caller."""

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
    """Return C's type of a dtype, such as ``double`` or ``uint32_t``."""
    if dtype == BOOL:
        return "bool"
    if dtype.kind == "f":
        return {4: "float", 8: "double"}[dtype.itemsize]
    return f"{'u' if dtype.kind == 'u' else ''}int{8 * dtype.itemsize}_t"


def c_literal(number: Any, dtype: np.dtype) -> str:
    """Return a number as a literal in C that compilers read back to the same bits, except the bits of a NaN."""
    if dtype == BOOL:
        return "true" if number else "false"
    return integer_literal(int(number), dtype) if dtype.kind in "iu" else real_literal(number, dtype)


def integer_literal(number: int, dtype: np.dtype) -> str:
    """Return an integer as a literal in C.

    The least signed integer needs the macro INT32_MIN or its like: C would read its digits as minus a number that is
    one too large for the type.
    """
    bits = 8 * dtype.itemsize
    if dtype.kind == "u":
        return f"UINT{bits}_C({number})"
    if number == np.iinfo(dtype).min:
        return f"INT{bits}_MIN"
    return f"INT{bits}_C({number})" if bits == 64 else str(number)


def real_literal(number: Any, dtype: np.dtype) -> str:
    """Return a floating-point number as a literal in C, with as many digits as its bits need; NaN is 0/0."""
    single = dtype.itemsize == 4
    suffix = "f" if single else ""
    if math.isnan(number):
        return f"(0.0{suffix} / 0.0{suffix})"
    if math.isinf(number):
        infinity = "HUGE_VALF" if single else "HUGE_VAL"
        return f"-{infinity}" if number < 0 else infinity
    digits = str(np.float32(number)) if single else repr(float(number))
    return f"{digits}{suffix}"


class Expression(NamedTuple):
    """An expression in C.

    Args:
        text: The text of the expression.
        precedence: Precedence of the outermost operator; :data:`ATOM` if there is none, or if it is within brackets.
    """

    text: str
    precedence: int

    def operand_of(self, precedence: int) -> str:
        """Return the text as an operand of an operator of some precedence.

        The text gets brackets if the precedence of the expression is below that of the operator.
        """
        return self.text if self.precedence >= precedence else f"({self.text})"


class Notation:
    """Writes operations in C, and collects the functions that they need.

    Args:
        real: Dtype of the program's floating-point numbers.
    """

    def __init__(self, real: np.dtype) -> None:
        """Begin without functions."""
        self.real = real
        self._needed: dict[tuple[str, np.dtype | None, str], str] = {}

    def helpers(self) -> list[str]:
        """Return the definitions of the functions that the operations so far need, each after those that it calls."""
        called_by_others = HELPERS_NEEDED.values()
        keys = sorted(self._needed, key=lambda key: (key[0] not in called_by_others, str(key)))
        return [self._needed[key] for key in keys]

    def require_helper(self, name: str, integer: np.dtype | None = None, real: np.dtype | None = None) -> str:
        """Add a function, and the function that it calls, to those that are needed; return its name in C.

        Args:
            name: Key in :data:`HELPERS`, or in :data:`INTEGER_HELPERS` if ``integer`` is given.
            integer: Dtype of the function's integers; None: a function of floating-point numbers alone.
            real: Dtype of the function's floating-point numbers; None: the dtype of the program's.
        """
        real = self.real if real is None else real
        if name in HELPERS_NEEDED:
            self.require_helper(HELPERS_NEEDED[name], integer, real)
        templates = HELPERS if integer is None else INTEGER_HELPERS
        takes_reals = integer is None or name == "truncated"
        ending = self._ending(real) if takes_reals else ""
        self._needed[name, integer, ending] = templates[name].format(**self._replacements(real, integer))
        return f"{name}{ending}" if integer is None else f"{name}_{8 * integer.itemsize}{ending}"

    def _ending(self, real: np.dtype) -> str:
        """Return the ending of a function's name: empty if ``real`` is the program's dtype, else "_" and C's type."""
        return "" if real == self.real else f"_{c_type(real)}"

    def _replacements(self, real: np.dtype, integer: np.dtype | None) -> dict[str, str | int]:
        """Return the text that replaces each name in braces in a template of a function.

        Args:
            real: Dtype of the function's floating-point numbers.
            integer: Dtype of the function's integers; None: as many bits as ``real`` has.
        """
        single = real.itemsize == 4
        width = 8 * (real if integer is None else integer).itemsize
        return {
            "T": c_type(real), "I": f"int{width}_t", "U": f"uint{width}_t", "w": width, "x": self._ending(real),
            "fabs": "fabsf" if single else "fabs",
            "digits": "8388608.0f" if single else "4503599627370496.0",  # 2^23 or 2^52
            "top": c_literal(real.type(2.0 ** (width - 1)), real),
            "I_max": f"INT{width}_MAX", "I_min": f"INT{width}_MIN",
        }  # fmt: skip

    def expression(self, value: Value, operands: Sequence[Expression]) -> Expression:
        """Return C's expression of an operation.

        Args:
            value: The result of the operation.
            operands: C's expression of each operand.

        Raises:
            Unsupported: The operation has no form in C with the same bits.
        """
        operation = value.operation
        dtype = value.dtype
        source = value.operands[0].dtype if value.operands else dtype
        if operation == "any":  # of the one lane that runs
            return operands[0]
        if operation == "select":
            condition, if_true, if_false = (operand.operand_of(OR) for operand in operands)
            return Expression(f"{condition} ? {if_true} : {if_false}", TERNARY)
        if operation == "rarely":
            is_rare, usual = (operand.operand_of(OR) for operand in operands[:2])
            arguments = ", ".join(operand.text for operand in operands[2:])
            return Expression(f"{is_rare} ? {value.detail.name}({arguments}) : {usual}", TERNARY)
        if operation == "convert":
            return self.conversion(value, source, operands[0])
        if operation == "bitcast":
            return self.same_bits(source, dtype, operands[0])
        if dtype.kind == "f":
            return self.float_operation(value, operands)
        if source == BOOL and operation in LOGIC:
            sign, precedence = LOGIC[operation]
            first, second = (operand.operand_of(UNARY) for operand in operands)
            return Expression(f"{first} {sign} {second}", precedence)
        if dtype == BOOL:
            if operation not in SIGNS:
                raise Unsupported(f"'{operation}' of truth values in C")
            sign, precedence = SIGNS[operation]
            first, second = (operand.operand_of(SHIFT) for operand in operands)
            return Expression(f"{first} {sign} {second}", precedence)
        return self.integer_operation(value, operands)

    def float_operation(self, value: Value, operands: Sequence[Expression]) -> Expression:
        """Return C's expression of an operation of floating-point numbers.

        Args:
            value: The result of the operation.
            operands: C's expression of each operand.

        Raises:
            Unsupported: The operation has no form in C with the same bits.
        """
        operation = value.operation
        real = value.dtype
        if operation in SIGNS:
            sign, precedence = SIGNS[operation]
            left = operands[0].operand_of(precedence)
            right = operands[1].operand_of(precedence + 1)  # a - (b + c) keeps its brackets
            return Expression(f"{left} {sign} {right}", precedence)
        if operation == "neg":
            return Expression(f"-{operands[0].operand_of(ATOM)}", UNARY)
        arguments = ", ".join(operand.text for operand in operands)
        helper_names = {
            "max": "maximum", "min": "minimum", "floor": "round_down", "ceil": "round_up", "round": "nearest",
            "trunc": "toward_zero",
        }  # fmt: skip
        if operation in helper_names:
            return Expression(f"{self.require_helper(helper_names[operation], real=real)}({arguments})", ATOM)
        library_names = {"sqrt": "sqrt", "abs": "fabs", "rem": "fmod"}
        if operation in library_names:
            suffix = "f" if real.itemsize == 4 else ""
            return Expression(f"{library_names[operation]}{suffix}({arguments})", ATOM)
        raise Unsupported(f"'{operation}' of floating-point numbers in C")

    def integer_operation(self, value: Value, operands: Sequence[Expression]) -> Expression:
        """Return C's expression of an operation of integers.

        Args:
            value: The result of the operation.
            operands: C's expression of each operand.

        Raises:
            Unsupported: The operation has no form in C, or is arithmetic of integers shorter than 32 bits.
        """
        operation = value.operation
        dtype = value.dtype
        texts = [operand.text for operand in operands]
        helper_names = {"shr": "shift_right", "div": "quotient", "rem": "remainder"}
        if operation in helper_names and dtype.kind == "i":
            return Expression(f"{self.require_helper(helper_names[operation], dtype)}({texts[0]}, {texts[1]})", ATOM)
        if operation == "neg":
            operation = "sub"
            texts = ["0", texts[0]]
        signs = {"add": "+", "sub": "-", "mul": "*", "and": "&", "or": "|", "xor": "^", "shl": "<<"}
        if dtype.kind == "u":
            signs |= {"shr": ">>", "div": "/", "rem": "%"}
        if operation in signs and dtype.itemsize >= 4:  # C computes shorter integers as int
            unsigned = f"uint{8 * dtype.itemsize}_t"
            text = f"({unsigned})({texts[0]}) {signs[operation]} ({unsigned})({texts[1]})"
            same_bits = self.require_helper("signed", dtype) if dtype.kind == "i" else ""
            return Expression(f"{same_bits}({text})", ATOM)
        if operation in ("max", "min"):
            sign = ">" if operation == "max" else "<"
            return Expression(f"({texts[0]}) {sign} ({texts[1]}) ? ({texts[0]}) : ({texts[1]})", TERNARY)
        raise Unsupported(f"'{operation}' of {dtype} in C")

    def conversion(self, value: Value, source: np.dtype, operand: Expression) -> Expression:
        """Return C's expression of the conversion of a number to another dtype.

        Args:
            value: The converted number.
            source: Dtype of the number before the conversion.
            operand: C's expression of the number.

        Raises:
            Unsupported: A floating-point number becomes an unsigned integer.
        """
        dtype = value.dtype
        if source.kind == "f" and dtype.kind in "iu":
            if dtype.kind == "u":
                raise Unsupported(f"conversion of {source} to {dtype} in C")
            return Expression(f"{self.require_helper('truncated', dtype, source)}({operand.text})", ATOM)
        if source == BOOL:
            unit = c_literal(dtype.type(1), dtype)
            zero = c_literal(dtype.type(0), dtype)
            return Expression(f"{operand.operand_of(OR)} ? {unit} : {zero}", TERNARY)
        is_shorter = dtype.itemsize < source.itemsize
        loses_sign_bit = dtype.itemsize == source.itemsize and source.kind == "u"
        if dtype.kind == "i" and source.kind in "iu" and (is_shorter or loses_sign_bit):
            # C leaves it to the compiler what a signed integer beyond its range becomes
            unsigned = f"uint{8 * dtype.itemsize}_t"
            return Expression(f"{self.require_helper('signed', dtype)}(({unsigned}){operand.operand_of(UNARY)})", ATOM)
        return Expression(f"({c_type(dtype)}){operand.operand_of(UNARY)}", UNARY)

    def same_bits(self, source: np.dtype, dtype: np.dtype, operand: Expression) -> Expression:
        """Return C's expression of the number of another dtype that has the same bits.

        Args:
            source: Dtype of the number.
            dtype: The other dtype, of the same size.
            operand: C's expression of the number.

        Raises:
            Unsupported: One of the two dtypes is that of truth values.
        """
        text = operand.text
        match source.kind, dtype.kind:
            case "i", "f":
                return Expression(f"{self.require_helper('number_of', real=dtype)}({text})", ATOM)
            case "u", "f":
                bits = f"{self.require_helper('signed', np.dtype(f'i{dtype.itemsize}'))}({text})"
                return Expression(f"{self.require_helper('number_of', real=dtype)}({bits})", ATOM)
            case "f", "i":
                return Expression(f"{self.require_helper('bits_of', real=source)}({text})", ATOM)
            case "f", "u":
                return Expression(f"({c_type(dtype)}){self.require_helper('bits_of', real=source)}({text})", UNARY)
            case "u", "i":
                return Expression(f"{self.require_helper('signed', dtype)}({text})", ATOM)
            case "i", "u":
                return Expression(f"({c_type(dtype)}){operand.operand_of(UNARY)}", UNARY)
        raise Unsupported(f"the bits of {source} as {dtype} in C")
