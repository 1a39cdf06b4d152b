"""Wind: every kind keeps the contract; closed forms; bad tables."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.vectors import Vec3
from dssc_jax.models.wind import WINDS
from dssc_jax.study.components import parse_component
from tests.tolerances import ROUNDING

CLOCK = 1e-9
"""Relative to the jump: rounding of t = k dt, divided by dt."""

TABLES = {
    "none": {},
    "constant": {"x": 8.0, "y": -8.0, "z": 8.0, "at": 20.0},
    "piecewise": {"times": [1.0, 2.0, 3.5], "x": [1.0, -2.0, 0.0], "y": [0.0, 4.0, 5.0], "z": [0.5, 0.0, -0.5]},
    "gust": {"x": 3.0, "y": -1.0, "z": 0.5, "at": 2.0, "duration": 4.0, "mean_x": 1.0},
    "spline": {"interval": 2.0, "x": [3.0, -1.0, 2.0], "z": [0.5], "at": 1.0},
    "dryden": {"speed": 8.0, "altitude": 3.0, "airspeed": 15.0, "direction": 0.7},
    "bounded": {"speed": 8.0, "vertical": 3.0, "rate": 2.0, "period": 1.5},
}


def parsed(table):
    component = parse_component(table, WINDS, "wind")
    return component.model, component.params


def arrays(tree):
    """A state as the loop carries it."""
    return jax.tree.map(lambda x: jnp.asarray(x, dtype=jnp.result_type(float)), tree)


def held_at(table, t, dt=0.01):
    """The wind held over the sample [t, t + dt), seen at t."""
    model, params = parsed(table)
    key = jax.random.key(0)
    state = model.step(params, model.init(params, key), key, t, dt)
    return np.array([float(part) for part in model.value(params, state, t)])


def test_every_kind_has_a_case():
    """A record is data without numbers of its own: tests/study/test_winds.py."""
    assert {*TABLES, "record"} == set(WINDS)


@pytest.mark.parametrize("kind", TABLES)
def test_contract(kind):
    """Vec3 of finite scalars, a state that a scan can carry, vmap equals a loop, gradients, float32 stays float32."""
    model, params = parsed({"kind": kind, **TABLES[kind]})
    numbers, tree = jax.tree.flatten(params)

    def path(numbers, key):
        """Every number traced, three samples from t = 2."""
        params = tree.unflatten(numbers)

        def sample(state, k):
            return model.step(params, state, jax.random.fold_in(key, k + 1), 2.0 + 0.4 * k, 0.4), None

        state, _ = jax.lax.scan(sample, arrays(model.init(params, key)), jnp.arange(3))
        return state, model.value(params, state, 2.9)

    keys = jax.random.split(jax.random.key(0), 8)
    floats = [jnp.asarray(x, dtype=float) for x in numbers]
    one_path = jax.jit(path)
    state, velocity = one_path(floats, keys[0])
    assert type(velocity) is Vec3
    for leaf in jax.tree.leaves((state, velocity)):
        assert jnp.shape(leaf) == ()
        assert jnp.isfinite(leaf)

    batches = [x * jnp.linspace(1.0, 1.2, 8) for x in floats]
    batched = jax.jit(jax.vmap(path))(batches, keys)
    for i in range(8):
        one = one_path([x[i] for x in batches], keys[i])
        for b, o in zip(jax.tree.leaves(batched), jax.tree.leaves(one), strict=True):
            np.testing.assert_allclose(b[i], o, rtol=ROUNDING, atol=ROUNDING)

    def energy(numbers):
        return sum(jnp.square(part) for part in path(numbers, keys[0])[1])

    for leaf in jax.tree.leaves(jax.jit(jax.grad(energy))(floats)):
        assert jnp.isfinite(leaf)

    with jax.enable_x64(False):
        single = jax.eval_shape(path, [jnp.float32(x) for x in numbers], jax.random.key(0))
        for leaf in jax.tree.leaves(single):
            assert leaf.dtype == jnp.float32


@pytest.mark.parametrize(
    ("table", "t", "expected"),
    [
        ({"kind": "none"}, 5.0, (0, 0, 0)),
        ({"kind": "constant", "x": 8, "y": -8, "z": 8}, 0.0, (8, -8, 8)),
        ({"kind": "constant", **TABLES["constant"]}, 19.99, (0, 0, 0)),
        ({"kind": "constant", **TABLES["constant"]}, 20.0, (8, -8, 8)),
        ({"kind": "constant", **TABLES["constant"]}, 19.9975, (6, -6, 6)),  # mean of the sample
        ({"kind": "piecewise", **TABLES["piecewise"]}, 0.5, (0, 0, 0)),
        ({"kind": "piecewise", **TABLES["piecewise"]}, 1.0, (1, 0, 0.5)),
        ({"kind": "piecewise", **TABLES["piecewise"]}, 1.99, (1, 0, 0.5)),
        ({"kind": "piecewise", **TABLES["piecewise"]}, 1.995, (-0.5, 2, 0.25)),  # half of each
        ({"kind": "piecewise", **TABLES["piecewise"]}, 2.0, (-2, 4, 0)),
        ({"kind": "piecewise", **TABLES["piecewise"]}, 99.0, (0, 5, -0.5)),
        ({"kind": "gust", **TABLES["gust"]}, 1.9, (1, 0, 0)),
        ({"kind": "gust", **TABLES["gust"]}, 3.0, (1 + 1.5, -0.5, 0.25)),
        ({"kind": "gust", **TABLES["gust"]}, 4.0, (1 + 3, -1, 0.5)),
        ({"kind": "gust", **TABLES["gust"]}, 6.5, (1, 0, 0)),
        ({"kind": "spline", **TABLES["spline"]}, 1.0, ((4 * 3 - 1) / 6, 0, 4 * 0.5 / 6)),
        ({"kind": "spline", **TABLES["spline"]}, 3.0, ((3 - 4 + 2) / 6, 0, 0.5 / 6)),
        ({"kind": "spline", **TABLES["spline"]}, 9.0, (0, 0, 0)),
    ],
)
def test_values(table, t, expected):
    np.testing.assert_allclose(held_at(table, t), expected, rtol=0, atol=8 * CLOCK)


def test_gust_is_the_1_cosine():
    ts = np.linspace(2.0, 6.0, 41)
    shape = (1 - np.cos(2 * np.pi * (ts - 2.0) / 4.0)) / 2
    found = np.array([held_at({"kind": "gust", **TABLES["gust"]}, t) for t in ts])
    np.testing.assert_allclose(found, [1, 0, 0] + shape[:, None] * [3, -1, 0.5], rtol=0, atol=1e-14)


def test_piecewise_means_within_one_long_sample():
    """A sample that spans the whole table holds the table's mean: nothing is lost between samples."""
    table = {"kind": "piecewise", **TABLES["piecewise"]}
    mean = (1.0 * np.array([1, 0, 0.5]) + 1.5 * np.array([-2, 4, 0]) + 0.5 * np.array([0, 5, -0.5])) / 4.0
    np.testing.assert_allclose(held_at(table, 0.0, 4.0), mean, rtol=0, atol=1e-14)


