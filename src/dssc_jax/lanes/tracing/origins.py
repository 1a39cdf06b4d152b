"""Names of a trace's values: the variable, field or argument to which a model's source assigns an operation.

JAX's trace tells the place of each operation in the source, to the column. The syntax tree of the file tells the rest:

    wanted = (error.sigma - decay * sigma_hat) * inverse_c      the product is ``wanted``
    return SampleRatios(gain * decay, ...)                      the product is the field's name
    u_nominal = nominal_control(...)                            what the function returns is ``u_nominal``
"""

import ast
import sys
from collections.abc import Iterator, Sequence
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any, NamedTuple

from jax.extend.core import JaxprEqn

from dssc_jax.lanes.builder import Builder
from dssc_jax.lanes.program import Program, Value
from dssc_jax.lanes.tracing.translate import INLINED, Translator, traced_program

LIBRARY = ("/jax/", "<frozen", "dssc_jax/lanes", "dssc_jax/core/numerics")
"""Parts of the paths of files that belong to no model."""


class Origin(NamedTuple):
    """The place in a model's source where a value is computed.

    Args:
        name: Name of the value in the source; empty for a part of an expression.
        function: Qualified name of the function in which the value is computed.
        summary: First line of the function's docstring.
    """

    name: str
    function: str = ""
    summary: str = ""


class Place(NamedTuple):
    """A call or operation in a source file.

    Args:
        code: The code object that contains the call or operation.
        span: First line, last line, first column and last column; None for each number that Python does not know.
    """

    code: CodeType
    span: tuple[Any, ...]


class Source(NamedTuple):
    """The syntax tree of a file.

    Args:
        nodes: The expression at each span: (first line, last line, first column, last column).
        parents: The parent of each node of the tree.
    """

    nodes: dict[tuple[Any, ...], ast.expr]
    parents: dict[ast.AST, ast.AST]


class OriginTranslator(Translator):
    """A translator that records the origin of each value, by the value's ``id``.

    Args:
        build: The builder.
    """

    has_memory = False

    def __init__(self, build: Builder) -> None:
        """Begin without origins, outside of every call."""
        super().__init__(build)
        self.origins: dict[int, Origin] = {}
        self._outermost_call: JaxprEqn | None = None

    def equation(self, equation: JaxprEqn, operands: list[Any]) -> Sequence[Any]:
        """Translate one equation, and record the origin of its results.

        Values that are computed within an inlined call get the function and summary of the outermost call, but no name.

        Args:
            equation: The equation.
            operands: The operands, as values of the trace.
        """
        is_outermost = self._outermost_call is None and equation.primitive.name in INLINED
        if is_outermost:
            self._outermost_call = equation
        results = super().equation(equation, operands)
        if is_outermost:
            self._outermost_call = None
        origin = origin_of(self._outermost_call or equation)
        is_within_call = self._outermost_call is not None
        if is_within_call:
            origin = origin._replace(name="")
        for result in results:
            if isinstance(result, Value) and result.operation != "constant":
                self._record(result, origin)
        return results

    def _record(self, value: Value, origin: Origin) -> None:
        """Record a value's origin, unless an earlier equation has recorded one with a name.

        Several equations may return the same value, because equal operations become one value. The first name counts,
        and an origin without a name is replaced by one that has a name.
        """
        previous = self.origins.get(id(value))
        if previous is None or (origin.name and not previous.name):
            self.origins[id(value)] = origin


def translate_with_origins(lane: Any, *arguments: Any) -> tuple[Program, Any, dict[int, Origin]]:
    """Trace the program of one lane and translate it with strict arithmetic; also find the origins of the values.

    Args:
        lane: A function of scalars.
        arguments: Trees of ``jax.ShapeDtypeStruct`` with shape ().

    Returns:
        The program, the tree of its results with shapes and types, and the origin of each value by the value's ``id``.

    Raises:
        Unsupported: An operation has no rule.
    """
    translator = OriginTranslator(Builder())
    program, shape = traced_program(translator, lane, *arguments)
    return program, shape, translator.origins


def origin_of(equation: JaxprEqn) -> Origin:
    """Return the origin of an equation's results; its texts are empty if no model's source leads to the equation.

    The function of the origin is the innermost one that is no operator of a class, such as ``__add__``.
    """
    places = list(model_places(equation))
    if not places:
        return Origin("")
    outside_operators = [place for place in places if not place.code.co_name.startswith("__")]
    innermost = (outside_operators or places)[0]
    function, summary = function_at(innermost)
    return Origin(assigned_name(places), function, summary)


