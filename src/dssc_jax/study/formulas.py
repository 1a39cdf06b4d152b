"""The parser of formulas in signal temporal logic: their grammar, and checks of their times and names.

    formula     = disjunction ["implies" formula]
    disjunction = conjunction {"or" conjunction}
    conjunction = until {"and" until}
    until       = unary ["until" interval unary]
    unary       = ("not" | "always" [interval] | "eventually" [interval]) unary | "(" formula ")" | comparison
    interval    = "[" seconds "," seconds "]"

A comparison is one of < <= > >= between two expressions of signals, parameters and numbers, whose language is that of
:mod:`dssc_jax.study.expressions`; ``-1 < e < 1`` is two of them.
"""

import ast
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.closed_loop.metrics.formula_tree import (
    Always,
    And,
    Comparison,
    Eventually,
    Formula,
    Not,
    Or,
    Until,
    horizon,
)
from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.closed_loop.metrics.signal_metrics import SampledSignal
from dssc_jax.core.errors import nearest
from dssc_jax.core.signals import Scalar
from dssc_jax.study.expressions import evaluate_numbers, names_of, parse_expression
from dssc_jax.study.formula_tokens import COMPARISONS, WORDS, Token, tokens_of

LONGEST_FORMULA = 1000
DEEPEST_FORMULA = 30
MIXED_UNIT = "SI"
"""Unit of an expression that multiplies signals, or of comparisons with several units."""
ROUNDING = 1e-9  # share of a sample within which the end of an interval counts as a sample


