"""Comparisons of two expressions in a formula: their difference at a sample, its unit, and the size of its numbers."""

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.closed_loop.metrics.formula_tree import Comparison
from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.closed_loop.metrics.signal_metrics import SampledSignal
from dssc_jax.core.errors import nearest
from dssc_jax.core.signals import Scalar
from dssc_jax.study.expressions import UnknownParameter, evaluate_numbers, names_of, parse_expression

MIXED_UNIT = "SI"
"""Unit of an expression that multiplies signals, or of comparisons with several units."""


@dataclass(frozen=True)
class ExpressionDifference:
    """Difference of the two sides of a comparison at a sample; it is positive if the comparison is true.

    Args:
        upper: Text of the expression that must be the larger one.
        lower: Text of the expression that must be the smaller one.
        signals: Name and signal of each signal in the expressions.
        numbers: Name and value of each parameter in the expressions.
    """

    upper: str
    lower: str
    signals: tuple[tuple[str, SampledSignal], ...]
    numbers: tuple[tuple[str, float], ...]

    def __call__(self, instant: Instant) -> Scalar:
        """Value of the upper expression minus value of the lower one, at an instant of a flight."""
        values: dict[str, Scalar] = dict(self.numbers)
        for name, signal in self.signals:
            values[name] = signal.value(instant)
        upper = evaluate_numbers(parse_expression(self.upper), values.__getitem__)
        lower = evaluate_numbers(parse_expression(self.lower), values.__getitem__)
        return jnp.subtract(upper, lower)


def unit_of(node: ast.expr, units: Mapping[str, str]) -> str | None:
    """Unit of an expression, from the units of its signals.

    Args:
        node: Tree of the expression, or of a part of it.
        units: Unit of each signal by name; other names are parameters, which have no unit.

    Returns:
        The unit; None for an expression without signals; :data:`MIXED_UNIT` if units differ, or if an operation other
        than a sum, a difference, ``abs``, ``min`` or ``max`` acts on a signal.
    """
    match node:
        case ast.Name(id=name):
            return units.get(name)  # None: a parameter
        case ast.UnaryOp(operand=operand) | ast.Call(func=ast.Name(id="abs"), args=[operand]):
            return unit_of(operand, units)
    parts = [part for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr)]
    part_units = {unit_of(part, units) for part in parts} - {None}
    if not part_units:
        return None
    match node:
        case ast.BinOp(op=ast.Add() | ast.Sub()) | ast.Call(func=ast.Name(id="min" | "max")) if len(part_units) == 1:
            return part_units.pop()
    return MIXED_UNIT


class ParsedComparison(NamedTuple):
    """A parsed comparison, with the unit and the sizes from which the requirement of its formula follows.

    Args:
        comparison: The comparison, as a leaf of the formula's tree.
        unit: Common unit of both sides; :data:`MIXED_UNIT` if there is none.
        sizes: Magnitude of each side without a signal, unless it is 0.
    """

    comparison: Comparison
    unit: str
    sizes: list[float]


def parse_comparison(
    upper: str, lower: str, signals: Mapping[str, SampledSignal], parameter: Callable[[str], float]
) -> ParsedComparison:
    """Parse the comparison that one expression exceeds another.

    Args:
        upper: Text of the expression that must be the larger one.
        lower: Text of the expression that must be the smaller one.
        signals: Signals of the loop by name.
        parameter: (name of a parameter) -> value of the parameter; raises UnknownParameter for an unknown name.

    Raises:
        ValueError: An expression is not valid, names something unknown, or is a number that is not finite; or neither
            expression has a signal.
    """
    trees = [parse_expression(upper), parse_expression(lower)]
    names = dict.fromkeys([*names_of(trees[0]), *names_of(trees[1])])  # each once
    signals_by_name = {name: signals[name] for name in names if name in signals}
    numbers = {name: parameter_value(name, signals, parameter) for name in names if name not in signals}
    if not signals_by_name:
        raise ValueError(f"'{lower} < {upper}' compares no signal; the signals are {', '.join(signals)}")
    sizes = []
    for tree in trees:
        if signals_by_name.keys() & set(names_of(tree)):
            continue
        size = abs(float(evaluate_numbers(tree, numbers.__getitem__)))
        if not math.isfinite(size):
            raise ValueError(f"a side of '{lower} < {upper}' has no finite value")
        if size > 0.0:
            sizes.append(size)
    units = {name: signal.unit for name, signal in signals_by_name.items()}
    side_units = {unit_of(tree, units) for tree in trees} - {None}
    unit = str(side_units.pop()) if len(side_units) == 1 else MIXED_UNIT
    difference = ExpressionDifference(upper, lower, tuple(signals_by_name.items()), tuple(numbers.items()))
    return ParsedComparison(Comparison(difference), unit, sizes)


def parameter_value(name: str, signals: Mapping[str, SampledSignal], parameter: Callable[[str], float]) -> float:
    """Value of a parameter that a formula names; for an unknown name, the error proposes the nearest signal.

    Args:
        name: Name of the parameter.
        signals: Signals of the loop by name, for messages.
        parameter: (name of a parameter) -> value of the parameter; raises UnknownParameter for an unknown name.

    Raises:
        ValueError: There is no parameter of this name, or it has no plain number.
    """
    try:
        return parameter(name)
    except UnknownParameter:
        hint = nearest(name, signals)
        raise ValueError(f"'{name}' is neither a signal nor a parameter; {hint}") from None