def model_places(equation: JaxprEqn) -> Iterator[Place]:
    """Yield the places in models whose calls led to an equation, innermost first; files of libraries are left out."""
    traceback = getattr(getattr(equation, "source_info", None), "traceback", None)
    if traceback is None:
        return
    codes, byte_offsets = traceback.raw_frames()
    for code, byte_offset in zip(codes, byte_offsets, strict=True):
        file = code.co_filename.replace("\\", "/")
        if not any(part in file for part in LIBRARY):
            yield Place(code, span_at(code, byte_offset))


def span_at(code: CodeType, byte_offset: int) -> tuple[int | None, ...]:
    """Return first line, last line, first column and last column of the instruction at an offset in Python's byte code.

    Each number is None if Python does not know it.
    """
    spans = list(code.co_positions())
    instruction = byte_offset // 2  # an instruction has two bytes
    return spans[instruction] if instruction < len(spans) else (None,) * 4


@cache
def read_source(file: str) -> Source:
    """Parse a file; return an empty syntax tree if the file cannot be read or parsed."""
    try:
        tree = ast.parse(Path(file).read_text(encoding="utf-8"))
    except (OSError, SyntaxError, ValueError):
        return Source({}, {})
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}
    nodes: dict[tuple[Any, ...], ast.expr] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.expr):
            nodes.setdefault((node.lineno, node.end_lineno, node.col_offset, node.end_col_offset), node)
    return Source(nodes, parents)


def function_at(place: Place) -> tuple[str, str]:
    """Return the qualified name of the function around a place, and the first line of its docstring, empty if none."""
    nodes, parents = read_source(place.code.co_filename)
    node: ast.AST | None = nodes.get(place.span)
    while node is not None and not isinstance(node, ast.FunctionDef):
        node = parents.get(node)
    name = place.code.co_qualname.replace(".<locals>", "").removesuffix(".<genexpr>")
    docstring = None if node is None else ast.get_docstring(node)
    summary, _, _ = (docstring or "").partition("\n")
    return name, summary


def assigned_name(places: Sequence[Place]) -> str:
    """Return the name to which a value is assigned: where it is computed or, if a function returns it, by the caller.

    Args:
        places: The place of the value, then the places of the calls around it, innermost first.

    Returns:
        The name of a variable, a keyword argument or a field; empty if the value is only a part of an expression.
    """
    elements: list[int] = []  # positions of the value in the tuples that contain it, outermost last
    for place in places:
        nodes, parents = read_source(place.code.co_filename)
        start = nodes.get(place.span)
        if start is None:
            return ""
        node, positions = whole_expression(start, parents)
        elements += positions
        match parents.get(node):
            case ast.Return() | ast.Lambda():
                continue  # the call around it may assign the value
            case ast.Assign(targets=[target]) | ast.AnnAssign(target=target):
                return target_name(target, elements)
            case ast.keyword(arg=name) if not elements:
                return name or ""  # None: of **keywords
            case ast.Call(args=arguments) as call if node in arguments and not elements:
                return field_name(place.code, call, arguments.index(node))
        return ""
    return ""


def whole_expression(node: ast.expr, parents: dict[ast.AST, ast.AST]) -> tuple[ast.expr, list[int]]:
    """Return the largest expression that has the value of a node, as a case of a conditional or an element of a tuple.

    Args:
        node: The node.
        parents: The parent of each node of the file.

    Returns:
        The expression, and the positions of the value in the tuples around it, outermost last.
    """
    positions = []
    while True:
        parent = parents.get(node)
        if isinstance(parent, ast.IfExp) and node is not parent.test:
            node = parent
        elif isinstance(parent, ast.Tuple) and isinstance(parents.get(parent), ast.Return | ast.Assign):
            positions.append(parent.elts.index(node))
            node = parent
        else:
            return node, positions


def target_name(target: ast.AST, elements: list[int]) -> str:
    """Return the name in an assignment's target that gets one element of the assigned value.

    Args:
        target: The target, a name or nested tuples of names.
        elements: Positions of the element in the nested tuples of the assigned value, outermost last.

    Returns:
        The name; empty if no name without a leading underscore gets the element.
    """
    remaining = list(elements)
    while isinstance(target, ast.Tuple) and remaining:
        position = remaining.pop()
        if position >= len(target.elts):
            return ""
        target = target.elts[position]
    if remaining or not isinstance(target, ast.Name) or target.id.startswith("_"):
        return ""
    return target.id


def field_name(code: CodeType, call: ast.Call, position: int) -> str:
    """Return the field that a positional argument of a NamedTuple's constructor fills; empty for any other call.

    Args:
        code: Code object that contains the call.
        call: The call.
        position: Position of the argument.
    """
    if not isinstance(call.func, ast.Name):
        return ""
    modules = list(sys.modules.values())
    module = next((module for module in modules if getattr(module, "__file__", None) == code.co_filename), None)
    called_object = getattr(module, call.func.id, None)
    fields = getattr(called_object, "_fields", ())  # only a NamedTuple has it
    return fields[position] if position < len(fields) else ""
