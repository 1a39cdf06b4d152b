"""The parts of a formula of signal temporal logic, with times in samples."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.core.signals import Scalar


@dataclass(frozen=True)
class Comparison:
    """A comparison of signals such as ``e < 0.1``, by the function that gives its margin at a sample.

    The margin is positive where the comparison holds: here 0.1 - e.
    """

    margin: Callable[[Instant], Scalar]


@dataclass(frozen=True)
class Not:
    """The negation of a formula."""

    inner: "Formula"


@dataclass(frozen=True)
class And:
    """The conjunction of formulas."""

    parts: tuple["Formula", ...]


@dataclass(frozen=True)
class Or:
    """The disjunction of formulas."""

    parts: tuple["Formula", ...]


@dataclass(frozen=True)
class Always:
    """``inner`` holds at every sample from ``begin`` to ``end`` after the instant, both included."""

    begin: int
    end: int
    inner: "Formula"


@dataclass(frozen=True)
class Eventually:
    """``inner`` holds at one or more samples from ``begin`` to ``end`` after the instant."""

    begin: int
    end: int
    inner: "Formula"


@dataclass(frozen=True)
class Until:
    """``goal`` holds at a sample from ``begin`` to ``end``, and ``before`` at all samples before that one."""

    begin: int
    end: int
    before: "Formula"
    goal: "Formula"


Formula: TypeAlias = Comparison | Not | And | Or | Always | Eventually | Until
Timed: TypeAlias = Always | Eventually | Until


def parts_of(formula: Formula) -> tuple[Formula, ...]:
    """The formulas that a formula is made of: none for a comparison, ``before`` and ``goal`` for ``until``."""
    match formula:
        case Comparison():
            return ()
        case And() | Or():
            return formula.parts
        case Until():
            return formula.before, formula.goal
        case _:
            return (formula.inner,)


def horizon(formula: Formula) -> int:
    """Number of samples after an instant that must have passed before the formula's value at that instant is known."""
    horizon_of_parts = max((horizon(part) for part in parts_of(formula)), default=0)
    return horizon_of_parts + formula.end if isinstance(formula, Timed) else horizon_of_parts