@dataclass(frozen=True)
class ExpressionDifference:
    """Difference of two expressions at a sample, which is positive if their comparison is true.

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
        """Value of the upper expression minus that of the lower one."""
        values: dict[str, Scalar] = dict(self.numbers)
        for name, signal in self.signals:
            values[name] = signal.value(instant)
        upper = evaluate_numbers(parse_expression(self.upper), values.__getitem__)
        lower = evaluate_numbers(parse_expression(self.lower), values.__getitem__)
        return jnp.subtract(upper, lower)


def unit_of(node: ast.expr, units: Mapping[str, str]) -> str | None:
    """Unit of an expression, from the units of its signals by name.

    Returns:
        None for a plain number; :data:`MIXED_UNIT` where signals are multiplied, or units differ.
    """
    match node:
        case ast.Name(id=name):
            return units.get(name)
        case ast.UnaryOp(operand=operand) | ast.Call(func=ast.Name(id="abs"), args=[operand]):
            return unit_of(operand, units)
    part_units = {unit_of(part, units) for part in ast.iter_child_nodes(node) if isinstance(part, ast.expr)} - {None}
    match node:
        case ast.BinOp(op=ast.Add() | ast.Sub()) | ast.Call(func=ast.Name(id="min" | "max")) if len(part_units) == 1:
            return part_units.pop()
    return MIXED_UNIT if part_units else None


class ParsedFormula(NamedTuple):
    """A formula, with the unit and the size of its comparisons.

    Args:
        formula: Tree of the formula.
        unit: Unit of all comparisons, or :data:`MIXED_UNIT`.
        size: Smallest magnitude other than 0 with which a signal is compared; None if there is none.
    """

    formula: Formula
    unit: str
    size: float | None


@dataclass
class FormulaParser:
    """Recursive-descent parser of one formula, with one method for each rule of the grammar.

    Its further fields are the state of the parser: the tokens and the index of the next one, the number of rules within
    each other, and the units and sizes of the comparisons so far.

    Args:
        text: Text of the formula.
        signals: Signals of the loop by name.
        parameter: (name of a parameter) -> its value; raises ValueError for an unknown name.
        sample_time: Sample time T_s [s].
        steps: Number of samples of a flight.
    """

    text: str
    signals: Mapping[str, SampledSignal]
    parameter: Callable[[str], float]
    sample_time: float
    steps: int
    tokens: list[Token] = field(default_factory=list)
    position: int = 0
    depth: int = 0
    units: dict[str, None] = field(default_factory=dict)
    sizes: list[float] = field(default_factory=list)

    def parse(self) -> ParsedFormula:
        """Parse the whole text.

        Raises:
            ValueError: The text is not a formula, or it needs more time than a flight has.
        """
        if len(self.text) > LONGEST_FORMULA:
            raise ValueError(f"a formula has at most {LONGEST_FORMULA} characters, got {len(self.text)}")
        self.tokens = tokens_of(self.text)
        formula = self.formula()
        if self.token:
            raise ValueError(f"{self.place()}: expected the end, got '{self.token}'")
        formula = with_intervals(formula, self.steps, outermost=True)
        required_steps = horizon(formula)
        if required_steps >= self.steps:
            last_time = (self.steps - 1) * self.sample_time
            excess = (required_steps - self.steps + 1) * self.sample_time
            sufficient_duration = (required_steps + 1) * self.sample_time
            duration = required_steps * self.sample_time
            raise ValueError(
                f"needs {duration:g} s of flight, and the last sample is at {last_time:g} s, one sample "
                f"before the end; shorten its intervals by {excess:g} s, or set loop.duration = {sufficient_duration:g}"
            )
        unit = next(iter(self.units)) if len(self.units) == 1 else MIXED_UNIT
        return ParsedFormula(formula, unit, min(self.sizes, default=None))

    # Tokens

    @property
    def token(self) -> str:
        """Text of the next token; empty at the end."""
        return self.tokens[self.position].text if self.position < len(self.tokens) else ""

    def place(self) -> str:
        """Place of the next token in the text, in words."""
        begin = self.tokens[self.position].start if self.position < len(self.tokens) else len(self.text)
        text_before = self.text[:begin].strip()
        return f"after {text_before[-30:]!r}" if text_before else "at the beginning"

    def take(self, text: str) -> bool:
        """Consume the next token if it has this text, and return whether it did."""
        matches = self.token == text
        self.position += matches
        return matches

    def expect(self, text: str) -> None:
        """Consume the next token, which must have this text.

        Raises:
            ValueError: It has another text.
        """
        if not self.take(text):
            raise ValueError(f"{self.place()}: expected '{text}', got {self.token!r}")

    # Grammar

    def formula(self) -> Formula:
        """Parse a disjunction, or an implication."""
        self.descend()
        formula = self.joined_operands("or", Or, lambda: self.joined_operands("and", And, self.until))
        if self.take("implies") or self.take("->"):
            formula = Or((Not(formula), self.formula()))
        self.depth -= 1
        return formula

    def descend(self) -> None:
        """Count one more rule within the others.

        Raises:
            ValueError: There are more than :data:`DEEPEST_FORMULA`.
        """
        self.depth += 1
        if self.depth > DEEPEST_FORMULA:
            raise ValueError(f"is nested too deeply: at most {DEEPEST_FORMULA} levels are taken")

    def joined_operands(self, word: str, kind: type[And] | type[Or], part: Callable[[], Formula]) -> Formula:
        """Parse one or more parts, joined by a word."""
        parts = [part()]
        while self.take(word):
            parts.append(part())
        return parts[0] if len(parts) == 1 else kind(tuple(parts))

    def until(self) -> Formula:
        """Parse an operand, or two joined by ``until``."""
        condition = self.unary()
        if not self.take("until"):
            return condition
        begin, end = self.interval("until")
        return Until(begin, end, condition, self.unary())

    def unary(self) -> Formula:
        """Parse a comparison, a formula in parentheses, or an operator with its operand."""
        self.descend()
        formula = self.operand()
        self.depth -= 1
        return formula

    def operand(self) -> Formula:
        """Parse the rule of :meth:`unary` without its limit of depth."""
        if self.take("not"):
            return Not(self.unary())
        if self.take("always"):
            begin, end = self.interval("always")
            return Always(begin, end, self.unary())
        if self.take("eventually"):
            begin, end = self.interval("eventually")
            return Eventually(begin, end, self.unary())
        if self.token == "(" and self.is_formula_within():
            self.expect("(")
            formula = self.formula()
            self.expect(")")
            return formula
        return self.comparison()

    def is_formula_within(self) -> bool:
        """Whether the parenthesis that opens here contains a formula, rather than a part of an expression."""
        open_parentheses = 0
        for token in self.tokens[self.position :]:
            open_parentheses += (token.text == "(") - (token.text == ")")
            if not open_parentheses:
                return False
            if token.text in COMPARISONS or token.text in WORDS:
                return True
        return False

    def interval(self, operator: str) -> tuple[int, int]:
        """Parse the interval of a temporal operator.

        Returns:
            Its first and last sample; without an interval 0 and -1, which stands for the end of the flight.
        """
        if not self.take("["):
            return 0, -1
        begin_text = self.expression((",",))
        self.expect(",")
        end_text = self.expression(("]",))
        self.expect("]")
        begin = self.seconds(begin_text)
        end = self.seconds(end_text)
        interval_text = f"{operator}[{begin_text},{end_text}]"
        if not 0.0 <= begin <= end < math.inf:
            raise ValueError(f"{interval_text} needs 0 <= begin <= end in seconds")
        first_sample = math.ceil(begin / self.sample_time - ROUNDING)
        last_sample = math.floor(end / self.sample_time + ROUNDING)
        if last_sample < first_sample:
            raise ValueError(f"{interval_text} holds no sample: T_s is {self.sample_time:g} s")
        return first_sample, last_sample

    def seconds(self, text: str) -> float:
        """Value [s] of an expression of numbers and parameters."""
        return float(evaluate_numbers(parse_expression(text), self.parameter))

    def comparison(self) -> Formula:
        """Parse a comparison, or several in a chain such as ``-1 < e < 1``."""
        sides = [self.expression(COMPARISONS)]
        parts: list[Formula] = []
        while self.token in COMPARISONS:
            sign = self.tokens[self.position].text
            self.position += 1
            sides.append(self.expression(COMPARISONS))
            left, right = sides[-2:]
            lower, upper = (left, right) if sign in ("<", "<=") else (right, left)
            parts.append(self.comparison_of(upper, lower))
        if not parts:
            rule = "compare with <, <=, > or >=; equality of real numbers has no robustness"
            raise ValueError(f"{self.place()}: expected a comparison, got {self.token or 'the end'!r}; {rule}")
        return parts[0] if len(parts) == 1 else And(tuple(parts))

    def expression(self, ends: tuple[str, ...]) -> str:
        """Text of the expression that begins here.

        It extends to one of the tokens ``ends``, a word of formulas, or a parenthesis or bracket that it does not open.
        """
        open_parentheses = 0
        start = self.position
        end_tokens = (*ends, ")", "->", "]", "==", "!=")
        while self.token and self.token not in WORDS:
            if not open_parentheses and self.token in end_tokens:
                break
            open_parentheses += (self.token == "(") - (self.token == ")")
            self.position += 1
        tokens = self.tokens[start : self.position]
        if not tokens:
            raise ValueError(f"{self.place()}: expected an expression, got {self.token or 'the end'!r}")
        last_token = tokens[-1]
        return self.text[tokens[0].start : last_token.start + len(last_token.text)]

    def comparison_of(self, upper: str, lower: str) -> Comparison:
        """The comparison that ``upper`` exceeds ``lower``; its unit and size are recorded."""
        trees = [parse_expression(text) for text in (upper, lower)]
        names = dict.fromkeys(name for tree in trees for name in names_of(tree))
        signals = tuple((name, self.signals[name]) for name in names if name in self.signals)
        numbers = tuple((name, self.parameter_of(name)) for name in names if name not in self.signals)
        if not signals:
            raise ValueError(f"'{lower} < {upper}' compares no signal; the signals are {', '.join(self.signals)}")
        for tree in trees:
            names_in_tree = names_of(tree)
            if set(names_in_tree) & self.signals.keys():
                continue
            size = abs(float(evaluate_numbers(tree, dict(numbers).__getitem__)))
            if not math.isfinite(size):
                raise ValueError(f"a side of '{lower} < {upper}' has no finite value")
            if size:
                self.sizes.append(size)
        units = {name: signal.unit for name, signal in signals}
        side_units = {unit_of(tree, units) for tree in trees} - {None}
        self.units.setdefault(str(side_units.pop()) if len(side_units) == 1 else MIXED_UNIT)
        return Comparison(ExpressionDifference(upper, lower, signals, numbers))

    def parameter_of(self, name: str) -> float:
        """Value of a parameter.

        Raises:
            ValueError: The name is neither that of a signal nor that of a parameter with a plain number.
        """
        try:
            return self.parameter(name)
        except ValueError as error:
            if "is no parameter" not in str(error):
                raise
            hint = nearest(name, self.signals)
            raise ValueError(f"'{name}' is neither a signal nor a parameter; {hint}") from None


def with_intervals(formula: Formula, steps: int, outermost: bool) -> Formula:
    """Let temporal operators without an interval extend to the end of the flight.

    Args:
        formula: Formula.
        steps: Number of samples of a flight.
        outermost: Whether no temporal operator surrounds the formula.

    Raises:
        ValueError: A temporal operator within another one has no interval.
    """

    def last_sample(end: int, *operands: Formula) -> int:
        if end >= 0:
            return end
        if not outermost:
            raise ValueError("an operator within another one needs an interval, such as always[0,2]")
        return max(0, steps - 1 - max(map(horizon, operands)))

    match formula:
        case Comparison():
            return formula
        case Not():
            return Not(with_intervals(formula.inner, steps, outermost))
        case And() | Or():
            return type(formula)(tuple(with_intervals(part, steps, outermost) for part in formula.parts))
        case Until():
            condition = with_intervals(formula.before, steps, outermost=False)
            goal = with_intervals(formula.goal, steps, outermost=False)
            return Until(formula.begin, last_sample(formula.end, condition, goal), condition, goal)
    inner = with_intervals(formula.inner, steps, outermost=False)
    return type(formula)(formula.begin, last_sample(formula.end, inner), inner)
