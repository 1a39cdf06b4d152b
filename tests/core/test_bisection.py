"""Bisection: known crossings, all at once, in both directions."""

import doctest

import numpy as np
import pytest

from dssc_jax.core import bisection
from dssc_jax.core.bisection import bisect

ROOTS = np.array([0.1, 0.5, 0.9, 1.0])


def test_the_interval_keeps_the_crossing_and_halves():
    for halvings in range(12):
        inside, outside = bisect(lambda x: x < ROOTS, np.zeros(4), np.full(4, 1.5), halvings)
        assert np.all(inside < ROOTS)
        assert np.all(outside >= ROOTS)
        assert outside - inside == pytest.approx(1.5 / 2**halvings, abs=1e-15)


def test_it_goes_down_as_it_goes_up():
    inside, outside = bisect(lambda x: x > ROOTS, np.full(4, 1.5), np.zeros(4), 30)
    assert np.all(inside > ROOTS)
    assert np.all(outside <= ROOTS)
    assert inside == pytest.approx(ROOTS, abs=1e-8)


def test_many_at_once_are_the_same_as_each_alone():
    together, _ = bisect(lambda x: x < ROOTS, np.zeros(4), np.full(4, 1.5), 40)
    alone = [float(bisect(lambda x, root=root: x < root, 0.0, 1.5, 40)[0]) for root in ROOTS]
    assert together.tolist() == alone


def test_each_middle_is_asked_for_once():
    asked = []

    def holds(value):
        asked.append(float(value))
        return value < 0.3

    bisect(holds, 0.0, 1.0, 5)
    assert asked == [0.5, 0.25, 0.375, 0.3125, 0.28125]
    assert bisect(holds, 0.0, 1.0, 0) == (0.0, 1.0)
    assert len(asked) == 5


def test_its_example_holds():
    assert doctest.testmod(bisection).attempted == 2
    assert doctest.testmod(bisection).failed == 0
