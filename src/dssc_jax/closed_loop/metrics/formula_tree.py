"""The parts of a formula of signal temporal logic, with times in samples."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.core.signals import Scalar


@dataclass(frozen=True)
class Comparison:
    """A comparison of signals such as ``e < 0.1``.

    Args:
        margin: Returns the margin of the comparison at a sample, positive where the comparison holds: here 0.1 - e.
    """

    margin: Callable[[Instant], Scalar]


@dataclass(frozen=True)
class Not:
    """The negation of a formula.

    Args:
        inner: The formula.
    """

    inner: "Formula"


@dataclass(frozen=True)
class And:
    """The conjunction of formulas: all of them hold.

    Args:
        parts: The formulas.
    """

    parts: tuple["Formula", ...]


@dataclass(frozen=True)
class Or:
    """The disjunction of formulas: at least one of them holds.

    Args:
        parts: The formulas.
    """

    parts: tuple["Formula", ...]


@dataclass(frozen=True)
class Always:
    """``inner`` holds at every sample from ``begin`` to ``end`` after the instant, both included.

    Args:
        begin: First sample, counted from the instant.
        end: Last sample, counted from the instant.
        inner: The formula that must hold.
    """

    begin: int
    end: int
    inner: "Formula"


@dataclass(frozen=True)
class Eventually:
    """``inner`` holds at one or more samples from ``begin`` to ``end`` after the instant, both included.

    Args:
        begin: First sample, counted from the instant.
        end: Last sample, counted from the instant.
        inner: The formula that must hold.
    """

    begin: int
    end: int
    inner: "Formula"


@dataclass(frozen=True)
class Until:
    """``goal`` holds at a sample from ``begin`` to ``end``, and ``before`` holds from the instant up to that sample.

    Args:
        begin: First sample at which ``goal`` counts, counted from the instant.
        end: Last sample at which ``goal`` counts, counted from the instant.
        before: The formula that must hold at all samples before the sample at which ``goal`` holds.
        goal: The formula that must hold at one sample.
    """

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
    """Number of samples that must pass after an instant before the formula's value at that instant is known."""
    horizon_of_parts = max((horizon(part) for part in parts_of(formula)), default=0)
    return horizon_of_parts + formula.end if isinstance(formula, Timed) else horizon_of_parts
