"""Exact sampling of linear systems: matrix exponential and the integrals of its inputs, for one draw.

Over a step of length h, x' = A x + g p(t) with p(t) = p_1 + p_2 t/h + p_3 (t/h)^2/2 has the exact solution

    x(h) = exp(A h) x(0) + h phi_1(A h) g p_1 + h phi_2(A h) g p_2 + h phi_3(A h) g p_3,
    phi_0(z) = exp(z),   phi_(k+1)(z) = (phi_k(z) - 1/k!)/z.

All of these follow from one exponential of an augmented matrix (Van Loan). It is computed by doubling: X(t) = exp(M t)
- 1 satisfies X(2 t) = 2 X(t) + X(t)^2, from a step so short that two terms of the series suffice. Doubling X instead of
the exponential keeps the relative accuracy of slow modes beside fast ones, so poles may lie 1e9 apart.

References:
    C. F. Van Loan, IEEE Trans. Automatic Control 23 (1978) 395-404.
    M. Hochbruck, A. Ostermann, Acta Numerica 19 (2010) 209-286, for the functions phi_k.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp

from dssc_jax.core.numerics import is_known, is_zero
from dssc_jax.core.signals import Scalar

DOUBLINGS = 64
"""Number of doublings, from a step of h 2^-64 to one of h: a pole may be as fast as 1e18/h."""

FASTEST = 1e-15
"""Time constant of unmodelled dynamics below which they count as absent [s]."""

Entries = dict[tuple[int, int], Scalar]
"""The entries of a matrix that may differ from zero, by row and column."""

Column = tuple[Scalar, ...]
"""A row or column of a matrix."""

Rows = tuple[Column, ...]
"""A matrix, row by row."""


class LinearDynamics(NamedTuple):
    """The linear dynamics x' = A x + B u_p + E d of a plant, which the loop solves exactly over a step.

    The vector x lists the leaves of the plant's state.

    Args:
        a: A, row by row, shape (n, n).
        command: Column of the command of each channel, shape (n,) each.
        disturbance: Column of the disturbance of each channel, shape (n,) each.
        inputs: Column of each disturbance input that the plant names, shape (n,) each.
    """

    a: Rows
    command: tuple[Column, ...]
    disturbance: tuple[Column, ...]
    inputs: tuple[Column, ...] = ()


class Moments(NamedTuple):
    """A signal over a step, given as the straight line that has the signal's mean and first moment.

    Args:
        mean: Mean of the signal over the step.
        rise: Difference of the line's values at the end and at the start of the step.
    """

    mean: Scalar
    rise: Scalar


class LinearSystem(NamedTuple):
    """A linear system x' = A x + b u, y = c x + d u; a number that is 0 before tracing is a plain 0.0.

    Args:
        a: A, row by row, shape (n, n) [1/s].
        b: Input column, shape (n,).
        c: Output row, shape (n,).
        d: Direct feedthrough.
    """

    a: Rows
    b: Column
    c: Column
    d: Scalar


def one_entry(entry: Scalar, place: int, size: int) -> Column:
    """Return a row or column of length ``size`` with ``entry`` at index ``place`` and zeros elsewhere."""
    return tuple(entry if i == place else 0.0 for i in range(size))


def scale_column(column: Column, factor: Scalar) -> Column:
    """Return a column times a number; a product with a factor that is 0 before tracing is a plain 0.0."""
    return tuple(0.0 if is_zero(entry) or is_zero(factor) else entry * factor for entry in column)


def series(first: LinearSystem, second: LinearSystem) -> LinearSystem:
    """Return two systems in series as one: the output of the first system is the input of the second.

    The joint state is the state of the first system followed by the state of the second.
    """
    rows = [(*row, *(0.0,) * len(second.a)) for row in first.a]
    for entry, row in zip(second.b, second.a, strict=True):
        rows.append((*scale_column(first.c, entry), *row))
    (feedthrough,) = scale_column((first.d,), second.d)
    b = (*first.b, *scale_column(second.b, first.d))
    return LinearSystem(tuple(rows), b, (*scale_column(first.c, second.d), *second.c), feedthrough)


def spread(system: LinearSystem, places: Sequence[int], size: int) -> LinearSystem:
    """Return a system with additional states, which are constant and have no effect.

    Args:
        system: The system.
        places: For each state of the system, its index among all states.
        size: Number of all states.
    """
    index = {place: i for i, place in enumerate(places)}

    def wide(row: Column) -> Column:
        """Return a row or column of the system, extended by zeros for the additional states."""
        return tuple(row[index[place]] if place in index else 0.0 for place in range(size))

    rows = tuple(wide(system.a[index[place]]) if place in index else (0.0,) * size for place in range(size))
    return LinearSystem(rows, wide(system.b), wide(system.c), system.d)


class Forcing(NamedTuple):
    """An input of a linear system that is a polynomial in time over a step.

    Args:
        column: Column g of the input, shape (n,).
        terms: Number of terms of the polynomial. 1: constant; 2: linear; 3: quadratic.
    """

    column: Column
    terms: int


class Transition(NamedTuple):
    """The exact solution of a linear system over a time t.

    The state x changes by X x + the sum of G_jk p_jk. Here X is exp(A t) - 1, p_jk is term k of the polynomial of input
    j, and the column G_jk is the effect of that term.

    Args:
        size: Number of states n.
        entries: Entries of the matrix [X, G_11, G_12, ..., G_21, ...] by row and column; entries left out are zero.
        starts: For each input j, the index of the column G_j1 in that matrix.
    """

    size: int
    entries: Entries
    starts: tuple[int, ...]

    def apply(self, state: Sequence[Scalar], inputs: Sequence[Sequence[Scalar]]) -> tuple[Scalar, ...]:
        """Return the state at the end of the time t, length n.

        Args:
            state: State at the start, length n.
            inputs: The terms p_1, p_2, ... of each input; terms that are left out are zero.
        """
        factors: dict[int, Scalar] = dict(enumerate(state))  # the factor of each column
        for start, terms in zip(self.starts, inputs, strict=True):
            for k, term in enumerate(terms):
                factors[start + k] = term
        change: list[Scalar] = [0.0] * self.size
        for (row, column), entry in self.entries.items():
            if column in factors:
                change[row] = change[row] + entry * factors[column]
        return tuple(x + dx for x, dx in zip(state, change, strict=True))


class HeldSystem(NamedTuple):
    """The exact solution of a linear system over a whole step (``full``) and over half a step (``half``)."""

    full: Transition
    half: Transition


def hold(a: Rows, forcings: Sequence[Forcing], h: Scalar) -> HeldSystem:
    """Return the exact solution of x' = A x + the sum of g_j p_j over a step of length h, and over half a step.

    Args:
        a: A, row by row, shape (n, n) [1/s]; entries may be traced.
        forcings: The inputs.
        h: Length of the step [s].
    """
    size = len(a)
    starts = []
    next_column = size
    for forcing in forcings:
        starts.append(next_column)
        next_column += forcing.terms
    rates: Entries = {}
    for row, numbers in enumerate(a):
        for column, number in enumerate(numbers):
            if not is_zero(number):
                rates[row, column] = number * h
    for start, forcing in zip(starts, forcings, strict=True):
        for row, number in enumerate(forcing.column):
            if not is_zero(number):
                rates[row, start] = number * h
    chains = {}  # the shifts from one term to the next: p_1' = p_2/h, p_2' = p_3/h
    for start, forcing in zip(starts, forcings, strict=True):
        for k in range(forcing.terms - 1):
            chains[start + k] = start + k + 1
    half, full = exponentials(size, rates, chains)
    return HeldSystem(Transition(size, full, tuple(starts)), Transition(size, half, tuple(starts)))


def exponentials(size: int, rates: Entries, chains: dict[int, int]) -> tuple[Entries, Entries]:
    """Return the entries of exp(M t) - 1 in the rows of the state, for half a step and for the whole step.

    Args:
        size: Number of states n.
        rates: Entries of A h and g h; with the shifts of ``chains`` they make up the augmented matrix M h.
        chains: Column of the next term of a polynomial, by the column of a term.
    """
    pattern = nonzero_places(rates, size, chains)
    shortest = 2.0**-DOUBLINGS  # the first time, in units of the step
    first = {place: number * shortest for place, number in rates.items()}
    second = product(first, first, size)
    for (row, column), number in first.items():
        if column in chains:
            add(second, (row, chains[column]), number * shortest)
    start = {}
    for place in pattern:
        start[place] = first.get(place, 0.0) + 0.5 * second.get(place, 0.0)

    def double(values: tuple[Scalar, ...], t: Scalar) -> tuple[Scalar, ...]:
        """Return the entries of X(2 t) = 2 X(t) + X(t)^2 at the places of ``pattern``, given those of X(t).

        The rows of the polynomials' terms, which X(t) has too, contain powers of t alone, so they are not stored. Here,
        t is in units of the step.
        """
        x = dict(zip(pattern, values, strict=True))
        square = product(x, x, size)
        for (row, column), number in x.items():
            next_term = chains.get(column)
            if next_term is not None:
                add(square, (row, next_term), number * t)
                term_after = chains.get(next_term)
                if term_after is not None:
                    add(square, (row, term_after), number * (0.5 * t * t))
        return tuple(2.0 * x[place] + square.get(place, 0.0) for place in pattern)

    values = tuple(start[place] for place in pattern)
    if all(map(is_known, values)):
        for k in range(DOUBLINGS - 1):
            values = double(values, shortest * 2.0**k)
    else:
        real = jnp.result_type(float)

        def doubling(_: Scalar, carry: tuple[tuple[Scalar, ...], Scalar]) -> tuple[tuple[Scalar, ...], Scalar]:
            """Return the entries at twice the time, and that time."""
            values, t = carry
            return double(values, t), 2.0 * t

        first_values = tuple(jnp.asarray(value, real) for value in values)
        first_time = jnp.asarray(shortest, real)
        values, _ = jax.lax.fori_loop(0, DOUBLINGS - 1, doubling, (first_values, first_time))
    full = double(values, 0.5)
    return dict(zip(pattern, values, strict=True)), dict(zip(pattern, full, strict=True))


def product(left: Entries, right: Entries, size: int) -> Entries:
    """Return the product of two matrices of which only the first ``size`` rows, those of the state, are not zero."""
    by_row: dict[int, list[tuple[int, Scalar]]] = {}
    for (row, column), number in right.items():
        by_row.setdefault(row, []).append((column, number))
    total: Entries = {}
    for (row, middle), number in left.items():
        if middle < size:
            for column, factor in by_row.get(middle, ()):
                add(total, (row, column), number * factor)
    return total


def add(entries: Entries, place: tuple[int, int], number: Scalar) -> None:
    """Add a number to an entry of a matrix, in place."""
    entries[place] = entries[place] + number if place in entries else number


def nonzero_places(rates: Entries, size: int, chains: dict[int, int]) -> tuple[tuple[int, int], ...]:
    """Return the places, by row and column, at which the exponential may differ from the identity, sorted.

    A place (i, j) is one of them if a chain of nonzero entries of the augmented matrix leads from row i to column j.

    Args:
        rates: Entries of A h and g h.
        size: Number of states n.
        chains: Column of the next term of a polynomial, by the column of a term.
    """
    places = set(rates)
    while True:
        extension = {(row, chains[column]) for row, column in places if column in chains}
        for row, middle in places:
            if middle < size:
                extension |= {(row, column) for start, column in places if start == middle}
        if extension <= places:
            return tuple(sorted(places))
        places |= extension
