"""Recorded references from CSV and Parquet files, and references of a vehicle's own channels."""

import os

import numpy as np
import pandas as pd
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.hints.references import study_references
from dssc_jax.study.recorded import recorded_columns
from dssc_jax.study.tables import to_toml

TIMES = np.arange(0.0, 5.0, 0.25)
VALUES = np.sin(TIMES)
TABLE = {
    "name": "recorded",
    "loop": {"duration": 4.0, "sample_time": 0.01},
    "plant": {"kind": "normal_form"},
    "controller": {"kind": "pi", "l0": 1.0, "k_p": 3.0, "k_i": 0.0},
    "reference": {"kind": "record", "file": "log.csv", "column": "set point"},
}


@pytest.fixture
def folder(tmp_path):
    frame = pd.DataFrame({"t": TIMES, "time": TIMES + 1.0, "set point": VALUES, "word": ["a"] * len(TIMES)})
    frame.to_csv(tmp_path / "log.csv", index=False)
    frame.to_parquet(tmp_path / "log.parquet")
    (tmp_path / "study.toml").write_text(to_toml(TABLE))
    return tmp_path


@pytest.mark.parametrize("changes", [{}, {"reference.file": "log.parquet"}])
def test_a_column_is_followed(folder, changes):
    study = dj.Study.load(folder / "study.toml")
    if changes:
        study = dj.Study.from_table(TABLE | {"reference": {"kind": "zero"}}, str(folder / "study.toml")).override(
            {"reference": TABLE["reference"], **changes}
        )
    run = dj.simulate(study)
    np.testing.assert_allclose(run["y_ref"], np.interp(run["t"], TIMES, VALUES), atol=1e-12)
    assert not any(name.startswith("reference") for name in study.numbers)


def test_the_result_contains_the_record(folder):
    """It is read, and simulated again, where the file is gone."""
    dj.run(dj.Study.load(folder / "study.toml")).save(folder / "out")
    (folder / "log.csv").unlink()
    result = dj.load(folder / "out")
    assert result.study.table["reference"] == {"kind": "record", "time": list(TIMES), "value": list(VALUES)}
    assert dj.replay(result, 0).attrs["agreement"] == "agrees"


def test_a_command_runs_it(folder, monkeypatch, capsys):
    """With the warning of noise, which looks at every number of the loop."""
    monkeypatch.chdir(folder)
    noise = "sensor={ kind = 'noisy', position_std = 1e-3 }"
    assert guarded(["run", "study.toml", "--set", noise, "--draws", "2"]) == 0
    assert "failure probability" in capsys.readouterr().out


def test_another_time_column(folder):
    study = dj.Study.load(folder / "study.toml").override(
        {"reference": TABLE["reference"] | {"time_column": "time", "interpolation": "hold"}}
    )
    run = dj.simulate(study)
    assert float(run["y_ref"][150]) == VALUES[2]  # 1.5 s is 0.5 s after the first


def test_one_column_may_serve_two_fields(tmp_path):
    """As of a wind with the same gust along x and y, or of a value that rises as the time."""
    (tmp_path / "wind.csv").write_text("t,w,z\n0,1,2\n1,3,4\n")
    found = recorded_columns(tmp_path / "wind.csv", ["t", "w", "w", "z"])
    assert found == [[0.0, 1.0], [1.0, 3.0], [1.0, 3.0], [2.0, 4.0]]
    assert recorded_columns(tmp_path / "wind.csv", ["t", "t"]) == [[0.0, 1.0], [0.0, 1.0]]


def test_a_rate_comes_from_a_file_of_its_own(folder):
    """Or from the record's file, in another column."""
    times = np.arange(0.1, 5.0, 0.5)
    pd.DataFrame({"t": times, "speed": times**2}).to_csv(folder / "rate.csv", index=False)
    study = dj.Study.load(folder / "study.toml")
    for more, expected in (
        ({"rate_file": "rate.csv", "rate_column": "speed"}, lambda t: np.interp(t, times, times**2)),
        ({"rate_column": "time"}, lambda t: np.interp(t, TIMES, TIMES + 1.0)),
    ):
        rated = study.override({"reference": TABLE["reference"] | more})
        value, slope, _ = study_references(rated, 400)[0]
        t = 0.01 * np.arange(400)
        np.testing.assert_allclose(slope, expected(t), atol=1e-12)
        np.testing.assert_allclose(value, np.interp(t, TIMES, VALUES), atol=1e-12)
        assert not any("file" in name or "column" in name for name in rated.table["reference"])


