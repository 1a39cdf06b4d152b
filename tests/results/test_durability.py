"""Runs killed, crowded out, extended or damaged: finished blocks are kept, the others are recomputed."""

import json
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest
import xarray as xr

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from tests.forging import resealed

SMALL = {
    "name": "small",
    "seed": 3,
    "draws": 24,
    "loop": {"duration": 0.5, "sample_time": 0.01},
    "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "initial": [1.0, 0.0]},
    "controller": {"kind": "pi", "l0": 1.0, "k_p": {"lognormal": [0.0, 0.1]}, "k_i": 0.5},
    "metrics": {"names": ["error_rms", "error_max"]},
    "requirement": [{"metric": "error_max", "after": 0.3, "max": 0.98}],
    "sweep": {"controller.k_i": [0.1, 0.5, 1.0], "controller.l0": [0.5, 1.0]},
}
CHILD = """
import json, resource, sys
import dssc_jax as dj
study = dj.Study.from_table(json.loads(sys.argv[1]))
def progress(done, total):
    print(done, flush=True)
    if sys.argv[3] == "full" and done >= total / 2:
        resource.setrlimit(resource.RLIMIT_FSIZE, (40, 40))
try:
    dj.run(study, sys.argv[2], resume=True, block=8, progress=progress)
except dj.ConfigError as error:
    print(error)
"""


def same(left, right):
    xr.testing.assert_identical(left.dataset, right.dataset)


def a_chunk(folder, name):
    """The file of some chunk of an array."""
    return next(file for file in (folder / "data.zarr" / name / "c").rglob("*") if file.is_file())


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(SMALL)


@pytest.fixture(scope="module")
def whole(study, tmp_path_factory):
    """The uninterrupted run."""
    return dj.run(study, tmp_path_factory.mktemp("results") / "whole", block=24)


@pytest.fixture
def copied(whole, tmp_path):
    """A folder of one's own to harm."""
    return Path(shutil.copytree(whole.path, tmp_path / "copied"))


def child(study, folder, kind):
    """A run in a process of its own, in blocks of 8 lanes: 18 of them."""
    arguments = [sys.executable, "-c", CHILD, json.dumps(study.table), str(folder), kind]
    return subprocess.Popen(arguments, stdout=subprocess.PIPE, text=True)


def test_killed_three_times_and_resumed(study, whole, tmp_path):
    folder = tmp_path / "killed"
    begun = []
    for lines, wait in ((1, 0.01), (4, 0.0), (5, 0.02)):
        process = child(study, folder, "killed")
        begun.append([int(process.stdout.readline()) for _ in range(lines)])
        time.sleep(wait)
        process.kill()
        process.communicate()
    first = [told[0] for told in begun]
    assert first[0] == 0
    assert first[1] < begun[1][-1] <= first[2] < 144  # every life went on from what the one before had finished
    same(dj.run(study, folder, resume=True), whole)
    assert not list(folder.rglob("*.partial"))


def test_a_full_disk_is_told_and_gone_on_from(study, whole, tmp_path):
    process = child(study, tmp_path / "full", "full")
    *done, said = process.communicate(timeout=600)[0].splitlines()
    assert process.returncode == 0
    assert done[-1] == "72"
    assert said.endswith(
        "full: cannot be written: File too large; finished blocks are kept, `resume` continues from them"
    )
    told = []
    same(dj.run(study, tmp_path / "full", resume=True, progress=lambda done, _: told.append(done)), whole)
    assert told[0] == 72


@pytest.mark.parametrize("block", [24, 12, 1000])
def test_more_draws_keep_what_exists(study, tmp_path, block):
    """Blocks of whole draws, of parts of them, and one with room to spare; the first run cut short where it can be."""
    more = study.override({"draws": 59})

    def stop(done, total):
        if done == 120:
            raise KeyboardInterrupt

    folder = tmp_path / "grown"
    try:
        dj.run(study, folder, block=block, progress=stop)
    except KeyboardInterrupt:
        assert block != 1000
    with pytest.raises(ConfigError, match="out: is needed to resume"):
        dj.run(more, resume=True)
    with pytest.raises(ConfigError, match="holds 24 draws of this study; add 35 with `resume`"):
        dj.run(more, folder)
    told = []
    grown = dj.run(more, folder, resume=True, progress=lambda done, _: told.append(done))
    assert told[0] == (144 if block == 1000 else 120)
    same(grown, dj.run(more))
    assert grown.manifest["counts"]["draws"] == 59
    with pytest.raises(ConfigError, match="draws: 59 there, 24 here"):
        dj.run(study, folder, resume=True)
    assert dj.run(more, folder, resume=True).manifest == grown.manifest


