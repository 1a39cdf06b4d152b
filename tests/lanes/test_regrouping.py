"""What fast arithmetic does before a loop, and numbers without sign."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.lanes.passes.liveness import reachable
from dssc_jax.lanes.passes.negated_states import loops_of
from dssc_jax.lanes.passes.signs import is_unsigned
from dssc_jax.lanes.tracing.translate import translate
from tests.lanes.against_plain import ROUNDING, X, both


def falling(x, y):
    """A loop whose divisor, and two of three factors, are known before it; one divisor is not."""

    def turn(k, v):
        return v / (1.0 + y * y) + (x * v) * y * 3.0 + 1.0 / (2.0 + v * v)

    return jax.lax.fori_loop(0, 20, turn, 0.1 * x)


def test_what_is_known_before_a_loop_is_divided_and_multiplied_before_it():
    scalar = jax.ShapeDtypeStruct((), np.float64)

    def in_loop(fast):
        program, _ = translate(falling, scalar, scalar, fast=fast)
        (loop,), needed = loops_of(program.body), reachable(program)
        operations = [node.operation for node in loop.body.nodes if id(node) in needed]
        return operations.count("div"), operations.count("mul")

    assert in_loop(fast=False) == (2, 4)
    assert in_loop(fast=True) == (1, 3)


def root_twice(x, y):
    """A product with the root of |y| twice, as of a rotor's speed in its thrust."""
    root = jnp.sqrt(jnp.abs(y))
    return x * root * root, root * (root * x), x * jnp.sqrt(y) * jnp.sqrt(y)


def test_the_square_of_the_root_of_a_size_is_the_size():
    scalar = jax.ShapeDtypeStruct((), np.float64)

    def roots(output, fast):
        program, _ = translate(lambda x, y: root_twice(x, y)[output], scalar, scalar, fast=fast)
        needed = reachable(program)
        return sum(node.operation == "sqrt" for node in program.body.nodes if id(node) in needed)

    assert [roots(output, fast=False) for output in range(3)] == [1, 1, 1]
    assert [roots(output, fast=True) for output in range(3)] == [0, 0, 1]  # the root of y may be NaN
    y = np.array([2.0, -3.0, 0.0, np.inf, -np.inf, np.nan, 1e300, 1e-300])
    for lanes, plain in zip(*both(root_twice, np.linspace(-2.0, 5.0, y.size), y), strict=True):
        np.testing.assert_allclose(lanes, plain, rtol=ROUNDING)


@pytest.mark.parametrize("strict", [True, False])
def test_a_divisor_that_is_known_before_a_loop_may_be_zero_infinite_or_nan(strict):
    divisors = np.array([0.0, -0.0, np.inf, np.nan, 1e300, -2.0, 1e-300])

    def lane(x, y):
        return jax.lax.fori_loop(0, 3, lambda k, v: (v + x) / y, x)

    lanes, plain = both(lane, np.array([0.0, 1.0, 2.0, 3.0, 1.0, np.inf, 1e10]), divisors, strict=strict)
    np.testing.assert_allclose(lanes, plain, rtol=ROUNDING)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("strict", [True, False])
def test_a_peak_compares_as_an_integer_and_keeps_a_nan(dtype, strict):
    def peak(x, y):
        def turn(k, largest):
            return jnp.maximum(largest, jnp.abs(jnp.where(k == 3, y, x * (k - 5))))

        return jax.lax.fori_loop(0, 9, turn, jnp.zeros((), dtype))

    x = np.array([1.0, -2.0, 3.0, 0.0, np.inf, -0.0], dtype)
    y = np.array([-1.0, 50.0, np.nan, -0.0, 1.0, -np.inf], dtype)
    np.testing.assert_array_equal(*both(peak, x, y, strict=strict))
    (loop,) = loops_of(translate(peak, *(jax.ShapeDtypeStruct((), dtype),) * 2)[0].body)
    assert [is_unsigned(node) for node in loop.body.nodes if node.operation == "max"] == [True]


def test_a_state_that_may_become_negative_has_a_sign():
    def lane(x):
        return jax.lax.fori_loop(0, 9, lambda k, v: jnp.maximum(jnp.maximum(v, jnp.abs(x)) - 0.3, -x), jnp.zeros(()))

    (loop,) = loops_of(translate(lane, jax.ShapeDtypeStruct((), np.float64))[0].body)
    assert not any(is_unsigned(node) for node in loop.body.nodes)
    np.testing.assert_allclose(*both(lane, X), rtol=ROUNDING)
