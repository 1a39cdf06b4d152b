"""Every analysis has one shape: it sums itself up, draws itself, is saved, loaded, reported, listed and exported."""

import copy
import json
import shutil

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.figure import Figure

import dssc_jax as dj
from dssc_jax.analyses.loading import KINDS, class_of
from dssc_jax.cli.main import guarded
from dssc_jax.console.answers import show_analysis
from dssc_jax.flight_logs.reading.reader import Column
from dssc_jax.results.fields import field_meanings
from dssc_jax.results.manifest import write_json, write_sealed
from tests.loops import LAGGED

TABLE = LAGGED | {
    "name": "shape",
    "seed": 2,
    "draws": 16,
    "loop": {"duration": 1.5, "sample_time": 0.02},
    "disturbance": {"kind": "step", "value": {"uniform": [-0.6, 0.6]}, "at": 0.5},
    "metrics": {"names": ["error_rms", "command_tv"]},
    "requirement": [{"metric": "error_max", "after": 1.0, "max": 0.34}],
    "tune": {
        "parameters": {"controller.l0": [0.3, 4.0]},
        "objective": {"error_rms": 1.0},
        "limits": {"command_tv": "start"},
        "draws": 8,
        "validation": 8,
        "steps": 2,
    },
}
WALK = {"over": "unmodelled.mu", "bounds": (0.02, 1.5), "log": True, "points": 4, "bisections": 3}
PAIR = (dj.RegionAxis("unmodelled.mu", 0.02, 1.0, True), dj.RegionAxis("plant.k_p", 0.5, 1.5))
TIMES = np.arange(75) * 0.02
LOG = dj.FlightLog("sine", {name: Column(TIMES, np.sin(TIMES)) for name in ("y", "y_dot", "u_total")}, 0.0)
LOGS = [dj.FlightLog("sine", {"y": Column(TIMES, np.sin(TIMES) + 0.01 * k)}, 0.0) for k in range(9)]
SPENT = dj.Splitting(particles=10, killed=5, moves=1, repeats=10, plain=64)
HOVER = {
    "name": "shape",
    "seed": 2,
    "loop": {"duration": 2.0, "sample_time": 0.02},
    "plant": {"kind": "uav", "vehicle": {"kind": "m600_quadrotor", "mass": {"uniform": [10.5, 11.5]}}},
    "controller": {"kind": "pi", "l0": 1.0, "k_p": 1.0, "k_i": 0.1},
    "wind": {"kind": "bounded", "speed": 4.0},
}
"""What flies, for analyses that need a wind."""
RUN = {
    "margin": lambda study: dj.margin(study, **WALK),
    "loop": lambda study: dj.loop_margins(study),
    "margins": lambda study: dj.compare_margins(study, ["dssc", "pi"], **WALK),
    "compare": lambda study: dj.compare(study, ["dssc", "pi"], candidates=2, tuning_draws=4),
    "sensitivity": lambda study: dj.sensitivity(study.override({"draws": 256})),
    "laws": lambda study: dj.laws(study.override({"draws": 200}), limit=0.7, within={"kl": 0.1}, shift=0.1, fresh=64),
    "law-ranges": lambda study: dj.law_ranges(
        study.override({"draws": 200, "plant.k_p": {"uniform": [[0.6, 0.7], 1.3]}})
    ),
    "region": lambda study: dj.region(study.override({"draws": 200}), over=PAIR, halvings=0),
    "compare-log": lambda study: dj.compare_log(study, LOG),
    "next-flight": lambda study: dj.next_flight(study.override({"draws": 40}), LOGS),
    "probability": lambda study: dj.probability(study, 0.1),
    "select": lambda study: dj.select(study, candidates=8, keep=2, within=0.3),
    "rare": lambda study: dj.rare(study, None, SPENT),
    "falsify": lambda study: dj.falsify(study, budget=40),
    "tune": lambda study: dj.tune(study),
    "worst-loop": lambda study: dj.worst_loop(study.override({"draws": 8}), cells=200),
    "worst-wind": lambda study: dj.worst_wind(dj.Study.from_table(HOVER), segments=4, rounds=1),
    "theory": lambda study: dj.theory.assess(study, **WALK, rivals={"pi": study}),
}
"""Each kind of analysis, as small as it can be."""


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(copy.deepcopy(TABLE))


@pytest.fixture(scope="module", params=sorted(KINDS))
def analysis(request, study):
    return RUN[request.param](study)


@pytest.fixture(scope="module")
def folder(analysis, tmp_path_factory):
    """The analysis, saved; nothing writes to it but what stands beside."""
    return analysis.save(tmp_path_factory.mktemp("results") / analysis.kind)


def test_every_kind_is_here():
    assert RUN.keys() == KINDS.keys()
    assert all(class_of(kind).kind == kind for kind in KINDS)


def test_it_has_the_shape(analysis, study):
    assert isinstance(analysis, dj.Analysis)
    assert isinstance(analysis, class_of(analysis.kind))
    assert analysis.study.name == study.name
    summary = analysis.summary()
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert summary["study"] == study.name
    assert set(analysis.table) <= set(analysis.dataset.dims)
    assert analysis.headline
    assert "\n" not in analysis.headline


def test_variables_tell_what_they_are(analysis):
    for name, one in analysis.dataset.variables.items():
        assert one.attrs.get("long_name"), name
        assert one.dtype.kind != "f" or "units" in one.attrs, name


def test_each_number_of_the_answer_has_a_meaning(analysis):
    meanings = list(field_meanings(type(analysis).answer_type()))
    top = {meaning.key.partition(".")[0].removesuffix("[]") for meaning in meanings}
    assert top == analysis.summary().keys() - {"study", "integration"}
    assert all(meaning.meaning for meaning in meanings)


