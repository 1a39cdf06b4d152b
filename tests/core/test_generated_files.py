"""Files that were generated may be generated again; anybody's work is kept."""

import hashlib

import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.generated_files import SUMS, require_replaceable, write_sums

NAMES = ["a.c", "b.bin"]


@pytest.fixture
def folder(tmp_path):
    for name in NAMES:
        (tmp_path / name).write_text(name)
    write_sums(tmp_path, NAMES)
    return tmp_path


def test_what_was_generated_may_be_replaced(folder):
    require_replaceable(folder, NAMES)
    require_replaceable(folder, [*NAMES, "new.h"])
    require_replaceable(folder / "absent", NAMES)
    assert (folder / SUMS).read_text().splitlines()[0] == f"{hashlib.sha256(b'a.c').hexdigest()}  a.c"


def test_what_was_changed_is_kept(folder):
    (folder / "b.bin").write_text("better")
    with pytest.raises(ConfigError, match=r"b\.bin: was changed after it was generated"):
        require_replaceable(folder, NAMES)


def test_what_was_there_before_is_kept(folder):
    (folder / "new.h").write_text("mine")
    with pytest.raises(ConfigError, match=r"new\.h: is in the place of a generated file"):
        require_replaceable(folder, [*NAMES, "new.h"])
    (folder / SUMS).write_text("no sums at all\n\n")
    with pytest.raises(ConfigError, match=r"a\.c: is in the place of a generated file"):
        require_replaceable(folder, NAMES)
