"""Results on disk: round trip, resume, damage, and other people's folders."""

import json
import re
import shutil

import numpy as np
import pytest
import xarray as xr
import zarr

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.results import store
from dssc_jax.results.digests import digest_of
from dssc_jax.results.schema import NOT_COMPUTED
from tests.conftest import UNCERTAIN
from tests.forging import redigested, resealed


def same(left, right):
    xr.testing.assert_identical(left.dataset, right.dataset)


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(UNCERTAIN).override({"loop.duration": 3.0})


@pytest.fixture(scope="module")
def original(study, tmp_path_factory):
    """The folder that every test gets a copy of."""
    return dj.run(study, tmp_path_factory.mktemp("results") / "once", block=24).path


@pytest.fixture
def stored(original, tmp_path):
    return dj.load(shutil.copytree(original, tmp_path / "result"))


@pytest.fixture(scope="module")
def kept(study):
    """The same run, kept in memory."""
    return dj.run(study)


def test_folder_and_memory_agree(kept, stored):
    same(stored, kept)


def test_a_run_keeps_what_its_folder_holds(study, tmp_path, monkeypatch):
    """Its values are those of the folder, which it need not read; a longer run reads the blocks of the earlier one."""
    with monkeypatch.context() as patch:
        patch.setattr(store, "read_dataset", None)
        result = dj.run(study, tmp_path / "run", block=24)
    assert result.dataset.identical(dj.load(tmp_path / "run").dataset)
    longer = dj.run(study.override({"draws": 30}), tmp_path / "run", resume=True)
    assert longer.dataset.identical(dj.load(tmp_path / "run").dataset)
    assert not longer.dataset["outcome"].isin(NOT_COMPUTED).any()


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
    assert data["outcome"].attrs["flag_meanings"] == "ok non_finite first_violated_error_max_after_2"
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
    with pytest.raises(ConfigError, match=r"is not complete: .* finish with `resume`"):
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


DAMAGE = {
    "no manifest": lambda f: (f / "manifest.json").unlink(),
    "truncated manifest": lambda f: (f / "manifest.json").write_text((f / "manifest.json").read_text()[:100]),
    "empty manifest": lambda f: (f / "manifest.json").write_text("{}"),
    "manifest of another kind": lambda f: (f / "manifest.json").write_text("[1]"),
    "another schema": lambda f: resealed(f, schema=9),
    "times that are no table": lambda f: resealed(f, times=3),
    "times that are no numbers": lambda f: resealed(f, times={"rate": "x"}),
    "times missing": lambda f: resealed(f, times={}),
    "a stop that is no table": lambda f: resealed(f, stopping=[1]),
    "a stop at no look": lambda f: resealed(
        f, stopping={"rule": "r", "most": 1, "verdict": "v", "stops": 1, "looks": []}
    ),
    "a look without failures": lambda f: resealed(
        f, stopping={"rule": "r", "most": 1, "verdict": "v", "stops": 1, "looks": [{"draws": 24}]}
    ),
    "a cluster without workers": lambda f: resealed(f, cluster={}),
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


def chunk(folder, name, *index):
    return folder / "data.zarr" / name / "c" / "/".join(map(str, index))


def swapped(one, other):
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)


def edited(file, change):
    """A JSON file with its content changed in place."""
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


def metadata(name, change):
    return lambda f: edited(f / "data.zarr" / name / "zarr.json", change)


LOOK = {"draws": 24, "lower": 2, "upper": 22, "failures": 1}
STOPPED = {"data_driven": True, "rule": "r", "most": 24, "verdict": "narrow", "stops": 9, "looks": [LOOK]}
ALTERATIONS = {
    "a chunk copied over another": lambda f: shutil.copy(
        chunk(f, "error_rms", 0, 0, 0), chunk(f, "error_rms", 1, 0, 0)
    ),
    "chunks of two blocks exchanged": lambda f: swapped(chunk(f, "outcome", 0, 0, 0), chunk(f, "outcome", 2, 1, 0)),
    "chunks of two variables exchanged": lambda f: swapped(
        chunk(f, "error_rms", 0, 0, 0), chunk(f, "error_max", 0, 0, 0)
    ),
    "chunks of two drawn numbers exchanged": lambda f: swapped(chunk(f, "plant.k_p", 0), chunk(f, "plant.a_p", 0)),
    "endian": metadata("error_rms", lambda m: m["codecs"][0]["configuration"].update(endian="big")),
    "fill value": metadata("error_rms", lambda m: m.update(fill_value=0.0)),
    "codec": metadata("error_rms", lambda m: m["codecs"].pop()),
    "another codec's settings": metadata("error_rms", lambda m: m["codecs"][1]["configuration"].update(checksum=False)),
    "dimension names": metadata("error_rms", lambda m: m["dimension_names"].reverse()),
    "a unit": metadata("error_rms", lambda m: m["attributes"].update(units="km")),
    "an attribute more": metadata("plant.k_p", lambda m: m["attributes"].update(valid=True)),
    "a coordinate's unit": metadata("controller.l0", lambda m: m["attributes"].update(units="km")),
    "the title": metadata("", lambda m: m["attributes"].update(title="another")),
    "an array more": lambda f: shutil.copytree(f / "data.zarr/outcome", f / "data.zarr/verdict"),
    "a coordinate's values": lambda f: shutil.copy(
        next((f / "data.zarr/plant.k_p/c").iterdir()), next((f / "data.zarr/controller.l0/c").iterdir())
    ),
    "a stop that was none": lambda f: edited(f / "manifest.json", lambda m: m.update(stopping=STOPPED)),
    "times": lambda f: edited(f / "manifest.json", lambda m: m["times"].update(rate=1e12)),
    "layout": lambda f: edited(f / "manifest.json", lambda m: m["layout"].update(block=[3, 2, 24])),
    "counts": lambda f: edited(f / "manifest.json", lambda m: m["counts"].update(draws=10**6)),
    "seed": lambda f: edited(f / "manifest.json", lambda m: m.update(seed=4)),
    "a field less": lambda f: edited(f / "manifest.json", lambda m: m.pop("started")),
    "no digest": lambda f: edited(f / "manifest.json", lambda m: m.pop("digest")),
    "an earlier schema": lambda f: edited(f / "manifest.json", lambda m: m.update(schema=1)),
    "digests exchanged": lambda f: swapped(f / "digests/0.0.0.json", f / "digests/1.0.0.json"),
    "digests deleted": lambda f: (f / "digests/1.1.0.json").unlink(),
    "all digests deleted": lambda f: shutil.rmtree(f / "digests"),
    "digests cut": lambda f: (f / "digests/1.1.0.json").write_text((f / "digests/1.1.0.json").read_text()[:80]),
    "digests changed": lambda f: edited(f / "digests/2.0.0.json", lambda m: m["pieces"][0][1].update(outcome="0" * 64)),
    "digests of fewer draws": lambda f: edited(
        f / "digests/2.0.0.json", lambda m: m["pieces"][0].__setitem__(0, [0, 9])
    ),
    "a chunk and its digests moved": lambda f: (
        shutil.rmtree(f / "data.zarr/error_rms/c/0"),
        shutil.copytree(f / "data.zarr/error_rms/c/1", f / "data.zarr/error_rms/c/0"),
        shutil.copy(f / "digests/1.0.0.json", f / "digests/0.0.0.json"),
    ),
}


