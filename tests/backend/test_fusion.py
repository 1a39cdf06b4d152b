"""Shared values once: the same results, and buffers only where several kernels need a value."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.backend.fusion import COSTLY, deduplicated, rewritten

X, Z = jnp.linspace(0.1, 2.0, 16), jnp.linspace(-1.0, 1.0, 16)


def costly(x):
    for _ in range(COSTLY + 1):
        x = x * x + 0.25
    return x


def program_of(function, *args):
    return rewritten(jax.make_jaxpr(function)(*args))


def names(program):
    return [eqn.primitive.name for eqn in program.jaxpr.eqns]


def kept(program):
    return sum(eqn.params.get("name") == "barrier" for eqn in program.jaxpr.eqns)


def test_what_two_results_share_is_kept():
    assert kept(program_of(lambda x, z: (costly(x) * z, costly(x) + z), X, Z)) == 1


def test_what_one_result_uses_twice_is_not():
    assert kept(program_of(lambda x, z: costly(x) * z + jnp.abs(costly(x)), X, Z)) == 0


def test_what_is_cheap_is_computed_again():
    assert kept(program_of(lambda x, z: ((x + z) * z, (x + z) * x), X, Z)) == 0


def test_a_division_needs_no_keeping():
    """XLA itself keeps the shared result of an operation that it does not repeat."""
    assert kept(program_of(lambda x, z: (x / z + 1.0, x / z - 1.0), X, Z)) == 0


def test_a_costly_number_that_two_kernels_broadcast_is_kept():
    """The sine of the time, which XLA would compute in each of them."""
    t = jnp.float32(0.7)
    assert kept(program_of(lambda x, z, t: (x * jnp.sin(t), jnp.sin(t) + z), X, Z, t)) == 1
    assert kept(program_of(lambda x, z, t: (x * jnp.sin(t) + z, x - z), X, Z, t)) == 0
    assert kept(program_of(lambda x, z, t: (x * (t + 1.0), z - (t + 1.0)), X, Z, t)) == 0


def test_equal_expressions_are_merged_across_calls_and_unused_ones_go():
    inner = jax.jit(lambda x: jnp.where(x > 0.5, jnp.sqrt(x), x))
    found = names(program_of(lambda x: (inner(x) + 1.0, inner(x) - 1.0, jnp.exp(x))[:2], X))
    assert found.count("sqrt") == 1
    assert "exp" not in found
    assert not {"pjit", "closed_call"} & set(found)


def test_bodies_of_loops_are_rewritten_too():
    def body(carry, _):
        x, z = carry
        return (costly(x) * 0.1 + z, costly(x) * 0.2 - z), None

    program = program_of(lambda x, z: jax.lax.scan(body, (x, z), length=3)[0], X, Z)
    (scan,) = [eqn for eqn in program.jaxpr.eqns if eqn.primitive.name == "scan"]
    assert kept(scan.params["jaxpr"]) == 1


@pytest.mark.parametrize("length", [1, 7])
def test_results_keep_values_shapes_and_structure(length):
    def body(carry, k):
        x, flag = carry
        y = jnp.clip(costly(0.3 * x), -2.0, 2.0)
        x = jnp.where(flag, jnp.sin(y) / (1.0 + y * y), y - 0.1 * k)
        return (x, x > 0.2), y

    def function(tree):
        (x, flag), y = jax.lax.scan(body, (tree["x"], tree["x"] > 1.0), jnp.arange(length))
        bits = jax.vmap(lambda i: jax.random.uniform(jax.random.fold_in(jax.random.key(1), i)))(jnp.arange(16))
        return {"x": x, "flag": flag, "trace": y, "noise": bits, "constant": 3.0}

    plain, once = jax.jit(function)({"x": X}), jax.jit(deduplicated(function))({"x": X})
    assert jax.tree.structure(plain) == jax.tree.structure(once)
    for name, value in plain.items():
        assert once[name].dtype == value.dtype
        np.testing.assert_allclose(once[name], value, rtol=2e-6, err_msg=name)


def test_derivatives_of_a_rewritten_function():
    function = deduplicated(lambda x, z: (costly(0.5 * x) * z, costly(0.5 * x) + z))
    plain = jax.jacfwd(lambda x: costly(0.5 * x) * Z)(X)
    np.testing.assert_allclose(jax.jacfwd(lambda x: function(x, Z)[0])(X), plain, rtol=1e-5)


@pytest.mark.parametrize("entry", [0, 1000])
@pytest.mark.parametrize("change", [1.0, 1e-12])
def test_tables_that_print_alike_are_told_apart(entry, change):
    """NumPy prints eight digits, and of a long array the ends only."""
    with jax.enable_x64(True):
        one = np.linspace(0.0, 1.0, 2000)
        other = one.copy()
        other[entry] += change
        x = np.linspace(0.0, 1.0, 16)
        read = lambda x: tuple(jnp.sum(jnp.asarray(table) * x[:, None], axis=1) for table in (one, other))  # noqa: E731
        for found, wanted in zip(jax.jit(deduplicated(read))(x), jax.jit(read)(x), strict=True):
            np.testing.assert_array_equal(found, wanted)


def test_what_is_surely_equal_is_merged():
    table = np.linspace(0.0, 1.0, 2000)
    once = names(program_of(lambda x: (jnp.sin(x) * table[0] + 1.0, jnp.sin(x) * table[0].copy() - 1.0), X))
    assert once.count("sin") == once.count("mul") == 1
