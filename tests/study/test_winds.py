"""Several winds at once, and wind and disturbance from recorded files."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.vectors import Vec3
from tests.conftest import UNCERTAIN
from tests.mutations import document

MEAN = {"kind": "constant", "x": 3.0, "y": -1.0, "z": 0.5}
GUST = {"kind": "gust", "x": 2.0, "y": 0.0, "z": 1.0, "duration": 2.0, "at": 0.5}
FLIGHT = {
    "name": "windy",
    "draws": 2,
    "loop": {"duration": 2.0, "sample_time": 0.02},
    "plant": {"kind": "uav"},
    "controller": {"kind": "pid", "k_p": 1.0},
    "wind": [MEAN, GUST, {"kind": "dryden", "speed": {"uniform": [2.0, 4.0]}, "altitude": 10.0, "airspeed": 5.0}],
}


def at(study, t):
    """The sum of a constant wind and a gust at one time."""
    return study.loop.wind.value(study.params({}).wind, (Vec3(3.0, -1.0, 0.5), ()), t)


def test_winds_add_up():
    both = dj.Study.from_table({**FLIGHT, "wind": [MEAN, GUST]})
    alone = dj.Study.from_table({**FLIGHT, "wind": {**GUST, "mean_x": 3.0, "mean_y": -1.0, "mean_z": 0.5}})
    for t in (0.0, 0.7, 1.5, 1.9):
        expected = alone.loop.wind.value(alone.params({}).wind, (), t)
        assert np.asarray(at(both, t)) == pytest.approx(np.asarray(expected))
    left, right = (dj.simulate(study)["x_e"].values for study in (both, alone))
    assert left == pytest.approx(right, abs=1e-9)


def test_numbers_of_several_winds_have_names_laws_and_axes():
    study = dj.Study.from_table(FLIGHT)
    assert list(study.laws) == ["wind.2.speed"]
    swept = study.override({"sweep": {"wind.1.x": [0.0, 5.0]}, "wind.0.x": 1.0})
    result = dj.run(swept)
    assert result.dataset["wind.1.x"].attrs["units"] == "m/s"
    assert (result.dataset["position_error_max"].diff("wind.1.x").values != 0.0).all()
    assert "constant + gust + dryden" in dj.report.html(result, worst=0)
    with pytest.raises(ConfigError, match=r"wind\.1\.duration"):
        study.override({"wind.1.duration": -1.0})
    with pytest.raises(ConfigError, match=r"wind: needs at least one"):
        study.override({"wind": []})
    one = dj.Study.from_table({**UNCERTAIN, "sweep": {}})
    with pytest.raises(ConfigError, match=r"wind\.kind: the plant 'normal_form' does not fly"):
        one.override({"wind": [MEAN]})


def test_two_equal_turbulences_are_independent():
    calm = {"kind": "dryden", "speed": 5.0, "altitude": 10.0, "airspeed": 5.0}
    one, two = (dj.Study.from_table({**FLIGHT, "wind": wind}) for wind in ([calm], [calm, calm]))
    single, both = (dj.simulate(study)["z_e"].values for study in (one, two))
    assert np.abs(both - 2.0 * single).max() > 1e-3


@pytest.fixture
def recorded(tmp_path):
    rows = ["t,wx,wy,wz,push", *(f"{t},{t},{-t},0.5,{0.3 if t >= 2 else 0.0}" for t in np.arange(0.0, 5.0, 0.5))]
    (tmp_path / "gusts.csv").write_text("\n".join(rows))
    return tmp_path


def test_a_recorded_wind(recorded):
    wind = {"kind": "record", "file": "gusts.csv", "columns": ["wx", "wy", "wz"]}
    (recorded / "study.toml").write_bytes(document({**FLIGHT, "wind": [wind, MEAN]}))
    study = dj.Study.load(recorded / "study.toml")
    assert study.table["wind"][0]["x"][3] == 1.5
    params = study.params({}).wind
    assert np.asarray(study.loop.wind.value(params, ((), Vec3(3.0, -1.0, 0.5)), 1.25)) == pytest.approx(
        [4.25, -2.25, 1.0]
    )
    (recorded / "study.toml").write_bytes(document({**FLIGHT, "wind": {**wind, "columns": ["wx"]}}))
    with pytest.raises(ConfigError, match=r"wind\.columns: must be the file's columns with x, y, z"):
        dj.Study.load(recorded / "study.toml")


def test_a_recorded_disturbance_is_the_step_that_was_recorded(recorded):
    table = {**UNCERTAIN, "sweep": {}, "draws": 3}
    record = {"kind": "record", "file": "gusts.csv", "column": "push", "interpolation": "hold"}
    (recorded / "study.toml").write_bytes(document({**table, "disturbance": record}))
    ours = dj.run(dj.Study.load(recorded / "study.toml")).dataset["error_rms"].values
    step = dj.Study.from_table({**table, "disturbance": {"kind": "step", "value": 0.3, "at": 2.0}})
    assert ours == pytest.approx(dj.run(step).dataset["error_rms"].values, rel=1e-6)
