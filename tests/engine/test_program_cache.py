"""Compiled programs between processes: read where they are whole and in their place, else compiled again."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.trace_memory.memory import cached_by_subjects
from dssc_jax.engine.batching import lane_of_study
from dssc_jax.engine.compiled_lanes import compiled_lanes
from dssc_jax.lanes import program_cache
from dssc_jax.lanes.program_cache import DIGEST, DISK_BLOCK, SEARCHES, ProgramCache, digest
from tests.results.test_durability import SMALL

UNSET = "DSSC_JAX_CACHE", "DSSC_JAX_KERNEL"
CLEAN = {name: value for name, value in os.environ.items() if name not in UNSET}
STUDY = """
import json, sys
import dssc_jax as dj
study = dj.Study.from_table(json.loads(sys.argv[1])).without_sweep()
print(dj.run(study).dataset["error_rms"].values.tobytes().hex())
"""
UNTRACED = "import jax; jax.make_jaxpr = jax.eval_shape = jax.jit = None"


def run(home, before=""):
    """A small study in a process of its own, whose cache is in ``home``; exit code, result, what was said."""
    done = subprocess.run(
        [sys.executable, "-c", f"import dssc_jax.runs.run\n{before}\n{STUDY}", json.dumps(SMALL)],
        env={**CLEAN, "XDG_CACHE_HOME": str(home)},
        capture_output=True,
        text=True,
    )
    return done.returncode, done.stdout, done.stderr


@pytest.fixture(scope="module")
def cold(tmp_path_factory):
    """A cache that a run has filled, and the run."""
    home = tmp_path_factory.mktemp("cache")
    done = run(home)
    assert (done[0], done[2]) == (0, "")
    return home, done


def kept(home):
    """The programs of a cache, the largest first."""
    return sorted((home / "dssc_jax").rglob("*.program"), key=lambda file: -file.stat().st_size)


def states(home):
    return {file.name: (file.read_bytes(), file.stat().st_ino) for file in kept(home)}


def test_the_second_process_reads_what_the_first_has_compiled(cold):
    home, done = cold
    before = states(home)
    kinds = sorted(name.partition("-")[0] for name in before)
    # the fields of controller and plant; machine code and how to call it, of the lanes and of the draws' numbers
    assert kinds == ["fields", "lanes", "lanes", "signature", "signature"]
    assert run(home) == done
    assert states(home) == before  # read, not written anew


def test_the_second_process_does_not_even_trace(cold):
    home, done = cold
    assert run(home, UNTRACED) == done


def test_changed_sources_are_traced_anew(cold):
    home, done = cold
    code, _, said = run(home, f"dssc_jax.IMPORTED = 0.0; {UNTRACED}")
    assert code != 0
    assert "'NoneType' object is not callable" in said
    assert run(home, "dssc_jax.IMPORTED = 0.0") == done


@pytest.mark.parametrize("share", [0.0, 0.99])
def test_a_program_that_is_cut_short_is_deleted_with_one_line(cold, share):
    home, done = cold
    before, file = {name: content for name, (content, _) in states(home).items()}, kept(home)[0]
    file.write_bytes(file.read_bytes()[: int(share * file.stat().st_size)])
    code, result, said = run(home)
    assert (code, result) == (0, done[1])
    assert len(said.strip().splitlines()) == 1
    assert said.startswith(f"deleted {file}: ")
    assert run(home) == done
    assert states(home).keys() == before.keys()


def test_a_program_in_the_place_of_another_is_not_run(cold):
    home, done = cold
    file, *others = kept(home)
    content = file.read_bytes()
    file.unlink()
    other = ProgramCache(file.parent)
    other.put("other", content[DIGEST:])
    (file.parent / "other.program").rename(file)
    code, result, said = run(home)
    assert (code, result) == (0, done[1])
    assert said.startswith(f"deleted {file}: ")
    assert kept(home) == [file, *others]
    assert file.read_bytes() == content


def test_a_program_belongs_to_its_name(tmp_path, capsys):
    programs = ProgramCache(tmp_path / "new")
    assert programs.get("a") is None
    programs.put("a", b"program")
    assert programs.get("a") == b"program"
    (tmp_path / "new" / "a.program").rename(tmp_path / "new" / "b.program")
    assert programs.get("b") is None
    assert "b.program: it does not hold what was kept there" in capsys.readouterr().err
    assert not list((tmp_path / "new").iterdir())
    assert digest("ab", b"c") != digest("a", b"bc")


def test_what_has_not_been_read_for_long_goes_first(tmp_path):
    (tmp_path / "jit_old-cache").write_bytes(bytes(100))  # what JAX's own cache has left
    os.utime(tmp_path / "jit_old-cache", (0, 0))
    (tmp_path / "folder").mkdir()
    programs = ProgramCache(tmp_path, limit=3 * DISK_BLOCK)
    for age, name in enumerate("abc", 1):
        programs.put(name, bytes(100))
        os.utime(tmp_path / f"{name}.program", (age, age))
    assert not (tmp_path / "jit_old-cache").exists()
    programs.get("a")
    programs.put("d", bytes(100))
    assert sorted(file.name for file in tmp_path.iterdir()) == ["a.program", "c.program", "d.program", "folder"]


def test_a_store_does_not_visit_every_file(tmp_path, monkeypatch):
    searches, scandir = [], os.scandir
    monkeypatch.setattr(os, "scandir", lambda path: searches.append(path) or scandir(path))
    programs = ProgramCache(tmp_path, limit=100 * DISK_BLOCK)
    most = 0
    for index in range(300):
        programs.put(f"{index}", bytes(100))
        most = max(most, len(os.listdir(tmp_path)))
    assert 100 < most < 150  # 100 are to be kept, and about six more are stored between two searches
    assert SEARCHES <= len(searches) < 100  # about 48


def test_a_disk_that_is_full_leaves_no_half(tmp_path, monkeypatch):
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("No space left on device")))
    with pytest.raises(OSError, match="No space left"):
        ProgramCache(tmp_path).put("a", b"program")
    assert not list(tmp_path.iterdir())


def unusable(home, kind):
    """Make the cache in a home unusable in some way."""
    folder = home / "dssc_jax"
    folder.parent.mkdir(parents=True, exist_ok=True)
    if kind == "a file in its place":
        folder.write_text("precious")
    elif kind == "a link that leads nowhere":
        folder.symlink_to(home / "absent" / "deeper")
    elif kind == "a link to itself":
        folder.symlink_to(folder)
    elif kind == "a file above it":
        home.rmdir()
        home.write_text("precious")


KINDS = ["a file in its place", "a link that leads nowhere", "a link to itself", "a file above it"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_cache_that_cannot_be_used_costs_one_warning(tmp_path, monkeypatch, capsys, kind):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    unusable(tmp_path / "home", kind)
    for name in "abc":
        assert program_cache.cached(name, lambda: b"program") == b"program"
        assert cached_by_subjects(name, lambda: [1, 2], name) == [1, 2]
    said = capsys.readouterr().err
    assert len(said.splitlines()) == 1
    assert said.startswith(f"warning: nothing is kept in {tmp_path / 'home' / 'dssc_jax'} (")


@pytest.mark.parametrize("error", [PermissionError(13, "Permission denied"), OSError(30, "Read-only file system")])
def test_a_cache_that_is_only_read(tmp_path, monkeypatch, capsys, error):
    """What is whole in it is used; what is damaged stays and is passed over."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    program_cache.cached("good", lambda: b"program")
    program_cache.cached("bad", lambda: b"program")
    (tmp_path / "dssc_jax" / "bad.program").write_bytes(b"damaged")

    def refuse(*arguments, **options):
        raise error

    monkeypatch.setattr(os, "utime", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    monkeypatch.setattr(program_cache, "write_file", refuse)
    assert program_cache.cached("good", lambda: b"other") == b"program"
    assert program_cache.cached("bad", lambda: b"program") == b"program"
    assert program_cache.cached("new", lambda: b"program") == b"program"
    said = capsys.readouterr().err.splitlines()
    assert len(said) == 2, said
    assert said[0].startswith(f"could not delete ({error.strerror})")
    assert said[1].startswith("warning: nothing is kept in")


def test_a_pipe_among_the_programs_is_not_waited_for(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (tmp_path / "dssc_jax").mkdir()
    os.mkfifo(tmp_path / "dssc_jax" / "a.program")
    assert program_cache.cached("a", lambda: b"program") == b"program"
    assert len(capsys.readouterr().err.splitlines()) == 1


def test_a_run_goes_on_without_its_cache(tmp_path):
    """In a process of its own: the result is there, and one line."""
    unusable(tmp_path / "home", "a file in its place")
    code, result, said = run(tmp_path / "home")
    assert code == 0
    assert len(result) > 100
    assert len(said.splitlines()) == 1
    assert "nothing is kept in" in said


def test_none_is_kept_on_request(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", STUDY, json.dumps(SMALL)],
        env={**CLEAN, "XDG_CACHE_HOME": str(tmp_path / "unused"), "DSSC_JAX_CACHE": "off"},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert not (tmp_path / "unused").exists()


def test_a_program_that_cannot_be_kept_is_used(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("No space left on device")))
    assert program_cache.cached("a", lambda: b"program") == b"program"
    assert not list(tmp_path.rglob("*.program"))


def test_the_trace_of_a_known_program_has_its_precision(tmp_path, monkeypatch):
    """It is made when somebody reads it, under whatever setting."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    study = dj.Study.from_table(SMALL).without_sweep()
    number = jax.ShapeDtypeStruct((), np.float32)
    with arithmetic(32):
        lane, index = lane_of_study(study), jax.ShapeDtypeStruct((), np.uint32)
        first, second = (compiled_lanes(lane, dict.fromkeys(study.laws, number), index) for _ in range(2))
    assert "traced" in vars(first)
    assert "traced" not in vars(second)
    assert second.traced.text == first.traced.text