@pytest.mark.parametrize(
    ("reference", "complaint"),
    [
        ({"rate_column": "speed"}, r"reference.rate_column: 'log.csv' has no column 'speed'"),
        ({"rate_column": "word"}, r"reference.rate_column: 'log.csv' must hold numbers there; line 2 has 'a'"),
        ({"rate_file": "log.csv"}, r"reference.rate_column: is required and missing"),
        ({"rate_column": "time", "rate": [1.0]}, r"reference.rate: is given by the file"),
        ({"file": "absent.csv"}, r"reference.file: '.*absent.csv' cannot be read"),
        ({"column": "setpoint"}, r"reference.column: 'log.csv' has no column 'setpoint'; did you mean 'set point'"),
        ({"column": "word"}, r"reference.column: 'log.csv' must hold numbers"),
        ({"time_column": "x"}, r"reference.time_column: 'log.csv' has no column 'x'"),
        ({"time": [1, 2]}, r"reference.time: is given by the file"),
        ({"file": 3}, r"reference.file: must be a text"),
        ({"file": "/dev/zero"}, r"reference.file: '/dev/zero' cannot be read: it is no file"),
    ],
)
def test_bad_records_are_refused(folder, reference, complaint):
    (folder / "study.toml").write_text(to_toml(TABLE | {"reference": TABLE["reference"] | reference}))
    with pytest.raises(ConfigError, match=complaint):
        dj.Study.load(folder / "study.toml")


def test_a_disturbance_has_no_rate(folder):
    disturbance = {"kind": "record", "file": "log.csv", "column": "time", "rate_column": "set point"}
    (folder / "study.toml").write_text(to_toml(TABLE | {"disturbance": disturbance}))
    with pytest.raises(ConfigError, match=r"disturbance.rate_column: .*; a recorded disturbance has no rate"):
        dj.Study.load(folder / "study.toml")


def test_a_received_folder_opens_no_file(folder):
    """A manifest that names a file is not one that this program wrote."""
    with pytest.raises(ConfigError, match=r"reference.time: is required and missing"):
        dj.Study.from_table(TABLE, str(folder / "study.toml"))


def test_each_channel_follows_its_own():
    """x a step, psi a record, y and z the whole trajectory's."""
    study = dj.Study.load("studies/uav_robustness.toml").without_sweep()
    study = study.override(
        {
            "loop.duration": 2.0,
            "requirement": [],
            "metrics": {"names": ["error_rms"]},
            "reference": {
                "kind": "hover",
                "position": [1.0, 2.0, 3.0],
                "x": {"kind": "step", "size": {"uniform": [1.0, 3.0]}, "at": 1.0},
                "psi": {"kind": "record", "time": [0.0, 2.0], "value": [0.0, 0.4]},
            },
        }
    )
    run = dj.simulate(study, draw=3)
    t, size = run["t"].values, run.attrs["reference.x.size"]
    assert 1.0 < size < 3.0
    np.testing.assert_allclose(run["x_y_ref"], np.where(t >= 1.0 - 1e-9, size, 0.0))
    np.testing.assert_allclose(run["psi_y_ref"], 0.2 * t, atol=1e-12)
    assert np.all(run["y_y_ref"] == 2.0)
    assert np.all(run["z_y_ref"] == 3.0)
    assert study.quantities["reference.x.size"].unit == "m"
    assert "reference.position.0" in study.numbers


def test_only_channels():
    study = dj.Study.load("studies/uav_robustness.toml").override(
        {"sweep": {}, "reference": {"psi": {"kind": "ramp", "slope": 0.1}}}
    )
    assert study.quantities["reference.psi.slope"].unit == "rad/s"
    with pytest.raises(ConfigError, match=r"reference.psi: must be a table|reference.psi"):
        study.override({"reference": {"psi": {"kind": "rampe"}}})