@pytest.mark.parametrize("kind", ALTERATIONS)
def test_what_was_altered_is_refused_and_mended_or_left_alone(study, stored, kind):
    """Every byte of it reads well; read as it stands it would be another result, or none of this run."""
    ALTERATIONS[kind](stored.path)
    with pytest.raises(ConfigError) as caught:
        dj.load(stored.path)
    assert "\n" not in str(caught.value)
    assert str(stored.path) in str(caught.value)
    try:
        same(dj.run(study, stored.path, resume=True), stored)
    except ConfigError as error:
        assert re.search("is damaged|has schema version", str(error))  # noqa: PT017  (either end is right)
    else:
        same(dj.load(stored.path), stored)


def test_what_resume_mends(study, stored):
    """Blocks that do not match their digests are computed again, and no others."""
    ALTERATIONS["a chunk copied over another"](stored.path)
    ALTERATIONS["digests deleted"](stored.path)
    told = []
    same(dj.run(study, stored.path, resume=True, progress=lambda done, _: told.append(done)), stored)
    assert told == [96, 120, 144]


def test_a_forged_block_does_not_pass_for_the_runs_own(study, stored):
    """Its digests agree with it, and the manifest's with neither."""
    kept = (stored.path / "manifest.json").read_text()
    array = zarr.open_group(stored.path / "data.zarr", mode="r+")["error_rms"]
    array[0, 0] = np.zeros(24)
    redigested(stored.path)
    dj.load(stored.path)
    (stored.path / "manifest.json").write_text(kept)
    with pytest.raises(ConfigError, match="these are not the run's digests"):
        dj.load(stored.path)
    for asked in (study, study.override({"draws": 30})):
        with pytest.raises(ConfigError, match="these are not the run's digests; start over"):
            dj.run(asked, stored.path, resume=True)
    (stored.path / "digests" / "2.0.0.json").unlink()
    with pytest.raises(ConfigError, match="these are not the run's digests; start over"):
        dj.run(study, stored.path, resume=True)
    same(dj.run(study, stored.path), stored)


def test_a_loaded_result_is_saved_anew(stored, tmp_path):
    """In blocks of another size."""
    same(dj.load(stored.save(tmp_path / "again")), stored)


@pytest.mark.parametrize("version", [1, 2, 4, None])
def test_a_folder_of_another_schema_is_refused_and_left_alone(study, stored, version):
    resealed(stored.path, schema=version)
    before = {file: file.read_bytes() for file in stored.path.rglob("*") if file.is_file()}
    rule = f"has schema version {version}, this program reads 3" if version else "it has no schema version"
    message = rf"manifest\.json: .*{rule}; use the dssc_jax that wrote it, or run its study again into another `out`"
    for attempt in (
        lambda: dj.load(stored.path),
        lambda: dj.run(study, stored.path),
        lambda: dj.run(study, stored.path, resume=True),
    ):
        with pytest.raises(ConfigError, match=message) as caught:
            attempt()
        assert "\n" not in str(caught.value)
    assert {file: file.read_bytes() for file in stored.path.rglob("*") if file.is_file()} == before


def test_the_order_of_bytes_does_not_matter_to_a_digest():
    values = np.array([[1.0, -0.0], [np.nan, 3.0]])
    assert digest_of(values) == digest_of(values.astype(">f8")) == digest_of(np.asfortranarray(values))
    different = (values.astype("f4"), values.T, values.reshape(-1), values[::-1], np.abs(values))
    assert len({digest_of(values), *map(digest_of, different), digest_of(values, "m")}) == 7