def test_points_that_depend_on_their_number_are_not_extended(study, copied, monkeypatch):
    monkeypatch.setattr("dssc_jax.results.manifest.EXTENSIBLE", ())
    with pytest.raises(
        ConfigError, match="holds 24 draws of 'random' sampling, which depend on their number: 30 of them"
    ):
        dj.run(study.override({"draws": 30}), copied, resume=True)


def test_a_run_without_a_sweep_grows(study, tmp_path):
    """Drawn numbers and results have the same dimension there."""
    single = study.without_sweep()
    first = dj.run(single, tmp_path / "single")
    same(first, dj.run(single))
    told = []
    more = single.override({"draws": 40})
    same(dj.run(more, tmp_path / "single", resume=True, progress=lambda done, _: told.append(done)), dj.run(more))
    assert told == [24, 40]


def test_a_run_killed_while_growing(study, copied, monkeypatch):
    more = study.override({"draws": 40})
    with monkeypatch.context() as patch:
        patch.setattr("dssc_jax.results.store.extend_arrays", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt))
        with pytest.raises(KeyboardInterrupt):
            dj.run(more, copied, resume=True)
    with pytest.raises(ConfigError, match="is not complete: 96 of 240 lanes are missing"):
        dj.load(copied)
    same(dj.run(more, copied, resume=True), dj.run(more))


def test_other_versions_are_refused(study, whole, copied):
    resealed(copied, versions=whole.manifest["versions"] | {"jax": "0.0.1"})
    assert dj.run(study, copied, resume=True).path == copied  # nothing to compute
    a_chunk(copied, "outcome").unlink()
    with pytest.raises(ConfigError, match=r"was begun otherwise \(versions.jax: '0.0.1' there, .*nothing was written"):
        dj.run(study, copied, resume=True)
    same(dj.run(study, copied), whole)


def test_two_writers(study, tmp_path):
    met = []

    def meanwhile(done, total):
        with pytest.raises(ConfigError, match=rf"is being written by process {os.getpid()} on .* since 20"):
            dj.run(study, tmp_path / "one", resume=True)
        met.append(done)

    dj.run(study, tmp_path / "one", progress=meanwhile)
    assert met
    dj.run(study, tmp_path / "one", resume=True)


@pytest.mark.parametrize("name", ["error_rms", "outcome", "plant.k_p"])
@pytest.mark.parametrize("harm", ["deleted", "cut", "flipped"])
def test_resume_mends_a_chunk(study, whole, copied, name, harm):
    chunk = a_chunk(copied, name)
    content = bytearray(chunk.read_bytes())
    if harm == "deleted":
        chunk.unlink()
    else:
        content[len(content) // 2] ^= 1
        chunk.write_bytes(content if harm == "flipped" else content[:-3])
    with pytest.raises(ConfigError, match=r"`resume`"):
        dj.load(copied)
    same(dj.run(study, copied, resume=True), whole)


def test_metadata_that_is_lost_is_not_guessed(study, copied):
    (copied / "data.zarr" / "error_rms" / "zarr.json").write_text("{")
    before = sorted(file.stat().st_mtime_ns for file in copied.rglob("c/*"))
    with pytest.raises(ConfigError, match=r"is damaged: .*; start over without `resume`"):
        dj.run(study, copied, resume=True)
    assert sorted(file.stat().st_mtime_ns for file in copied.rglob("c/*")) == before


def test_stores_of_zarr_2_are_not_opened(copied):
    """Its metadata may name the codec that unpickles; the third version has none."""
    data = xr.open_zarr(copied / "data.zarr", consolidated=False, chunks=None).load()
    shutil.rmtree(copied / "data.zarr")
    data.drop_encoding().to_zarr(copied / "data.zarr", zarr_format=2, consolidated=False)
    with pytest.raises(ConfigError, match=r"data.zarr: cannot be opened"):
        dj.load(copied)


def test_nothing_is_unpickled():
    for path in Path(dj.__file__).parent.rglob("*.py"):
        text = path.read_text()
        assert not any(word in text for word in ("import pickle", "cloudpickle", "allow_pickle", "np.load", "marshal"))
