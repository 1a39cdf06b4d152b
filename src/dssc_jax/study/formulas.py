"""The parser of formulas in signal temporal logic: their grammar, and checks of their times and names.

    formula     = disjunction ["implies" formula]
    disjunction = conjunction {"or" conjunction}
    conjunction = until {"and" until}
    until       = unary ["until" interval unary]
    unary       = ("not" | "always" [interval] | "eventually" [interval]) unary | "(" formula ")" | comparison
    interval    = "[" seconds "," seconds "]"

A comparison is one of < <= > >= between two expressions of signals, parameters and numbers, in the language of
:mod:`dssc_jax.study.expressions`. A chain such as ``-1 < e < 1`` is two comparisons, which must both hold.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

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
from dssc_jax.closed_loop.metrics.signal_metrics import SampledSignal
from dssc_jax.study.expressions import evaluate_numbers, parse_expression
from dssc_jax.study.formula_comparisons import MIXED_UNIT, parse_comparison
from dssc_jax.study.formula_tokens import COMPARISONS, WORDS, Token, tokens_of

LONGEST_FORMULA = 1000
DEEPEST_FORMULA = 30
ROUNDING = 1e-9  # share of a sample within which the end of an interval counts as a sample
TO_THE_END = -1
"""Stands for the end of an operator without an interval, until :func:`with_intervals` puts in the actual end."""


class ParsedFormula(NamedTuple):
    """A formula, with the unit and the size of the numbers in its comparisons.

    Args:
        formula: Tree of the formula.
        unit: Unit of all comparisons, or :data:`MIXED_UNIT`.
        size: Smallest magnitude, other than 0, with which signals are compared; None if there is none.
    """

    formula: Formula
    unit: str
    size: float | None


@dataclass
class FormulaParser:
    """Recursive-descent parser of one formula, with one method for each rule of the grammar.

    Args:
        text: Text of the formula.
        signals: Signals of the loop by name.
        parameter: (name of a parameter) -> value of the parameter; raises UnknownParameter for an unknown name.
        sample_time: Sample time T_s [s].
        steps: Number of samples of a flight.
        tokens: Tokens of the text, which :meth:`parse` fills in.
        position: Index of the next token.
        depth: Nesting depth of the grammar's rules at the next token.
        units: Units of the comparisons that have been parsed.
        sizes: Magnitudes other than 0 with which the parsed comparisons compare signals.
    """

    text: str
    signals: Mapping[str, SampledSignal]
    parameter: Callable[[str], float]
    sample_time: float
    steps: int
    tokens: list[Token] = field(default_factory=list)
    position: int = 0
    depth: int = 0
    units: set[str] = field(default_factory=set)
    sizes: list[float] = field(default_factory=list)

    def parse(self) -> ParsedFormula:
        """Parse the whole text into a formula whose temporal operators all end within the flight.

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
        self.require_time(horizon(formula))
        unit = self.units.pop() if len(self.units) == 1 else MIXED_UNIT
        return ParsedFormula(formula, unit, min(self.sizes, default=None))

    def require_time(self, required_steps: int) -> None:
        """Require that a flight has a sample ``required_steps`` samples after its first one.

        Raises:
            ValueError: The flight ends before this sample.
        """
        if required_steps < self.steps:
            return
        last_time = (self.steps - 1) * self.sample_time
        excess = (required_steps - self.steps + 1) * self.sample_time
        sufficient_duration = (required_steps + 1) * self.sample_time
        duration = required_steps * self.sample_time
        raise ValueError(
            f"needs {duration:g} s of flight, and the last sample is at {last_time:g} s, one sample "
            f"before the end; shorten its intervals by {excess:g} s, or set loop.duration = {sufficient_duration:g}"
        )

    # Tokens

    @property
    def token(self) -> str:
        """Text of the next token; empty at the end of the formula."""
        return self.tokens[self.position].text if self.position < len(self.tokens) else ""

    def place(self) -> str:
        """Place of the next token in the text, in words."""
        begin = self.tokens[self.position].start if self.position < len(self.tokens) else len(self.text)
        text_before = self.text[:begin].strip()
        return f"after {text_before[-30:]!r}" if text_before else "at the beginning"

    def take(self, text: str) -> bool:
        """Consume the next token if it has this text, and return whether it has."""
        if self.token != text:
            return False
        self.position += 1
        return True

    def expect(self, text: str) -> None:
        """Consume the next token, which must have this text.

        Raises:
            ValueError: The next token has another text.
        """
        if not self.take(text):
            raise ValueError(f"{self.place()}: expected '{text}', got {self.token!r}")

    # Grammar

    def formula(self) -> Formula:
        """Parse a disjunction, or an implication of two formulas; "a implies b" becomes "not a, or b"."""
        self.descend()
        formula = self.disjunction()
        if self.take("implies") or self.take("->"):
            formula = Or((Not(formula), self.formula()))
        self.depth -= 1
        return formula

    def descend(self) -> None:
        """Enter one more nested rule; the limit of the depth keeps a formula from exhausting Python's stack.

        Raises:
            ValueError: The rules are nested more than :data:`DEEPEST_FORMULA` deep.
        """
        self.depth += 1
        if self.depth > DEEPEST_FORMULA:
            raise ValueError(f"is nested too deeply: at most {DEEPEST_FORMULA} levels are taken")

    def disjunction(self) -> Formula:
        """Parse one or more conjunctions that are joined by ``or``."""
        parts = [self.conjunction()]
        while self.take("or"):
            parts.append(self.conjunction())
        return parts[0] if len(parts) == 1 else Or(tuple(parts))

    def conjunction(self) -> Formula:
        """Parse one or more operands that are joined by ``and``."""
        parts = [self.until()]
        while self.take("and"):
            parts.append(self.until())
        return parts[0] if len(parts) == 1 else And(tuple(parts))

    def until(self) -> Formula:
        """Parse one operand, or two operands that are joined by ``until`` with its interval."""
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
        """Parse the same as :meth:`unary`, without counting the depth."""
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
        """Whether the parenthesis at the next token contains a formula, rather than a part of an expression."""
        open_parentheses = 0
        for token in self.tokens[self.position :]:
            if token.text == "(":
                open_parentheses += 1
            elif token.text == ")":
                open_parentheses -= 1
            elif token.text in COMPARISONS or token.text in WORDS:
                return True
            if open_parentheses == 0:  # the first parenthesis is closed
                return False
        return False

    def interval(self, operator: str) -> tuple[int, int]:
        """Parse the interval of a temporal operator, such as ``[0.5, 2]`` in seconds.

        Returns:
            First and last sample of the interval, counted from the sample at which the operator is evaluated. If the
            operator has no interval, they are 0 and :data:`TO_THE_END`.

        Raises:
            ValueError: The interval is not valid, or contains no sample.
        """
        if not self.take("["):
            return 0, TO_THE_END
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
        """Parse a comparison, or a chain of comparisons such as ``-1 < e < 1``, all of which must hold."""
        sides = [self.expression(COMPARISONS)]
        parts: list[Formula] = []
        while self.token in COMPARISONS:
            sign = self.token
            self.position += 1
            sides.append(self.expression(COMPARISONS))
            left, right = sides[-2:]
            if sign in ("<", "<="):
                parts.append(self.comparison_of(upper=right, lower=left))
            else:
                parts.append(self.comparison_of(upper=left, lower=right))
        if not parts:
            rule = "compare with <, <=, > or >=; equality of real numbers has no robustness"
            raise ValueError(f"{self.place()}: expected a comparison, got {self.token or 'the end'!r}; {rule}")
        return parts[0] if len(parts) == 1 else And(tuple(parts))

    def expression(self, ends: tuple[str, ...]) -> str:
        """Consume the expression that begins at the next token, and return its text.

        The expression ends before one of the tokens ``ends``, before a word of the formula language such as ``and``,
        or before a closing parenthesis or bracket that the expression has not opened.
        """
        open_parentheses = 0
        start = self.position
        end_tokens = (*ends, ")", "->", "]", "==", "!=")
        while self.token and self.token not in WORDS:
            if open_parentheses == 0 and self.token in end_tokens:
                break
            if self.token == "(":
                open_parentheses += 1
            elif self.token == ")":
                open_parentheses -= 1
            self.position += 1
        tokens = self.tokens[start : self.position]
        if not tokens:
            raise ValueError(f"{self.place()}: expected an expression, got {self.token or 'the end'!r}")
        last_token = tokens[-1]
        return self.text[tokens[0].start : last_token.start + len(last_token.text)]

    def comparison_of(self, upper: str, lower: str) -> Comparison:
        """Parse the comparison ``lower < upper``, and record its unit and the size of its numbers."""
        parsed = parse_comparison(upper, lower, self.signals, self.parameter)
        self.units.add(parsed.unit)
        self.sizes += parsed.sizes
        return parsed.comparison


def with_intervals(formula: Formula, steps: int, outermost: bool) -> Formula:
    """Copy a formula, in which temporal operators without an interval extend to the end of the flight.

    Args:
        formula: Formula; the end of an operator without an interval is :data:`TO_THE_END`.
        steps: Number of samples of a flight.
        outermost: Whether no temporal operator surrounds the formula.

    Raises:
        ValueError: A temporal operator within another one has no interval.
    """

    def interval_end(end: int, *operands: Formula) -> int:
        """End of an operator's interval in samples; for :data:`TO_THE_END`, the latest possible end.

        The operands read samples after that end, up to their horizon, and these samples still lie within the flight.
        """
        if end != TO_THE_END:
            return end
        if not outermost:
            raise ValueError("an operator within another one needs an interval, such as always[0,2]")
        longest_horizon = max(map(horizon, operands))
        return max(0, steps - 1 - longest_horizon)

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
            return Until(formula.begin, interval_end(formula.end, condition, goal), condition, goal)
    inner = with_intervals(formula.inner, steps, outermost=False)
    return type(formula)(formula.begin, interval_end(formula.end, inner), inner)
