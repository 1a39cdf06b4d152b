"""Exact sampling of linear systems, against matrix exponentials with 100 digits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.core.sampled_linear import Forcing, hold
from tests.exponentials import exponential

TERMS = 3


def exact(a, column, h):
    """The exponential of the augmented matrix, in the rows of the state."""
    n = len(a)
    matrix = np.zeros((n + TERMS, n + TERMS))
    matrix[:n, :n] = np.asarray(a) * h
    matrix[:n, n] = np.asarray(column) * h
    for k in range(TERMS - 1):
        matrix[n + k, n + k + 1] = 1.0
    return exponential(matrix)[:n]


def found(a, column, h):
    """The same by the package."""
    rows = tuple(tuple(row) for row in a)
    transition = hold(rows, (Forcing(tuple(column), TERMS),), h).full
    matrix = np.zeros((len(a), len(a) + TERMS))
    for (row, place), entry in transition.entries.items():
        matrix[row, place] = entry
    return matrix + np.eye(len(a), len(a) + TERMS)


def lag_chain(mu):
    """A double integrator with damping behind a lag of order 2."""
    rate = 1.0 / mu
    a = [[0.0, 1.0, 0.0, 0.0], [0.0, -1.0, 0.0, 1.0], [0.0, 0.0, -rate, 0.0], [0.0, 0.0, rate, -rate]]
    return a, [0.0, 0.0, rate, 0.0]


def of_poles(*poles):
    """Controllable canonical form with these poles."""
    coefficients = np.real(np.poly(poles))[::-1]
    a = np.eye(len(poles), k=1)
    a[-1] = -coefficients[:-1]
    return a.tolist(), [0.0] * (len(poles) - 1) + [1.0]


SYSTEMS = {f"lag of {mu:g}": (*lag_chain(mu), 1.0) for mu in (1e-12, 1e-9, 1e-3, 0.1, 0.3, 1.0, 10.0)} | {
    "stiff": (*of_poles(-500.0, -5000.0), 1e-3),
    "very stiff": (*of_poles(-1.0, -1e9), 1e-3),
    "double and fast": (*of_poles(-1e6, -1e6), 1.0),
    "oscillating": (*of_poles(-0.01 + 3j, -0.01 - 3j), 0.5),
    "unstable": (*of_poles(2.0, -30.0, 0.0), 0.1),
    "six apart": (*of_poles(-1.0, -10.0, -1e2, -1e3, -1e4, -1e5), 1e-3),
}


@pytest.mark.parametrize("name", SYSTEMS)
def test_known_numbers_agree_with_a_hundred_digits(name):
    """Relative to the largest entry of each column of the exponential."""
    a, column, h = SYSTEMS[name]
    expected = exact(a, column, h)
    scale = np.abs(expected).max(0)
    scale[scale < 1e-290] = 1.0
    conditioning = 1e-6 if name in ("double and fast", "very stiff") else 1e-11  # of coefficients that are rounded
    assert np.max(np.abs(found(a, column, h) - expected) / scale) < conditioning


@pytest.mark.parametrize("mu", [1e-9, 0.1, 10.0])
def test_traced_numbers_are_the_known_ones(mu):
    a, column = lag_chain(mu)
    with jax.enable_x64(True):

        @jax.jit
        def traced(numbers):
            rows = tuple(
                tuple(n if x else 0.0 for n, x in zip(row, known, strict=True))
                for row, known in zip(numbers, a, strict=True)
            )
            return hold(rows, (Forcing(tuple(column), TERMS),), 1.0).full.entries

        entries = traced(jnp.asarray(a))
    expected = exact(a, column, 1.0)
    for (row, place), entry in entries.items():
        assert float(entry) + (row == place) == pytest.approx(expected[row, place], rel=1e-12, abs=1e-14)


def test_half_a_step_twice_is_a_whole_step():
    a, column = lag_chain(0.2)
    held = hold(tuple(map(tuple, a)), (Forcing(tuple(column), 1),), 0.5)
    x = (1.0, -0.5, 0.3, 0.2)
    full_step = held.full.apply(x, ((0.7,),))
    twice = held.half.apply(held.half.apply(x, ((0.7,),)), ((0.7,),))
    np.testing.assert_allclose(twice, full_step, rtol=1e-14)


def test_derivatives_are_those_of_differences():
    """With respect to the lag, through the doublings."""

    def position(mu):
        rate = 1.0 / mu
        rows = ((0.0, 1.0, 0.0), (0.0, -1.0, 1.0), (0.0, 0.0, -rate))
        return hold(rows, (Forcing((0.0, 0.0, rate), 1),), 0.1).full.apply((0.0, 0.0, 0.0), ((1.0,),))[0]

    with jax.enable_x64(True):
        for mu in (1e-3, 0.05, 2.0):
            slope = float(jax.grad(position)(mu))
            step = 1e-5 * mu
            assert slope == pytest.approx(
                (float(position(mu + step)) - float(position(mu - step))) / (2 * step), rel=1e-6
            )
