"""A few of the attacks of benchmarks/hostile.py on each kind of place, command and disk."""

import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest

import dssc_jax as dj
from tests.attacks import FILES, Ground, ended, largest_file
from tests.results.test_durability import SMALL

EXPORT = """
import sys
from dssc_jax.cli.main import guarded
for _ in range(5):
    assert guarded(["export", sys.argv[1], "--to", "csv", "--out", sys.argv[2]]) == 0
"""


@pytest.fixture(scope="module")
def ground(tmp_path_factory):
    return Ground(tmp_path_factory.mktemp("attacked"), SMALL)


@pytest.mark.parametrize(
    ("place", "command"),
    [
        ("report.html", "report"),
        ("report.html", "index"),
        ("../index.html", "index"),
        ("draws.csv", "csv"),
        ("draws.csv-metadata.json", "csv"),
        ("result.nc", "netcdf"),
        ("figures", "again"),
        ("figures/sweep.svg", "again"),
        ("manifest.json", "fresh"),
        ("data.zarr", "fresh"),
        ("data.zarr", "resume"),
        ("data.zarr/error_rms/c", "resume"),
        ("digests", "fresh"),
        ("summary.json", "resume"),
        (".lock", "fresh"),
        (".writer.json", "fresh"),
    ],
)
def test_nothing_is_written_through_a_link(ground, place, command):
    assert ground.link(place, command, "full").wrong == ""


@pytest.mark.parametrize(
    ("place", "command"),
    [
        ("manifest.json", "report"),
        ("digests/0.0.0.json", "csv"),
        ("data.zarr/error_rms/c/0/0/0", "resume"),
        ("report.html", "index"),
        (".lock", "fresh"),
        ("proofs.json", "report"),
    ],
)
def test_a_pipe_makes_nothing_wait(ground, place, command):
    assert ground.link(place, command, "pipe").wrong == ""


@pytest.mark.parametrize("how", ["moved", "deleted", "emptied", "replaced"])
@pytest.mark.parametrize("block", [2, 6])
def test_a_run_does_not_say_that_a_lost_folder_is_complete(ground, how, block):
    """In the midst, and after the last of its six blocks."""
    assert ground.lost(how, block).wrong == ""


@pytest.mark.parametrize("command", FILES)
@pytest.mark.parametrize("fresh", [True, False])
def test_a_full_disk_leaves_no_part(ground, command, fresh):
    ending = ground.full_disk(command, 500, fresh)
    assert ending.wrong == ""
    assert ending.code == 2
    assert "cannot be written: File too large" in ending.said


def test_a_full_disk_leaves_no_part_of_a_netcdf_file(ground):
    """HDF5 may end the whole process."""
    child = (
        "import resource, sys; from dssc_jax.cli.main import guarded; "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000)); "
        "sys.exit(guarded(['export', sys.argv[1], '--to', 'netcdf', '--out', sys.argv[2]]))"
    )
    out = ground.place / "part.nc"
    done = subprocess.run(
        [sys.executable, "-c", child, str(ground.whole.path), str(out)], capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stderr.splitlines()[-1] == f"error: {out}: cannot be written: File too large"
    assert not out.exists()


def test_two_exports_to_one_file(ground):
    """Each row is that of one of the two."""
    out = ground.place / "both.csv"
    arguments = [sys.executable, "-c", EXPORT, str(ground.whole.path), str(out)]
    with ThreadPoolExecutor(2) as both:
        done = list(both.map(lambda _: subprocess.run(arguments, capture_output=True, text=True), range(2)))
    assert [process.returncode for process in done] == [0, 0], done
    assert b"\0" not in out.read_bytes()
    frame = pd.read_csv(out)
    assert len(frame) == 144
    assert np.array_equal(np.sort(frame["error_rms"]), np.sort(ground.whole.dataset["error_rms"].values.ravel()))
    assert not list(ground.place.glob("*.partial"))


def test_an_analysis_is_not_written_through_a_link(ground, tmp_path):
    out = tmp_path / "rare"
    arguments = ["sensitivity", str(ground.study_file), "--draws", "256", "--out", str(out), "--json"]
    code, said = ended(arguments)
    assert code == 0, said
    for place in ("sensitivity.json", "data.zarr", "figures", "figures/sensitivity.png"):
        victim = tmp_path / "victim"
        (out / place).rename(victim)
        (out / place).symlink_to(victim)
        before = sorted((path, path.stat().st_mtime_ns) for path in [victim, *victim.rglob("*")])
        code, said = ended(arguments)
        assert code == 2
        assert "is a symbolic link" in said
        assert sorted((path, path.stat().st_mtime_ns) for path in [victim, *victim.rglob("*")]) == before
        (out / place).unlink()
        victim.rename(out / place)
    whole = dj.load(out)
    with largest_file(300):
        assert ended(arguments)[0] == 2
    assert dj.load(out) == whole
