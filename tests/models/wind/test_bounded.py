"""Bounds that winds declare, against their simulated values; the law of the switching wind within bounds."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

import dssc_jax as dj
from dssc_jax.core.wind import WindBounds
from tests.models.wind.test_wind import TABLES, arrays, parsed
from tests.tolerances import ROUNDING

DT = 0.02
STAGES = 4
"""Times within a sample at which the wind is seen."""
RECORD = {"time": [0.5, 1.5, 2.0], "x": [1.0, -2.0, 3.0], "y": [0.5, 4.0, 0.0], "z": [0.0, 1.0, -2.0]}
BOUNDED = [
    {"kind": "none"},
    {"kind": "constant", **TABLES["constant"], "at": 1.0},
    {"kind": "constant", "x": 3.0, "y": -4.0, "z": 1.0},
    {"kind": "piecewise", **TABLES["piecewise"]},
    {"kind": "gust", **TABLES["gust"], "mean_y": -2.0},
    {"kind": "spline", "interval": 0.4, "x": [3.0, -1.0, 2.0], "y": [1.0], "z": [0.5, 0.5], "at": 1.0},
    {"kind": "record", **RECORD, "interpolation": "hold"},
    {"kind": "record", **RECORD},
    {"kind": "bounded", "speed": 5.0},
    {"kind": "bounded", **TABLES["bounded"], "period": 0.3},
]


def flown(table, paths=1, duration=6.0, seed=1):
    """The wind at stages of every sample, as the loop sees it, shape (paths, samples, STAGES + 1, 3)."""
    model, params = parsed(table)

    def path(key):
        def sample(state, k):
            t = k * DT
            state = arrays(model.step(params, state, jax.random.fold_in(key, k + 1), t, DT))
            stages = [jnp.stack(jnp.broadcast_arrays(*model.value(params, state, t + share * DT)))
                      for share in np.linspace(0.0, 1.0, STAGES + 1)]  # fmt: skip
            return state, jnp.stack(stages)

        start = arrays(model.init(params, jax.random.fold_in(key, 0)))
        return jax.lax.scan(sample, start, jnp.arange(round(duration / DT)))[1]

    keys = jax.random.split(jax.random.key(seed), paths)
    return np.asarray(jax.jit(jax.vmap(path))(keys), float)


def largest(winds):
    """The largest horizontal norm and vertical magnitude."""
    return np.hypot(winds[..., 0], winds[..., 1]).max(), np.abs(winds[..., 2]).max()


@pytest.mark.parametrize("table", BOUNDED, ids=lambda table: f"{table['kind']}-{len(table)}")
def test_declared_bounds_hold_and_are_reached(table):
    """Norms and rates stay within the bounds, and come within 10 % of them where anything blows."""
    model, params = parsed(table)
    bounds = model.bounds(params)
    assert isinstance(bounds, WindBounds)
    winds = flown(table, paths=256 if table["kind"] == "bounded" else 1)
    speed, vertical = largest(winds)
    for found, bound in ((speed, bounds.speed), (vertical, bounds.vertical)):
        assert found <= bound * (1.0 + ROUNDING)
        share = 0.6 if table["kind"] == "spline" else 0.9  # a spline stays inside the hull of its knots
        assert found >= share * bound
    jumps = np.diff(winds[:, :, 0], axis=1)
    if bounds.rate is None:
        assert max(largest(jumps)) > 0.5
    else:
        slopes = np.diff(winds, axis=2) / (DT / STAGES)
        assert max(largest(slopes)) <= bounds.rate * (1.0 + 1e-9) + 1e-9  # differences of rounded winds
        assert max(largest(jumps)) <= bounds.rate * DT * (1.0 + 1e-9)


def test_a_wind_without_known_bounds_declares_none():
    for table in ({"kind": "dryden", **TABLES["dryden"]}, {"kind": "record", **RECORD, "interpolation": "cubic"}):
        assert parsed(table)[0].bounds is None


def test_half_of_the_speed_is_vertical_by_default():
    model, params = parsed({"kind": "bounded", "speed": 7.0})
    assert model.bounds(params) == WindBounds(7.0, 3.5, None)


def test_bounds_of_a_sum_add_up():
    hover = {
        "name": "sum",
        "loop": {"duration": 1.0, "sample_time": 0.01},
        "plant": {"kind": "uav"},
        "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.1},
    }
    parts = [{"kind": "bounded", **TABLES["bounded"]}, {"kind": "constant", "x": 3.0, "y": 4.0, "z": -1.0}]
    study = dj.Study.from_table({**hover, "wind": parts})
    assert study.loop.wind.bounds(study.params({}).wind) == WindBounds(13.0, 4.0, 2.0)
    study = dj.Study.from_table({**hover, "wind": [*parts, {"kind": "bounded", "speed": 1.0}]})
    assert study.loop.wind.bounds(study.params({}).wind) == WindBounds(14.0, 4.5, None)
    assert (
        dj.Study.from_table({**hover, "wind": [parts[0], {"kind": "dryden", **TABLES["dryden"]}]}).loop.wind.bounds
        is None
    )


def test_the_switching_wind_has_its_law():
    """Extremes only, directions uniform over the circle, sides even, and geometric times of the stated mean."""
    period = 0.25
    winds = flown({"kind": "bounded", "speed": 3.0, "vertical": 1.0, "period": period}, paths=400)[:, :, 0]
    np.testing.assert_allclose(np.hypot(winds[..., 0], winds[..., 1]), 3.0, rtol=ROUNDING)
    np.testing.assert_array_equal(np.abs(winds[..., 2]), 1.0)
    switched = np.any(np.diff(winds, axis=1) != 0.0, axis=2)
    expected = -np.expm1(-DT / period)
    assert stats.binomtest(int(switched.sum()), switched.size, expected).pvalue > 1e-3
    directions = np.arctan2(winds[:, 1:, 1], winds[:, 1:, 0])[switched]
    assert stats.kstest(directions, stats.uniform(-np.pi, 2.0 * np.pi).cdf).pvalue > 1e-3
    up = winds[:, 1:, 2][switched] > 0.0
    assert stats.binomtest(int(up.sum()), up.size, 0.5).pvalue > 1e-3


def test_a_rate_moves_the_wind_straight_to_its_extreme():
    """Closed form of one switch: at the rate along the straight line, then at rest on the extreme."""
    model, params = parsed({"kind": "bounded", "speed": 2.0, "vertical": 1.0, "rate": 4.0, "period": 1e9})
    start, target = np.array([2.0, 0.0, 1.0]), np.array([0.0, 2.0, -1.0])
    state = model.init(params, jax.random.key(0))
    state = state._replace(wind=type(state.wind)(*start), since=1.0, target=type(state.wind)(*target))
    way = np.linalg.norm((target - start)[:2])
    for t in (1.0, 1.1, 1.35, 1.6, 1.9):
        horizontal, vertical = min(1.0, 4.0 * (t - 1.0) / way), min(1.0, 4.0 * (t - 1.0) / 2.0)
        expected = start + (target - start) * np.array([horizontal, horizontal, vertical])
        np.testing.assert_allclose(model.value(params, state, t), expected, rtol=0, atol=1e-14)


def test_draws_of_a_study_fly_within_the_bounds():
    """Through the whole loop and its machine code: many draws of the vehicle in a wind of bounded rate."""
    study = dj.Study.from_table(
        {
            "name": "adversary",
            "draws": 8,
            "loop": {"duration": 4.0, "sample_time": 0.02},
            "plant": {"kind": "uav"},
            "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.1},
            "wind": {"kind": "bounded", "speed": 4.0, "rate": 6.0, "period": 0.5},
        }
    )
    tracks = []
    for draw in range(3):
        flight = dj.simulate(study, draw=draw)
        tracks.append(np.stack([flight[f"wind_{axis}"].values for axis in "xyz"], axis=-1))
    winds = np.stack(tracks)
    speed, vertical = largest(winds)
    assert 3.9 < speed <= 4.0 * (1.0 + ROUNDING)
    assert 1.9 < vertical <= 2.0 * (1.0 + ROUNDING)
    assert max(largest(np.diff(winds, axis=1))) <= 6.0 * 0.02 * (1.0 + 1e-9)
    assert np.abs(winds[0] - winds[1]).max() > 1.0
