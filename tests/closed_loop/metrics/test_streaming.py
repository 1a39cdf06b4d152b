"""Streaming metrics against the same numbers from the stored trajectory."""

from pathlib import Path
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.closed_loop.metrics.accumulation import final_values, initial_accumulators, update_accumulators
from dssc_jax.closed_loop.metrics.instants import Instant
from dssc_jax.closed_loop.metrics.streaming import METRICS, Measure, Scope, Window
from dssc_jax.closed_loop.metrics.window import first_sample
from dssc_jax.core.signals import Outcome

STUDIES = Path(__file__).parents[3] / "studies"


def test_streaming_equals_stored(case_2):
    study = case_2.override({"controller.rho": 0.75, "metrics": {"after": 10.0, "settling_band": 5.0}})
    run = dj.simulate(study)
    inside = run["t"].values >= 10.0 - 1e-9
    e, u, sigma = (run[name].values[inside] for name in ("e", "u", "sigma"))
    t = run["t"].values[inside]
    ratio = 0.005 / (run["k_o"] * run["tau_av"]) * (1 + 0.005 / (2 * run["tau_m"])) / 2
    expected = {
        "error_rms": np.sqrt(np.mean(e**2)),
        "error_max": np.abs(e).max(),
        "sigma_rms": np.sqrt(np.mean(sigma**2)),
        "sigma_max": np.abs(sigma).max(),
        "settling_time": t[np.abs(e) > 5.0].max() + 0.005 - 10.0,
        "command_tv": np.abs(np.diff(u)).sum(),
        "command_rms": np.sqrt(np.mean(u**2)),
        "command_max": np.abs(u).max(),
        "total_command_max": np.abs(run["u_total"].values[inside]).max(),
        "outside_sliding": np.mean(run["sliding_margin"].values[inside] < 0),
        "sampling_ratio": ratio.values[inside].max(),
        "sampling_ratio_above_1": 0.0,
    }
    assert set(expected) == {name for name, metric in METRICS.items() if metric.scope is Scope.CHANNEL}
    assert expected["outside_sliding"] > 0
    for name, value in expected.items():
        assert run.attrs[name] == pytest.approx(value, rel=1e-9), name


@pytest.mark.parametrize(("after", "variation"), [(0.0, 2.0), (0.495, 2.0), (0.5, 0.0), (0.51, 0.0)])
def test_the_jump_into_a_window_is_outside_of_it(after, variation):
    """A proportional controller jumps by 2 with its reference at 0.5 s, and rests else."""
    study = dj.Study.from_table(
        {
            "name": "jump",
            "draws": 1,
            "loop": {"duration": 1.0, "sample_time": 0.005},
            "plant": {"kind": "normal_form", "k_p": 1e-9, "a_p": 1.0},
            "reference": {"kind": "step", "size": 1.0, "at": 0.5},
            "controller": {"kind": "pid", "k_p": 2.0, "k_i": 0.0, "k_d": 0.0},
            "metrics": {"after": after, "names": ["command_tv", "total_command_tv"]},
        }
    )
    metrics = dj.simulate(study).attrs
    for name in ("command_tv", "total_command_tv"):
        assert metrics[name] == pytest.approx(variation, abs=1e-6), name


def test_unsettled_is_infinite(case_2):
    assert dj.simulate(case_2.override({"metrics.settling_band": 1e-9})).attrs["settling_time"] == np.inf


def test_settled_from_the_start_is_zero():
    study = dj.Study.from_table(
        {
            "name": "still",
            "loop": {"duration": 1.0, "sample_time": 0.01},
            "plant": {"kind": "normal_form"},
            "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.0},
        }
    )
    assert dj.simulate(study).attrs["settling_time"] == 0.0


@pytest.mark.parametrize(("after", "dt", "k"), [(0.0, 0.1, 0), (0.3, 0.1, 3), (20.0, 0.005, 4000), (0.25, 0.1, 3)])
def test_window_starts_at_the_first_sample_not_before(after, dt, k):
    """0.3/0.1 is 2.9999999999999996 in floating point."""
    assert first_sample(after, dt) == k


class Seen(NamedTuple):
    rotor_limited: bool
    tilt: float = 0.0


