"""Relative degree, zeros and normal form against SciPy, and against random systems built from a known form."""

import numpy as np
import pytest
from scipy import signal

from dssc_jax.core.normal_form import RealisedSystem, normal_form, relative_degree, transfer_function
from dssc_jax.core.zero_dynamics import companion


def realised(a, b, c):
    return RealisedSystem(tuple(map(tuple, np.asarray(a))), tuple(np.ravel(b)), tuple(np.ravel(c)))


def class_system(rng, order):
    """A, b, c of (5)-(8) with a stiffness, in its own coordinates, and the numbers that it is made of."""
    poly = np.atleast_1d(np.poly(-rng.uniform(0.5, 4.0, order)))
    zero_a, zero_c = poly[:0:-1], rng.normal(size=order)
    k, damping, stiffness = rng.uniform(0.5, 3.0), rng.normal(), rng.normal()
    a = np.zeros((2 + order, 2 + order))
    a[0, 1] = 1.0
    a[1, :2] = -stiffness, -damping
    a[1, 2:] = -zero_c
    a[2:, 2:] = companion(tuple(zero_a)) if order else 0.0
    if order:
        a[-1, 1] = 1.0
    b, c = np.zeros(2 + order), np.zeros(2 + order)
    b[1], c[0] = k, 1.0
    return (a, b, c), (k, damping, stiffness, zero_a, zero_c)


@pytest.mark.parametrize("order", [0, 1, 2, 4])
@pytest.mark.parametrize("seed", range(5))
def test_the_form_is_found_from_any_coordinates(order, seed):
    rng = np.random.default_rng(seed)
    (a, b, c), (k, damping, stiffness, zero_a, zero_c) = class_system(rng, order)
    turn = rng.normal(size=a.shape) + 3.0 * np.eye(len(a))
    system = realised(turn @ a @ np.linalg.inv(turn), turn @ b, c @ np.linalg.inv(turn))
    form = normal_form(*transfer_function(system))
    assert form.relative_degree == relative_degree(system) == 2
    assert form.obstacle == ""
    found = [form.gain, form.damping, form.stiffness, *form.zero_a, *form.zero_c]
    np.testing.assert_allclose(found, [k, damping, stiffness, *zero_a, *zero_c], rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(
        sorted(z.real for z in form.zeros), sorted(np.roots([1.0, *zero_a[::-1]]).real), rtol=1e-6
    )


@pytest.mark.parametrize("seed", range(5))
def test_the_transfer_function_is_that_of_scipy(seed):
    rng = np.random.default_rng(seed)
    a, b, c = rng.normal(size=(4, 4)), rng.normal(size=(4, 1)), rng.normal(size=(1, 4))
    numerator, denominator = transfer_function(realised(a, b, c))
    expected = signal.ss2tf(a, b, c, [[0.0]])
    np.testing.assert_allclose(numerator, expected[0][0][1:], rtol=1e-8)
    np.testing.assert_allclose(denominator, expected[1], rtol=1e-8)


@pytest.mark.parametrize(
    ("numerator", "denominator", "silence"),
    [
        ([1.0], [1.0, 1.0], "relative degree 1, not two"),
        ([1.0], [1.0, 1.0, 1.0, 1.0], "relative degree 3"),
        ([1.0, -2.0], [1.0, 1.0, 1.0, 1.0], r"a zero at 2 rad/s"),
        ([1.0, 0.0], [1.0, 1.0, 1.0, 1.0], r"a zero at 0 rad/s"),
        ([1.0, -0.2, 4.01], [1.0, 1.0, 1.0, 1.0, 1.0], r"a zero at 0.1 \+- 2j rad/s"),
        ([-1.0], [1.0, 1.0, 0.0], "high-frequency gain is -1"),
        ([1.0], [1.0, 1.0, 0.0], "^$"),
    ],
)
def test_what_is_outside_of_the_class_says_why(numerator, denominator, silence):
    import re

    assert re.search(silence, normal_form(numerator, denominator).obstacle)


def test_a_command_that_does_not_reach_the_output():
    system = realised([[0.0, 0.0], [0.0, -1.0]], [1.0, 0.0], [0.0, 1.0])
    assert relative_degree(system) is None
    with pytest.raises(ValueError, match="does not reach"):
        transfer_function(system)