def test_a_table_of_too_many_columns_is_refused_at_once(tmp_path):
    """Before pandas reads it, which would take minutes."""
    for count, said in ((500_000, "has 500000 columns, more than a record can have"), (10_000, "has no column 't'")):
        names = ",".join(f"c{index}" for index in range(count))
        (tmp_path / "wide.csv").write_text(f"# a comment, with commas\n\n{names}\n")
        with pytest.raises(ConfigError, match=said):
            recorded_columns(tmp_path / "wide.csv", ["t"])
    pd.DataFrame(np.zeros((1, 10_001)), columns=[f"c{i}" for i in range(10_001)]).to_parquet(tmp_path / "wide.parquet")
    with pytest.raises(ConfigError, match="has 10001 columns"):
        recorded_columns(tmp_path / "wide.parquet", ["t"])


def test_a_pipe_is_no_record(tmp_path):
    os.mkfifo(tmp_path / "log.csv")
    with pytest.raises(ConfigError, match="it is no file"):
        recorded_columns(tmp_path / "log.csv", ["t"])


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "t,y\n0,1\n0.1,nan\n0.2,3\n",
            r"reference.column: 'log.csv' must hold numbers or empty cells; line 3 has 'nan'",
        ),
        ("# a road\nt,y\n\n0,1\n0.2,2\n0.1,3\n", r"time_column: .* rising times; 0.1 s comes after 0.2 s in line 6"),
        ("t,y\n0,1\n0,2\n", r"rising times; 0 s comes after 0 s in line 3"),
        ("t,y\n0,1\n0.1,inf\n", r"must hold finite numbers; line 3 does not"),
        ("t,y\n0,1\n0.1,two\n", r"must hold numbers there; line 3 has 'two'"),
        ("t,y\n12:00:01,1\n12:00:02,2\n", r"must hold numbers there; line 2 has '12:00:01'; write times in seconds"),
        ("t,y\n", r"reference.file: 'log.csv' has no row with numbers in 't', 'y'"),
        ("", r"reference.file: '.*log.csv' is empty"),
        ("t,z\n0,1\n", r"reference.column: 'log.csv' has no column 'y'"),
        ("t,y\n0,1\n", r"reference.time: must hold 2 to"),
    ],
)
def test_a_fault_of_a_record_is_named_with_its_line(folder, text, complaint):
    (folder / "log.csv").write_text(text)
    (folder / "study.toml").write_text(to_toml(TABLE | {"reference": TABLE["reference"] | {"column": "y"}}))
    with pytest.raises(ConfigError, match=complaint):
        dj.Study.load(folder / "study.toml")


def test_rows_with_an_empty_cell_are_left_out(tmp_path):
    (tmp_path / "log.csv").write_text("t,y,z\n0,1,\n0.1,,5\n0.2,3,\n")
    assert recorded_columns(tmp_path / "log.csv", ["t", "y"]) == [[0.0, 0.2], [1.0, 3.0]]


@pytest.mark.parametrize("zone", [None, "Europe/Zurich"])
def test_dates_and_time_spans_of_parquet_are_seconds(tmp_path, zone):
    """Whatever the unit in which the file holds them."""
    seconds = [0.5, 1.25, 3.0]
    spans = pd.to_timedelta(seconds, unit="s")
    dates = pd.to_datetime([10.5, 11.25, 13.0], unit="s", utc=zone is not None)
    frame = pd.DataFrame({"t": spans, "date": dates if zone is None else dates.tz_convert(zone), "y": [1.0, 2.0, 3.0]})
    for unit in ("ms", "ns"):
        columns = frame.assign(t=frame["t"].dt.as_unit(unit), date=frame["date"].dt.as_unit(unit))
        columns.to_parquet(tmp_path / "log.parquet")
        assert recorded_columns(tmp_path / "log.parquet", ["t", "date"]) == [seconds, [10.5, 11.25, 13.0]]
    columns.loc[1, "date"] = pd.NaT
    columns.to_parquet(tmp_path / "log.parquet")
    assert recorded_columns(tmp_path / "log.parquet", ["date"]) == [[10.5, 13.0]]  # without the empty row
