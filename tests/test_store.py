"""Results on disk: round trip, resume, damage, and other people's folders."""

import json
import shutil

import numpy as np
import pytest
import xarray as xr

import dssc_jax as dj
from dssc_jax.errors import ConfigError
from tests.conftest import UNCERTAIN


def same(left, right):
    xr.testing.assert_identical(left.dataset, right.dataset)


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(UNCERTAIN).override({"loop.duration": 3.0})


@pytest.fixture(scope="module")
def once(study, tmp_path_factory):
    """The folder that every test gets a copy of."""
    return dj.run(study, tmp_path_factory.mktemp("results") / "once", block=24).path


@pytest.fixture
def stored(once, tmp_path):
    return dj.load(shutil.copytree(once, tmp_path / "result"))


@pytest.fixture(scope="module")
def kept(study):
    """The same run, kept in memory."""
    return dj.run(study)


def test_folder_and_memory_agree(kept, stored):
    same(stored, kept)


def test_save_of_a_result_in_memory(kept, tmp_path):
    folder = kept.save(tmp_path / "saved")
    same(dj.load(folder), kept)
    assert json.loads((folder / "summary.json").read_text())["points"] == kept.summary()["points"]


def test_manifest_and_attributes(stored):
    manifest = json.loads((stored.path / "manifest.json").read_text())
    assert manifest["complete"] is True
    assert manifest["study"] == stored.study.table
    assert manifest["hash"] == stored.study.hash
    assert manifest["counts"] == {"points": 6, "draws": 24, "samples": 300}
    assert {"jax", "numpy", "dssc_jax"} <= manifest["versions"].keys()
    data = stored.dataset
    assert data["error_rms"].attrs["units"] == "m"
    assert data["outcome"].attrs["flag_meanings"] == "ok non_finite failed_error_max_after_2"
    assert data["plant.k_p"].dims == ("draw",)
    assert data["controller.l0"].attrs["units"] == "1/s"


def test_readable_by_plain_xarray(stored):
    data = xr.open_zarr(stored.path / "data.zarr", consolidated=False, chunks=None)
    np.testing.assert_array_equal(data["outcome"], stored.dataset["outcome"])


def test_resume_after_interruption_is_identical(study, stored, tmp_path):
    def stop(done, total):
        if done >= total / 2:
            raise KeyboardInterrupt

    folder = tmp_path / "interrupted"
    with pytest.raises(KeyboardInterrupt):
        dj.run(study, folder, block=24, progress=stop)
    with pytest.raises(ConfigError, match=r"is not complete: .* finish with --resume"):
        dj.load(folder)
    told = []
    resumed = dj.run(study, folder, resume=True, progress=lambda done, total: told.append(done))
    assert told[0] >= 72  # what was finished is kept
    same(resumed, stored)


def test_another_studys_folder_is_refused(study, stored):
    before = sorted(path.stat().st_mtime_ns for path in stored.path.rglob("*"))
    other = study.override({"controller.l0": 0.9})
    for resume in (True, False):
        with pytest.raises(
            ConfigError, match=r"another study \(controller.l0: 1.0 there, 0.9 here\).*nothing was written"
        ):
            dj.run(other, stored.path, resume=resume)
    assert sorted(path.stat().st_mtime_ns for path in stored.path.rglob("*")) == before


def test_a_folder_that_is_no_result_is_refused(study, tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    with pytest.raises(ConfigError, match="is not a results folder"):
        dj.run(study, tmp_path)
    assert (tmp_path / "thesis.tex").read_text() == "precious"
    with pytest.raises(ConfigError, match="is a file"):
        dj.run(study, tmp_path / "thesis.tex")


def altered(folder, **changes):
    """The manifest with some of its fields replaced."""
    path = folder / "manifest.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | changes))


DAMAGE = {
    "no manifest": lambda f: (f / "manifest.json").unlink(),
    "truncated manifest": lambda f: (f / "manifest.json").write_text((f / "manifest.json").read_text()[:100]),
    "empty manifest": lambda f: (f / "manifest.json").write_text("{}"),
    "manifest of another kind": lambda f: (f / "manifest.json").write_text("[1]"),
    "another schema": lambda f: altered(f, schema=9),
    "times that are no table": lambda f: altered(f, times=3),
    "times that are no numbers": lambda f: altered(f, times={"rate": "x"}),
    "times missing": lambda f: altered(f, times={}),
    "a stop that is no table": lambda f: altered(f, stopping=[1]),
    "a stop at no look": lambda f: altered(
        f, stopping={"rule": "r", "most": 1, "verdict": "v", "look": 0, "looks": []}
    ),
    "a cluster without workers": lambda f: altered(f, cluster={}),
    "no data": lambda f: shutil.rmtree(f / "data.zarr"),
    "no array": lambda f: shutil.rmtree(f / "data.zarr" / "error_rms"),
    "truncated metadata": lambda f: (f / "data.zarr" / "error_rms" / "zarr.json").write_text('{"zarr'),
    "truncated chunk": lambda f: [
        c.write_bytes(c.read_bytes()[:20]) for c in (f / "data.zarr/error_rms/c").rglob("*") if c.is_file()
    ],
    "missing chunk": lambda f: next(c for c in (f / "data.zarr/error_rms/c").rglob("*") if c.is_file()).unlink(),
    "missing outcome": lambda f: next(c for c in (f / "data.zarr/outcome/c").rglob("*") if c.is_file()).unlink(),
    "missing draws": lambda f: shutil.rmtree(f / "data.zarr/plant.k_p/c"),
}


@pytest.mark.parametrize("kind", DAMAGE)
def test_damage_is_told_in_one_line(stored, kind):
    DAMAGE[kind](stored.path)
    with pytest.raises(ConfigError) as caught:
        dj.load(stored.path)
    assert "\n" not in str(caught.value)
    assert str(stored.path) in str(caught.value)


def test_summary(stored):
    summary = stored.summary()
    assert len(summary["points"]) == 6
    for point in summary["points"]:
        low, high = point["interval"]
        assert low <= point["probability"] <= high
        assert sum(point["outcomes"].values()) == point["draws"] == 24
        assert point["controller.functions.tau_av"] in (0.02, 0.05, 0.1)
    json.dumps(summary, allow_nan=False)
