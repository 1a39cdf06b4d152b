"""The writer of all files: whole or not at all, into its place only, and what it neither reads nor replaces."""

import os
import stat
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import pytest

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from tests.attacks import largest_file

TWO_WRITERS = """
import sys
from pathlib import Path
from dssc_jax.core import files
for _ in range(200):
    files.write_bytes(Path(sys.argv[1]), sys.argv[2].encode() * int(sys.argv[3]), durable=False)
"""


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_file_is_written_whole(tmp_path):
    files.write_text(tmp_path / "a", ["one\n", "two µ\n"])
    assert (tmp_path / "a").read_bytes() == "one\ntwo µ\n".encode()
    files.write_bytes(tmp_path / "a", b"three")
    assert files.read_bytes(tmp_path / "a") == b"three"
    assert files.read_bytes(tmp_path / "a", 2) == b"th"
    assert names(tmp_path) == ["a"]


def test_an_exception_leaves_the_file_as_it_was(tmp_path):
    (tmp_path / "a").write_text("before")

    def parts():
        yield b"after"
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        files.write_parts(tmp_path / "a", parts())
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "before"


@pytest.mark.parametrize("limit", [0, 1, 9999])
def test_a_full_disk_leaves_the_file_as_it_was(tmp_path, limit):
    (tmp_path / "a").write_text("before")
    with largest_file(limit), pytest.raises(OSError, match="File too large"):
        files.write_bytes(tmp_path / "a", bytes(10_000))
    assert names(tmp_path) == ["a"]
    assert (tmp_path / "a").read_text() == "before"


def test_permissions_are_kept(tmp_path):
    (tmp_path / "a").touch()
    (tmp_path / "a").chmod(0o640)
    files.write_text(tmp_path / "a", "after")
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640
    mask = os.umask(0o027)
    try:
        files.write_text(tmp_path / "b", "new")
    finally:
        os.umask(mask)
    assert stat.S_IMODE((tmp_path / "b").stat().st_mode) == 0o640


def test_another_name_of_a_file_keeps_its_content(tmp_path):
    (tmp_path / "mine").write_text("precious")
    os.link(tmp_path / "mine", tmp_path / "a")
    files.write_text(tmp_path / "a", "after")
    assert (tmp_path / "mine").read_text() == "precious"


@pytest.mark.parametrize("target", ["victim", "absent"])
def test_a_link_is_not_written_through(tmp_path, target):
    (tmp_path / "victim").write_text("precious")
    (tmp_path / "a").symlink_to(tmp_path / target)
    with pytest.raises(files.UnsafeFileError, match="a' is a symbolic link, which is not overwritten"):
        files.write_text(tmp_path / "a", "after")
    assert (tmp_path / "victim").read_text() == "precious"
    assert names(tmp_path) == ["a", "victim"]


def test_a_folder_that_is_a_link_is_not_written_into(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "root").mkdir()
    (tmp_path / "root" / "sub").symlink_to(tmp_path / "elsewhere")
    root = tmp_path / "root"
    for act in (
        lambda: files.write_text(root / "sub" / "a", "after", root),
        lambda: files.make_folder(root / "sub" / "deeper", root),
        lambda: files.make_folder(root / "sub", root),
        lambda: files.delete(root / "sub" / "a", root),
        lambda: files.delete_tree(root / "sub", root),
    ):
        with pytest.raises(files.UnsafeFileError, match="sub' is a symbolic link, not a folder"):
            act()
    assert names(tmp_path / "elsewhere") == []
    files.write_text(root / "sub" / "a", "after")  # a path that the user has named
    assert names(tmp_path / "elsewhere") == ["a"]


def test_a_tree_is_deleted_without_what_it_links_to(tmp_path):
    (tmp_path / "victim").mkdir()
    (tmp_path / "victim" / "file").touch()
    (tmp_path / "tree" / "inner").mkdir(parents=True)
    (tmp_path / "tree" / "inner" / "link").symlink_to(tmp_path / "victim")
    with pytest.raises(ConfigError, match=r"link: is a symbolic link; .*nothing was written"):
        files.require_plain_tree(tmp_path / "tree")
    files.delete_tree(tmp_path / "tree", tmp_path)
    assert names(tmp_path) == ["victim"]
    assert names(tmp_path / "victim") == ["file"]


def test_what_is_no_file_is_neither_read_nor_replaced(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "link").symlink_to("/dev/zero")
    for path, words in ((tmp_path / "pipe", "a named pipe"), (tmp_path / "link", "a device")):
        with pytest.raises(files.UnsafeFileError, match=f"is {words}, not a file"):
            files.read_bytes(path)
    with pytest.raises(IsADirectoryError):
        files.read_bytes(tmp_path)
    with pytest.raises(files.UnsafeFileError, match="is a named pipe, which is not overwritten"):
        files.write_text(tmp_path / "pipe", "after")
    with pytest.raises(files.UnsafeFileError, match="is a folder, which is not overwritten"):
        files.write_text(tmp_path, "after")
    assert stat.S_ISFIFO((tmp_path / "pipe").stat().st_mode)


def test_a_new_file_takes_no_others_place(tmp_path):
    files.create_text(tmp_path / "a", "one")
    with pytest.raises(FileExistsError):
        files.create_text(tmp_path / "a", "two")
    assert (tmp_path / "a").read_text() == "one"
    (tmp_path / "b").symlink_to(tmp_path / "c")
    with pytest.raises(FileExistsError):
        files.create_text(tmp_path / "b", "two")
    with largest_file(1), pytest.raises(OSError, match="File too large"):
        files.create_text(tmp_path / "d", "two")
    assert names(tmp_path) == ["a", "b"]


def test_two_processes_write_one_file(tmp_path):
    """The last one wins; no file is a mixture, and nothing else remains."""
    path, sizes = tmp_path / "a", {"a": 300_000, "b": 200_000}

    def process(letter):
        arguments = [sys.executable, "-c", TWO_WRITERS, str(path), letter, str(sizes[letter])]
        return subprocess.run(arguments, check=True)

    seen = set()
    with ThreadPoolExecutor(2) as pool:
        writers = [pool.submit(process, letter) for letter in sizes]
        while not all(writer.done() for writer in writers):
            if path.exists():
                seen.add(path.read_bytes())
    seen.add(path.read_bytes())
    assert seen <= {letter.encode() * size for letter, size in sizes.items()}
    assert names(tmp_path) == ["a"]
    assert [writer.result().returncode for writer in writers] == [0, 0]


def test_a_held_folder_is_known_again(tmp_path):
    folder = tmp_path / "a"
    folder.mkdir()
    held = files.HeldFolder(folder)
    held.require_in_place()
    folder.rename(tmp_path / "b")
    with pytest.raises(ConfigError, match="a: was moved"):
        held.require_in_place()
    folder.mkdir()
    with pytest.raises(ConfigError, match="a: was moved"):
        held.require_in_place()
    folder.rmdir()
    (tmp_path / "b").rename(folder)
    held.require_in_place()
    folder.rmdir()
    for _ in range(20):  # a system may give a new folder the number of a deleted one
        folder.mkdir()
        with pytest.raises(ConfigError, match=r"a: was (deleted|moved or deleted)"):
            held.require_in_place()
        folder.rmdir()
    held.close()
