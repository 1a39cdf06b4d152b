"""The parts of a formula of signal temporal logic, with times in samples; see :mod:`dssc_jax.closed_loop.formulas`."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

from dssc_jax.closed_loop.metrics import Instant
from dssc_jax.core.signals import Scalar


@dataclass(frozen=True)
class Comparison:
    """A margin that is positive where a comparison holds."""

    margin: Callable[[Instant], Scalar]


@dataclass(frozen=True)
class Not:
    """The contrary of a formula."""

    inner: "Formula"


@dataclass(frozen=True)
class Every:
    """All of some formulas: ``and``."""

    parts: tuple["Formula", ...]


@dataclass(frozen=True)
class Any:
    """At least one of some formulas: ``or``."""

    parts: tuple["Formula", ...]


@dataclass(frozen=True)
class Always:
    """A formula at every sample from ``begin`` to ``end``, both relative and included."""

    begin: int
    end: int
    inner: "Formula"


@dataclass(frozen=True)
class Eventually:
    """A formula at one of the samples from ``begin`` to ``end`` at least."""

    begin: int
    end: int
    inner: "Formula"


@dataclass(frozen=True)
class Until:
    """``goal`` at a sample from ``begin`` to ``end``, and ``before`` at all samples from now until just before."""

    begin: int
    end: int
    before: "Formula"
    goal: "Formula"


Formula: TypeAlias = Comparison | Not | Every | Any | Always | Eventually | Until
Timed: TypeAlias = Always | Eventually | Until


def parts_of(formula: Formula) -> tuple[Formula, ...]:
    """The formulas within a formula."""
    match formula:
        case Comparison():
            return ()
        case Every() | Any():
            return formula.parts
        case Until():
            return formula.before, formula.goal
        case _:
            return (formula.inner,)


def horizon(formula: Formula) -> int:
    """Samples after an instant that decide the formula there."""
    inside = max((horizon(part) for part in parts_of(formula)), default=0)
    return inside + formula.end if isinstance(formula, Timed) else inside
