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
        function: Qualified name of the function around it.
        summary: First line of the function's docstring.
    """

    name: str
    function: str = ""
    summary: str = ""


class Place(NamedTuple):
    """A call or operation in a source file.

    Args:
        code: The code object that contains it.
        span: Its first and last line, first and last column.
    """

    code: CodeType
    span: tuple[Any, ...]


class Source(NamedTuple):
    """The syntax tree of a file.

    Args:
        nodes: The expression at each span.
        parents: The parent of each node.
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
        super().__init__(build)
        self.origins: dict[int, Origin] = {}
        self._outermost_call: JaxprEqn | None = None

    def equation(self, equation: JaxprEqn, operands: list[Any]) -> Sequence[Any]:
        """Translate one equation; values computed within a call get the origin of the outermost call."""
        is_outermost = self._outermost_call is None and equation.primitive.name in INLINED
        if is_outermost:
            self._outermost_call = equation
        results = super().equation(equation, operands)
        if is_outermost:
            self._outermost_call = None
        origin = origin_of(self._outermost_call or equation)
        if self._outermost_call is not None:
            origin = origin._replace(name="")
        for result in results:
            if isinstance(result, Value) and result.operation != "constant":
                previous_origin = self.origins.get(id(result))
                if previous_origin is None or (origin.name and not previous_origin.name):
                    self.origins[id(result)] = origin
        return results


def translate_with_origins(lane: Any, *arguments: Any) -> tuple[Program, Any, dict[int, Origin]]:
    """As :func:`~dssc_jax.lanes.tracing.translate.translate`, with the origins of the values.

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
    """The origin of an equation's results; empty if no model's source leads to the equation."""
    places = list(model_places(equation))
    if not places:
        return Origin("")
    outside_operators = [place for place in places if not place.code.co_name.startswith("__")]
    return Origin(assigned_name(places), *function_at((outside_operators or places)[0]))


def model_places(equation: JaxprEqn) -> Iterator[Place]:
    """The places in models whose calls led to an equation, innermost first."""
    traceback = getattr(getattr(equation, "source_info", None), "traceback", None)
    if traceback is None:
        return
    for code, instruction in zip(*traceback.raw_frames(), strict=True):
        file = code.co_filename.replace("\\", "/")
        if not any(part in file for part in LIBRARY):
            positions = list(code.co_positions())
            yield Place(code, positions[instruction // 2] if instruction // 2 < len(positions) else (None,) * 4)


@cache
def source(file: str) -> Source:
    """The syntax tree of a file; empty if it cannot be read."""
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
    """Qualified name of the function around a place, and the first line of its docstring."""
    nodes, parents = source(place.code.co_filename)
    node: ast.AST | None = nodes.get(place.span)
    while node is not None and not isinstance(node, ast.FunctionDef):
        node = parents.get(node)
    name = place.code.co_qualname.replace(".<locals>", "").removesuffix(".<genexpr>")
    if node is None:
        return name, ""
    return name, (ast.get_docstring(node) or "").partition("\n")[0]


def assigned_name(places: Sequence[Place]) -> str:
    """The name to which a value is assigned, at its own place or where the calls around it return it.

    Args:
        places: The place of the value, then those of the calls around it.

    Returns:
        The name; empty if the value is a part of an expression.
    """
    elements: list[int] = []  # positions of the value in the tuples that contain it, innermost last
    for place in places:
        nodes, parents = source(place.code.co_filename)
        start = nodes.get(place.span)
        if start is None:
            return ""
        node: ast.expr = start
        while True:
            parent = parents.get(node)
            if isinstance(parent, ast.IfExp) and node is not parent.test:
                node = parent
            elif isinstance(parent, ast.Tuple) and isinstance(parents.get(parent), ast.Return | ast.Assign):
                elements.append(parent.elts.index(node))
                node = parent
            else:
                break
        if isinstance(parent, ast.Assign) and len(parent.targets) == 1:
            return target_name(parent.targets[0], elements)
        if isinstance(parent, ast.AnnAssign):
            return target_name(parent.target, elements)
        if isinstance(parent, ast.keyword):
            return parent.arg or "" if not elements else ""
        if isinstance(parent, ast.Call) and node in parent.args and not elements:
            return field_name(place.code, parent, parent.args.index(node))
        if not isinstance(parent, ast.Return | ast.Lambda):
            return ""
    return ""


def target_name(target: ast.AST, elements: list[int]) -> str:
    """The name in an assignment's target that gets an element of the value; empty if none does.

    Args:
        target: The target, a name or nested tuples of names.
        elements: Positions in the nested tuples of the value, innermost last.
    """
    remaining = list(elements)
    while isinstance(target, ast.Tuple) and remaining:
        position = remaining.pop()
        if position >= len(target.elts):
            return ""
        target = target.elts[position]
    return target.id if isinstance(target, ast.Name) and not remaining and not target.id.startswith("_") else ""


def field_name(code: CodeType, call: ast.Call, position: int) -> str:
    """The field that a positional argument of a NamedTuple's constructor fills; empty for any other call.

    Args:
        code: Code object that contains the call.
        call: The call.
        position: Position of the argument.
    """
    if not isinstance(call.func, ast.Name):
        return ""
    modules = list(sys.modules.values())
    home = next((module for module in modules if getattr(module, "__file__", None) == code.co_filename), None)
    fields = getattr(getattr(home, call.func.id, None), "_fields", ())
    return fields[position] if position < len(fields) else ""
