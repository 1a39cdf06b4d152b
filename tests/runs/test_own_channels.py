"""Trajectories of a plant of one's own with any number of channels."""

import sys

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError

PLANT = """
from typing import Annotated, NamedTuple

from dssc_jax.types import ChannelUnits, Measurement, Plant, Quantity


class Params(NamedTuple):
    k: Annotated[float, Quantity("1", "gain", above=0.0)] = 1.0


class State(NamedTuple):
    x: tuple
    v: tuple


def plant(names):
    def derivative(params, state, drive, t):
        inputs = zip(drive.command, drive.disturbance, state.v)
        return State(state.v, tuple(params.k * (u + w) - v for u, w, v in inputs))

    return Plant(
        params=Params,
        init=lambda params: State(tuple(0.1 * (i + 1) for i in range(len(names))), (0.0,) * len(names)),
        derivative=derivative,
        measure=lambda params, state, drive: tuple(map(Measurement, state.x, state.v)),
        input_gain=lambda params: (params.k,) * len(names),
        channels=tuple(names),
        units=tuple(ChannelUnits("m", "N", name, name) for name in names),
    )


TWO = plant("ab")
THREE = plant("abc")
FIVE = plant("abcdf")
FLYING = TWO._replace(
    flies=True,
    derivative=lambda params, state, drive, t: TWO.derivative(params, state, drive, t)._replace(
        x=(state.v[0] + (0.0 if drive.wind is None else drive.wind.x), state.v[1])
    ),
)
"""


@pytest.fixture
def channels(tmp_path, monkeypatch):
    """A module with plants of several channels."""
    (tmp_path / "own_channels.py").write_text(PLANT)
    monkeypatch.syspath_prepend(tmp_path)
    yield
    sys.modules.pop("own_channels", None)


def table_of(plant, **changes):
    """A small study of one of the plants."""
    return {
        "name": "channels",
        "draws": 3,
        "loop": {"duration": 1.0, "sample_time": 0.05},
        "plant": {"kind": f"own_channels:{plant}", "k": {"uniform": [0.5, 1.0]}},
        "controller": {"kind": "pi", "l0": 1.0, "k_p": 2.0, "k_i": 1.0},
        "requirement": [{"metric": "error_max_b", "max": 0.3}],
        **changes,
    }


@pytest.mark.parametrize(("plant", "names"), [("TWO", "ab"), ("THREE", "abc"), ("FIVE", "abcdf")])
def test_a_trajectory_has_the_channels_of_the_plant_and_the_metrics_of_its_run(channels, plant, names):
    study = dj.Study.from_table(table_of(plant))
    result = dj.run(study, check=False)
    trajectory = dj.simulate(study, 1)
    assert [name for name in trajectory if str(name).endswith("y_ref")] == [f"{name}_y_ref" for name in names]
    for name in names:
        for metric in (f"error_rms_{name}", f"command_tv_{name}"):
            assert trajectory.attrs[metric] == pytest.approx(float(result.dataset[metric][1]), rel=1e-12)
        error = trajectory[f"{name}_e"].values
        assert np.sqrt(np.mean(error**2)) == pytest.approx(trajectory.attrs[f"error_rms_{name}"], rel=1e-9)
    assert dj.replay(result, 1).attrs["deviation"] < 1e-9


@pytest.mark.parametrize("plant", ["TWO", "FIVE"])
def test_channels_follow_references_of_their_own(channels, plant):
    """Beyond the four points of a flight, too; the other channels stay at zero."""
    last = {"TWO": "b", "FIVE": "f"}[plant]
    study = dj.Study.from_table(table_of(plant, reference={last: {"kind": "step", "size": 0.5, "at": 0.0}}))
    trajectory = dj.simulate(study)
    assert np.all(trajectory[f"{last}_y_ref"].values == 0.5)
    assert np.all(trajectory["a_y_ref"].values == 0.0)


def test_a_kind_of_reference_that_is_no_name_is_refused(channels):
    with pytest.raises(ConfigError, match="reference"):
        dj.Study.from_table(table_of("FIVE", reference={"kind": ["zero"]}))


@pytest.mark.parametrize("plant", ["TWO", "FIVE"])
def test_code_records_the_channels_of_the_plant(channels, plant, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = "\n".join(
        [
            'name = "channels"',
            "draws = 2",
            "loop = { duration = 1.0, sample_time = 0.05 }",
            f'plant = {{ kind = "own_channels:{plant}", k = {{ uniform = [0.5, 1.0] }} }}',
            'controller = { kind = "pi", l0 = 1.0, k_p = 2.0, k_i = 1.0 }',
        ]
    )
    (tmp_path / "channels.toml").write_text(text)
    assert guarded(["code", "channels.toml", "--allow-local", "--out", "written", "--draws", "1"]) == 0
    assert (tmp_path / "written" / "recorded.bin").stat().st_size > 0


WIND = {"kind": "constant", "x": 1.0, "y": 0.0, "z": 0.0}
STEPS = {"kind": "steps", "position": [0.1, 0.2, 3.0], "yaw": 1.0}


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        ({"wind": WIND}, r"wind\.kind: "),
        ({"reference": STEPS}, "reference: is a vehicle's"),
        ({"reference": {"position": [1.0, 0.0, 0.0]}}, "reference: is a vehicle's"),
        ({"reference": {**STEPS, "a": {"kind": "step", "size": 0.5}}}, "reference: is a vehicle's"),
    ],
)
def test_wind_and_flights_need_a_plant_that_flies(channels, changes, place):
    """They had no effect, without a word; or a channel followed the position of another unit."""
    with pytest.raises(ConfigError, match=rf"{place}.*'own_channels:TWO' does not fly; .*declares `flies=True`"):
        dj.Study.from_table(table_of("TWO", **changes))


def test_a_plant_that_flies_takes_wind_and_flights(channels):
    still = dj.simulate(dj.Study.from_table(table_of("FLYING", reference=STEPS)))
    windy = dj.simulate(dj.Study.from_table(table_of("FLYING", reference=STEPS, wind=WIND)))
    assert np.all(still["b_y_ref"].values == 0.2)
    assert windy["a_y"].values[-1] > still["a_y"].values[-1]
    np.testing.assert_array_equal(windy["b_y"], still["b_y"])