@pytest.mark.parametrize(
    ("flags", "after", "longest"),
    [
        ("000000", 0.0, 0),
        ("111111", 0.0, 6),
        ("011011101", 0.0, 3),
        ("110100", 0.0, 2),
        ("11110110", 0.2, 2),
        ("11110110", 0.3, 2),
        ("11111010", 0.3, 2),
    ],
)
def test_longest_uninterrupted_stretch(flags, after, longest):
    """A window that opens within a stretch counts from there."""
    measures = (Measure("limited", "rotor_limited_longest", Window(after), None),)
    accumulators = initial_accumulators(measures)
    for k, flag in enumerate(flags):
        instant = Instant(0.1 * k, 0.1, (), Seen(flag == "1"))
        accumulators = update_accumulators(measures, accumulators, instant, jnp.asarray(k), 0.1)
    assert float(final_values(measures, accumulators, len(flags), 0.1)["limited"]) == pytest.approx(0.1 * longest)


def test_a_rotor_at_its_limit_for_too_long_is_an_outcome():
    """A vehicle that sinks at 6 m/s, whose rotors lift little more than its weight."""
    weak = {"plant.velocity": [0.0, 0.0, -6.0], "plant.vehicle.max_thrust": {"uniform": [28.0, 36.0]}}
    bound = {"requirement": [{"metric": "rotor_limited_longest", "max": 0.5}]}
    study = dj.Study.load(STUDIES / "paper_case1.toml").override({"draws": 8, "loop.duration": 2.0, **weak, **bound})
    found = dj.run(study).dataset
    longest, code = found["rotor_limited_longest"].values, found["outcome"].values
    assert 0 < np.count_nonzero(longest > 0.5) < 8
    np.testing.assert_array_equal(code == Outcome.REQUIREMENT, longest > 0.5)
    np.testing.assert_array_equal(code == Outcome.OK, longest <= 0.5)
    np.testing.assert_array_equal(longest == 0.0, found["rotor_limited"].values == 0.0)


def test_extremes_of_a_signal_are_violated_when_they_pass_their_bounds():
    """As `error_max` is; the samples at which the recorded signals pass the bounds are the independent check."""
    study = dj.Study.from_table(
        {
            "name": "extremes",
            "draws": 4,
            "loop": {"duration": 2.0, "sample_time": 0.01},
            "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "a_p": 1.0, "initial": [1.0, 0.0]},
            "controller": {"kind": "pid", "k_p": 6.0, "k_i": 2.0, "k_d": 3.0},
            "requirement": [
                {"metric": "error_max", "after": 0.5, "max": 0.2},
                {"signal": "e", "metric": "max_abs", "after": 0.5, "max": 0.2},
                {"signal": "y", "metric": "highest", "max": 0.9},
                {"signal": "u", "metric": "lowest", "min": -5.0},
                {"signal": "u", "metric": "variation", "max": 2.0},
            ],
        }
    )
    data = dj.run(study).dataset.squeeze()
    np.testing.assert_array_equal(data["violated_at_max_abs_e_after_0.5"], data["violated_at_error_max_after_0.5"])
    for draw in range(4):
        run = dj.simulate(study, draw)
        t, y, u = (run[name].values for name in ("t", "y", "u"))
        travelled = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(u)))])
        passed = {
            "error_max_after_0.5": (np.abs(y) > 0.2) & (t >= 0.5 - 1e-9),
            "highest_y": y > 0.9,
            "lowest_u_min": u < -5.0,
            "variation_u": travelled > 2.0,
        }
        for name, hits in passed.items():
            assert float(data[f"violated_at_{name}"][draw]) == pytest.approx(t[np.argmax(hits)])


@pytest.mark.parametrize(
    ("metric", "side", "bound", "told"),
    [
        ("error_max", "max", -1.5, r"requirement\.0\.max: must be >= 0 m, as every error_max is; got -1\.5"),
        ("iae", "min", -1.0, r"requirement\.0\.min: must be >= 0"),
        ("growth_rate", "max", -1.5, ""),
    ],
)
def test_a_size_has_no_negative_bound(case_2, metric, side, bound, told):
    """Every draw would violate it, or none: it is a slip of the sign."""
    study = case_2.override({"units": {"output": "m", "command": "m/s"}})
    change = {"requirement": [{"metric": metric, side: bound}]}
    if not told:
        assert study.override(change).requirements[0].maximum == bound
        return
    with pytest.raises(dj.ConfigError, match=told):
        study.override(change)
