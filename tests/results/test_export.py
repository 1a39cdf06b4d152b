"""What other programs read: the numbers to the last bit, with units and meanings."""

import json
import sys

import duckdb
import numpy as np
import pandas as pd
import pytest
import xarray as xr
from pyarrow import parquet

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.results.export import matlab_name
from tests.results.test_durability import SMALL


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    study = dj.Study.from_table({**SMALL, "description": 'commas, "quotes"'})
    return dj.run(study, tmp_path_factory.mktemp("results") / "small")


def is_the_table(table, result):
    """Every value of the dataset, one row a lane."""
    assert len(table) == 3 * 2 * 24
    wide = table.set_index(["controller.k_i", "controller.l0", "draw"])
    for name, values in result.dataset.data_vars.items():
        broadcast = values.broadcast_like(result.dataset["outcome"]).values.reshape(-1)
        np.testing.assert_array_equal(wide[name].to_numpy(), broadcast, err_msg=name)
    codes = dict(zip(table["outcome"], table["outcome_meaning"], strict=True))
    assert codes == {0: "ok", 10: "first_violated_error_max_after_0.3"}


def test_csv(result, tmp_path):
    data, metadata_file = dj.export(result, "csv", tmp_path / "a.csv")
    is_the_table(pd.read_csv(data), result)
    content = json.loads(metadata_file.read_text())
    assert metadata_file.name == "a.csv-metadata.json"
    assert content["url"] == "a.csv"
    named = {column["name"]: column for column in content["tableSchema"]["columns"]}
    assert list(named) == list(pd.read_csv(data).columns)
    assert named["plant.k_p"]["schema:unitText"] == "1/s"
    assert named["plant.k_p"]["dc:source"] == "uniform(0.8, 1.2)"
    assert named["error_rms"]["dc:description"] == "rms of the output error e"


def test_parquet(result, tmp_path, monkeypatch):
    monkeypatch.setattr("dssc_jax.results.export.TABLE_ROWS", 24)  # six row groups
    (path,) = dj.export(result, "parquet", tmp_path / "a.parquet")
    is_the_table(pd.read_parquet(path), result)
    file = parquet.ParquetFile(path)
    assert file.num_row_groups == 6
    attributes = file.schema_arrow.field("error_rms").metadata
    assert (attributes[b"units"], attributes[b"long_name"]) == (b"m", b"rms of the output error e")
    assert json.loads(file.schema_arrow.metadata[b"study"]) == result.study.table


@pytest.mark.parametrize("form", ["csv", "parquet"])
def test_duckdb_counts_failures(result, tmp_path, form):
    path, *_ = dj.export(result, form, tmp_path / f"a.{form}")
    asked = f"""select count(*), max("error_max") from '{path}' where outcome <> 0"""
    ((failures, worst),) = duckdb.sql(asked).fetchall()
    assert failures == int(result.failed.sum())
    assert worst == float(result.dataset["error_max"].where(result.failed).max())


def test_netcdf(result, tmp_path):
    previous = result.dataset.copy(deep=True)
    (path,) = dj.export(result, "netcdf", tmp_path / "a.nc")
    xr.testing.assert_identical(result.dataset, previous)
    with xr.open_dataset(path, engine="h5netcdf", decode_timedelta=False) as found:
        xr.testing.assert_equal(found, result.dataset)
        assert found.attrs["Conventions"].startswith("CF-")
        assert found["error_rms"].attrs == {"units": "m", "long_name": "rms of the output error e"}
        assert found["outcome"].attrs["flag_values"].dtype == found["outcome"].dtype
        assert found.attrs["study_hash"] == result.study.hash


def test_a_draw_that_ended_early(tmp_path):
    """NaN and infinities arrive as such."""
    table = {**SMALL, "plant": {**SMALL["plant"], "initial": [1e308, 1e308]}, "sweep": {}}
    result = dj.run(dj.Study.from_table(table))
    (csv, _), (table,) = (dj.export(result, form, tmp_path / form) for form in ("csv", "parquet"))
    for found in (pd.read_csv(csv), pd.read_parquet(table)):
        assert set(found["outcome_meaning"]) == {"non_finite"}
        assert found["slack_error_max_after_0.3"].eq(-np.inf).all()


def test_what_is_missing_is_told(result, tmp_path, monkeypatch):
    with pytest.raises(ConfigError, match="to: must be one of csv, parquet, netcdf, mat, got 'xlsx'"):
        dj.export(result, "xlsx", tmp_path / "a.xlsx")
    with pytest.raises(ConfigError, match="cannot be written: No such file or directory"):
        dj.export(result, "csv", tmp_path / "nowhere" / "a.csv")
    with pytest.raises(ConfigError, match="needed for a result that has no folder"):
        dj.export(dj.Result(result.study, result.dataset), "csv")
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigError, match=r"to: parquet needs pyarrow: pip install 'dssc_jax\[export\]'"):
        dj.export(result, "parquet", tmp_path / "a.parquet")
    assert list(tmp_path.iterdir()) == []


def test_command(result, capsys):
    assert guarded(["export", str(result.path), "--to", "csv", "--json"]) == 0
    files = json.loads(capsys.readouterr().out)["files"]
    assert files == [str(result.path / "draws.csv"), str(result.path / "draws.csv-metadata.json")]
    assert guarded(["export", str(result.path), "--to", "netcdf"]) == 0
    assert "result.nc" in capsys.readouterr().out
    assert guarded(["export", str(result.path), "--to", "pdf"]) == 2


def test_names_for_matlab_are_short_and_differ():
    """Of 63 characters at most, also with an ending; one that is taken is not given again."""
    taken = ["a", "a_v3"]
    for _ in range(3):
        taken.append(matlab_name("a", taken))
    assert taken == ["a", "a_v3", "a_v2", "a_v4", "a_v5"]
    long = ["9" * 80]
    for _ in range(12):
        long.append(matlab_name("9" * 80, long))
    assert len(set(long)) == 13
    assert all(len(name) == 63 and name.startswith("v9") for name in long[1:])