def test_it_draws_itself(analysis):
    figure = analysis.figure()
    assert isinstance(figure, Figure)
    assert all(ax.has_data() or ax.texts for ax in figure.axes)


def test_it_comes_back_equal(analysis, folder):
    again = dj.load(folder)
    assert type(again) is type(analysis)
    assert again.path == folder
    assert again.summary() == analysis.summary()
    xr.testing.assert_identical(again.dataset, analysis.dataset)
    assert again == analysis
    assert again.headline == analysis.headline
    assert json.loads((folder / "summary.json").read_text()) == analysis.summary()
    assert isinstance(again.figure(), Figure)
    assert again.save(folder) == folder


def test_another_is_not_equal(analysis):
    other = copy.copy(analysis)
    other.dataset = analysis.dataset.assign_attrs(title="another")
    assert other != analysis
    assert analysis != 1


def test_it_is_reported_and_listed(folder, analysis, capsys):
    assert guarded(["report", str(folder), "--json"]) == 0
    capsys.readouterr()
    page = (folder / "report.html").read_text()
    assert analysis.title in page
    assert "<svg" in page
    assert guarded(["report", "--index", str(folder.parent), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)["results"]
    assert (row["trouble"], row["kind"], row["answer"]) == ("", analysis.title, analysis.headline)
    assert f'href="{analysis.kind}/report.html"' in (folder.parent / "index.html").read_text()


def test_it_is_exported(folder, analysis, tmp_path):
    netcdf, data, about, parquet = [
        path for form in ("netcdf", "csv", "parquet") for path in dj.export(analysis, form, tmp_path / f"a.{form}")
    ]
    with xr.open_dataset(netcdf, engine="h5netcdf", decode_timedelta=False) as found:
        xr.testing.assert_equal(found, analysis.dataset)
    rows = int(np.prod([analysis.dataset.sizes[dimension] for dimension in analysis.table]))
    table = pd.read_csv(data)
    assert len(table) == len(pd.read_parquet(parquet)) == rows
    described = {column["name"]: column for column in json.loads(about.read_text())["tableSchema"]["columns"]}
    assert list(described) == list(table.columns)
    for name, one in analysis.dataset.data_vars.items():
        if one.dims == analysis.table and one.dtype.kind == "f":
            np.testing.assert_array_equal(table[name], one.values.reshape(-1), err_msg=name)
    assert guarded(["export", str(folder), "--to", "csv", "--json"]) == 0
    assert (folder / "table.csv").exists()


def test_a_damaged_one_is_refused(folder, analysis, tmp_path):
    for name in ("chunk", "cut", "empty", "forged"):
        shutil.copytree(folder, tmp_path / name)
    described = f"{analysis.kind}.json"
    chunks = sorted((tmp_path / "chunk" / "data.zarr").rglob("c"))
    shutil.rmtree(next(chunk for chunk in chunks if chunk.is_dir()))
    (tmp_path / "cut" / described).write_text((folder / described).read_text()[:-40])
    about = json.loads((folder / described).read_text())
    del about["digest"]
    write_sealed(tmp_path / "empty" / described, {**about, "settings": {"nothing": 0}})
    write_json(tmp_path / "forged" / described, {**about, "digest": "0"})
    for name in ("chunk", "cut", "empty", "forged"):
        with pytest.raises(dj.ConfigError, match="damaged"):
            dj.load(tmp_path / name)


def test_another_study_keeps_its_folder(folder, analysis, tmp_path):
    other = copy.copy(analysis)
    other.study = analysis.study.override({"seed": 77})
    with pytest.raises(dj.ConfigError, match="of another study"):
        other.save(folder)
    (tmp_path / "file").touch()
    with pytest.raises(dj.ConfigError, match="something other than"):
        analysis.save(tmp_path)


def test_a_folder_of_another_schema_is_refused(folder, analysis, tmp_path):
    shutil.copytree(folder, tmp_path / "old")
    path = tmp_path / "old" / f"{analysis.kind}.json"
    about = json.loads(path.read_text())
    without_version = {name: value for name, value in about.items() if name != "schema"}
    for content, rule in (
        (without_version, "it has no schema version"),
        (about | {"schema": 2}, "has schema version 2, this program reads 3"),
    ):
        write_json(path, content)
        with pytest.raises(dj.ConfigError, match=f"{rule}; use the dssc_jax that wrote it") as caught:
            dj.load(tmp_path / "old")
        assert "\n" not in str(caught.value)
        stored = path.read_text()
        with pytest.raises(dj.ConfigError, match=rule):
            analysis.save(tmp_path / "old")
        assert path.read_text() == stored


def test_parts_come_back_too(study, tmp_path):
    """What an assessment and a contest are made of: margins with their own variables, units and studies."""
    found = RUN["theory"](study)
    found.save(tmp_path / "t")
    again = dj.load(tmp_path / "t")
    assert again.performance == found.performance
    assert again.local == found.local
    for name, oscillation in found.oscillations.items():
        xr.testing.assert_identical(again.oscillations[name], oscillation)
    assert found.local["sampled"].dataset["slack"].attrs["units"] == "1/s"
    contest = RUN["margins"](study)
    contest.save(tmp_path / "m")
    assert dj.load(tmp_path / "m").margins == contest.margins


def test_it_can_be_printed_without_an_output_of_its_own(analysis, capsys):
    show_analysis(analysis, [])
    shown = capsys.readouterr().out
    assert analysis.title in shown
    assert analysis.headline[:20] in shown
