"""A share of what benchmarks/hostile.py tries, and the cases that were mended."""

import subprocess
import sys

import pytest

from benchmarks import hostile
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.study import Study
from dssc_jax.study.tables import DEEPEST, LARGEST_FILE, read_toml
from tests.conftest import UNCERTAIN
from tests.mutations import STUDY_KINDS, document


def test_mutated_study_files():
    tally = hostile.study_files(3 * len(STUDY_KINDS), seed=11)
    assert tally.wrong == []
    assert sum(count for (_, end), count in tally.ends.items() if end == "refused") > 12


def test_damaged_folders():
    tally = hostile.folders(6, seed=12)
    assert tally.wrong == []
    assert sum(count for (_, end), count in tally.ends.items() if end == "refused") > 10


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"#" * (LARGEST_FILE + 1), "is larger than a study can be"),
        (b"a" + b".a" * 200_000 + b" = 1", f"has a dotted name of more than {DEEPEST} parts"),
        (b"[" + b"a . " * 200_000 + b"a]", f"has a dotted name of more than {DEEPEST} parts"),
        (b"a = " + b"[" * 500_000, "is nested too deeply"),
        (b"a = " + b"[" * 60 + b"]" * 60, "is nested too deeply"),
        ("name = 'é'".encode("latin-1"), "is not UTF-8 text: invalid continuation byte at byte 8"),
        (b"\xef\xbb\xbfname = 'x'", "is not valid TOML"),
    ],
)
def test_files_that_are_no_studies(tmp_path, content, message):
    path = tmp_path / "a.toml"
    path.write_bytes(content)
    with pytest.raises(ConfigError, match=message):
        Study.load(path)


def test_dots_in_values_are_no_names(tmp_path):
    path = tmp_path / "a.toml"
    numbers = ", ".join(f"{i}.{i}" for i in range(1000))
    path.write_text(f'description = "wait {"." * 100} and {"a. " * 100}"\r\nvalues = [{numbers}]\n')
    assert len(read_toml(path)["values"]) == 1000


def test_an_endless_file_is_not_read_to_its_end(capsys):
    assert guarded(["run", "/dev/zero"]) == 2
    assert "is a device, not a file" in capsys.readouterr().err


def test_a_long_complaint_is_cut(tmp_path, capsys):
    path = tmp_path / "a.toml"
    path.write_text(f'name = "{"n" * 100_000}"')
    assert guarded(["run", str(path)]) == 2
    assert len(capsys.readouterr().err) < 1100


MODULE = "from pathlib import Path\nPath('imported').touch()\nfrom dssc_jax.models.plants import PLANTS\n"
MODULE += "PLANT = PLANTS['normal_form'].members[None]\n"


@pytest.fixture
def own(tmp_path, monkeypatch):
    """A study beside a module that leaves a trace where it is imported."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [entry for entry in sys.path if entry])
    monkeypatch.delitem(sys.modules, "beside", raising=False)
    (tmp_path / "beside.py").write_text(MODULE)
    table = {**UNCERTAIN, "plant": {"kind": "beside:PLANT"}, "sweep": {}, "draws": 2}
    (tmp_path / "own.toml").write_bytes(document(table))
    return tmp_path


def test_a_study_imports_from_its_folder_only_when_allowed(own, capsys):
    assert guarded(["run", "own.toml"]) == 2
    assert "cannot import 'beside:PLANT'" in capsys.readouterr().err
    assert not (own / "imported").exists()
    assert guarded(["run", "own.toml", "--allow-local", "--json"]) == 0
    assert (own / "imported").exists()


def test_the_current_folder_is_no_installed_module(own):
    """``python -m`` puts it first on the path."""
    done = subprocess.run([sys.executable, "-m", "dssc_jax.cli", "run", "own.toml"], capture_output=True, text=True)
    assert done.returncode == 2
    assert "cannot import 'beside:PLANT'" in done.stderr
    assert not (own / "imported").exists()


def test_values_are_never_code(tmp_path):
    """Text that looks like code stays text."""
    for value in ("__import__('os').system('touch exploded')", "${HOME}", "{{ 1 + 1 }}", "!!python/object:os.system"):
        with pytest.raises(ConfigError):
            Study.from_table({**UNCERTAIN, "plant": {**UNCERTAIN["plant"], "k_p": value}})
        with pytest.raises(ConfigError, match=r"unknown kind|cannot import"):
            Study.from_table({**UNCERTAIN, "plant": {"kind": value}})