@pytest.mark.parametrize(
    ("change", "location", "rule"),
    [
        ({"times": [1.0, 3.0, 2.0]}, "wind.times.2", r"increase strictly: must be > 3, the one before, got 2"),
        ({"times": [1.0, 1.0, 2.0]}, "wind.times.1", r"must be > 1, the one before, got 1"),
        ({"times": [1.0, {"uniform": [0.5, 2.0]}, 3.0]}, "wind.times.1", r"must be > 1, the one before, got 0.5"),
        ({"times": [-1.0, 1.0, 2.0]}, "wind.times", r"must be >= 0"),
        ({"y": [0.0, 4.0]}, "wind.y", r"must hold 3 numbers, one for each of times, got 2"),
        ({"times": [], "x": [], "y": [], "z": []}, "wind.times", r"at least one time"),
        ({"x": [1.0, float("nan"), 0.0]}, "wind.x", r"finite number"),
    ],
)
def test_bad_tables(change, location, rule):
    with pytest.raises(ConfigError, match=rule) as error:
        parsed({"kind": "piecewise", **TABLES["piecewise"], **change})
    assert error.value.where == location


@pytest.mark.parametrize(
    ("kind", "change", "location"),
    [
        ("dryden", {"altitude": 2.0}, "wind.altitude"),
        ("dryden", {"altitude": 400.0}, "wind.altitude"),
        ("dryden", {"airspeed": 0.0}, "wind.airspeed"),
        ("dryden", {"speed": -1.0}, "wind.speed"),
        ("dryden", {"speed": {"normal": [6.0, 1.0]}}, "wind.speed"),
        ("dryden", {"turbulence": -0.1}, "wind.turbulence"),
        ("gust", {"duration": 0.0}, "wind.duration"),
        ("constant", {"at": -1.0}, "wind.at"),
    ],
)
def test_bad_numbers(kind, change, location):
    with pytest.raises(ConfigError) as error:
        parsed({"kind": kind, **TABLES[kind], **change})
    assert error.value.where == location


def test_a_row_at_a_sample_has_the_derivative_of_a_later_one():
    """The row before fills what a later row leaves."""
    model, _ = parsed({"kind": "piecewise", **TABLES["piecewise"]})

    def distance(at):
        params = model.params((1.0, at, 3.5), (1.0, -2.0, 0.0), (0.0,) * 3, (0.0,) * 3)
        held = jax.vmap(lambda t: model.step(params, None, None, t, 0.1).x)(jnp.arange(60) * 0.1)
        return jnp.sum(held) * 0.1

    for at in (2.0, 2.1, 2.35):
        assert jax.grad(distance)(at) == pytest.approx(1.0 - -2.0)
