"""The one module that writes files, and that opens files which may be somebody else's.

A file is written beside its place under a name that nobody else uses, flushed to disk, and moved into its place. A
reader therefore sees the old file or the new one, never a part, and two writers do not mix. Nothing is written through
a symbolic link: a folder that was received from someone could otherwise lead to any file of its reader. What is not a
regular file (a named pipe, a device) is neither read nor replaced, since it may block for ever.
"""

import errno
import os
import shutil
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO
from uuid import uuid4

from dssc_jax.core.errors import ConfigError

PARTIAL = ".partial"
"""Suffix of a file that is being written."""

LARGE_BUFFER = 2**20
"""Bytes that a file is read ahead."""

REPEATED_NAME = 100
"""Characters of a file's name that the name of its partial file repeats; systems allow 255 bytes."""

# flags of os.open; some systems lack a few of them, and 0 stands for these
CREATION = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
READING = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
DIRECTORY = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0)
POSIX = os.name == "posix"

FILE_TYPES = {
    stat.S_IFLNK: "a symbolic link",
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a named pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


class UnsafeFileError(OSError):
    """A path that is no regular file, or that leads through a symbolic link."""


def file_type(mode: int) -> str:
    """Return the type of a file that is not regular in words, given its ``st_mode``."""
    return FILE_TYPES.get(stat.S_IFMT(mode), "no regular file")


def mode_of(path: Path) -> int | None:
    """Return ``st_mode`` of what is at a path, of a symbolic link the link's own; None if nothing is there."""
    try:
        return path.lstat().st_mode
    except (FileNotFoundError, NotADirectoryError):
        return None


@contextmanager
def open_regular_file(path: str | Path) -> Iterator[BinaryIO]:
    """Open a regular file for reading; a symbolic link is followed.

    Args:
        path: The file.

    Raises:
        UnsafeFileError: The path leads to a named pipe, a device or a socket.
        OSError: The file cannot be read.
    """
    require_readable(Path(path), os.stat(path).st_mode)
    descriptor = os.open(path, READING)
    with os.fdopen(descriptor, "rb", LARGE_BUFFER) as file:
        require_readable(Path(path), os.fstat(descriptor).st_mode)  # the file may have been replaced since
        yield file


def read_bytes(path: str | Path, size: int = -1) -> bytes:
    """Return the content of a regular file; raise the errors of :func:`open_regular_file`.

    Args:
        path: The file.
        size: Largest number of bytes to read; -1: all.
    """
    with open_regular_file(path) as file:
        return file.read(size)


def require_readable(path: Path, mode: int) -> None:
    """Require that a path leads to a regular file.

    Args:
        path: The path, for messages.
        mode: ``st_mode`` of the file at the end of its symbolic links.

    Raises:
        IsADirectoryError: The path leads to a folder.
        UnsafeFileError: The path leads to a pipe, a device or a socket.
    """
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        raise unsafe_error(path, f"is {file_type(mode)}, not a file")


def read_text(path: str | Path, errors: str = "strict") -> str:
    """Return the content of a regular UTF-8 file, with line ends as ``\\n``.

    Args:
        path: The file.
        errors: How bytes that are not UTF-8 are handled, as for :meth:`bytes.decode`.

    Raises:
        UnicodeDecodeError: The file is not UTF-8, and ``errors`` is ``strict``.
        OSError: The file cannot be read, or is not regular.
    """
    text = read_bytes(path).decode("utf-8", errors)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def write_text(path: Path, text: str | Iterable[str], within: Path | None = None, durable: bool = True) -> None:
    """Write a UTF-8 file completely, or not at all; raise the errors of :func:`replacing`.

    Args:
        path: The file.
        text: The content of the file, or the parts of the content in order.
        within: See :func:`replacing`.
        durable: See :func:`replacing`.
    """
    parts = [text] if isinstance(text, str) else text
    with replacing(path, within, durable) as file:
        for part in parts:
            file.write(part.encode())


def write_bytes(path: Path, content: bytes | memoryview, within: Path | None = None, durable: bool = True) -> None:
    """Write a file with ``content`` completely, or not at all; for other arguments and errors see :func:`replacing`."""
    with replacing(path, within, durable) as file:
        file.write(content)


def write_parts(path: Path, parts: Iterable[bytes]) -> None:
    """Write a file, given the parts of its content, completely or not at all; raise the errors of :func:`replacing`."""
    with replacing(path) as file:
        for part in parts:
            file.write(part)


def create_text(path: Path, text: str) -> None:
    """Write a new UTF-8 file completely, or not at all.

    Raises:
        FileExistsError: The path exists.
        OSError: The file cannot be written.
    """
    create_file(path).close()  # reserves the name
    try:
        write_text(path, text)
    except BaseException:
        path.unlink(missing_ok=True)
        raise


@contextmanager
def replacing(path: Path, within: Path | None = None, durable: bool = True) -> Iterator[BinaryIO]:
    """Open a temporary binary file that replaces ``path`` if the block ends without an exception.

    The new file gets the permissions of the file that it replaces.

    Args:
        path: The file.
        within: The folder below which no part of the path may be a symbolic link; None: only the file must be none.
        durable: Flush file and folder to disk, so that not even a power cut leaves a part of a file.

    Raises:
        UnsafeFileError: The path, or a folder of it below ``within``, is a symbolic link or of another wrong kind.
        OSError: The file cannot be written.
    """
    require_inside(path, within)
    replaced_mode = require_replaceable(path)
    partial = partial_path(path)
    try:
        with create_file(partial) as file:
            yield file
            if replaced_mode is not None and POSIX:
                os.fchmod(file.fileno(), stat.S_IMODE(replaced_mode))
            if durable:
                flush(file)
        require_inside(path, within)
        require_replaceable(path)
        os.replace(partial, path)
    except BaseException:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise
    if durable:
        flush_folder(path.parent)


def create_file(path: Path) -> BinaryIO:
    """Create a file and open it for writing; raise FileExistsError if the path exists, even as a broken link."""
    for_all_users = 0o666  # less what the user's umask forbids
    return os.fdopen(os.open(path, CREATION, for_all_users), "wb")


def partial_path(path: Path) -> Path:
    """Return the path of a temporary file beside a file, with a random name that no other writer uses."""
    return path.with_name(f".{path.name[:REPEATED_NAME]}.{uuid4().hex}{PARTIAL}")


def flush(file: BinaryIO) -> None:
    """Flush a file to disk."""
    file.flush()
    os.fsync(file.fileno())


def flush_folder(folder: Path) -> None:
    """Flush a folder's list of files to disk, so that a power cut loses no name; do nothing if the system cannot."""
    if not POSIX:
        return
    descriptor = os.open(folder, DIRECTORY)
    try:
        with suppress(OSError):  # some network file systems cannot flush a folder
            os.fsync(descriptor)
    finally:
        os.close(descriptor)


def require_replaceable(path: Path) -> int | None:
    """Require that nothing but a regular file would be replaced at a path.

    Returns:
        ``st_mode`` of the file; None if the path is absent.

    Raises:
        UnsafeFileError: The path is a symbolic link, a folder, a pipe or a device.
    """
    mode = mode_of(path)
    if mode is not None and not stat.S_ISREG(mode):
        raise unsafe_error(path, f"is {file_type(mode)}, which is not overwritten")
    return mode


def require_inside(path: Path, within: Path | None) -> None:
    """Require that no folder on the way from ``within`` to a path is a symbolic link or a file.

    Args:
        path: The path; folders that do not exist yet are accepted.
        within: The folder from which on folders are checked; None: none are.

    Raises:
        UnsafeFileError: A folder is a symbolic link or a file.
    """
    if within is None:
        return
    folder = within
    *folder_names, _ = path.relative_to(within).parts
    for part in folder_names:
        folder = folder / part
        mode = mode_of(folder)
        if mode is not None and not stat.S_ISDIR(mode):
            raise unsafe_error(folder, f"is {file_type(mode)}, not a folder")


def require_plain_tree(folder: Path) -> None:
    """Require, before anything is written, that a folder contains only regular files and folders; raise ConfigError."""
    for place, folders, names in os.walk(folder):
        for name in (*folders, *names):
            path = Path(place) / name
            mode = mode_of(path)
            if mode is not None and not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
                rule = f"is {file_type(mode)}; only plain files and folders are written to, nothing was written"
                raise ConfigError(str(path), rule)


def make_folder(folder: Path, within: Path | None = None) -> None:
    """Create a folder and those above it, if they are absent.

    Args:
        folder: The folder.
        within: An existing folder below which no part of the path may be a symbolic link; None: links are followed.

    Raises:
        UnsafeFileError: A part of the path is a symbolic link or a file.
        OSError: The folder cannot be created.
    """
    if within is None:
        folder.mkdir(parents=True, exist_ok=True)
        return
    require_inside(folder / PARTIAL, within)  # the name of a file in the folder, so that the folder itself is checked
    parent = within
    for part in folder.relative_to(within).parts:
        parent = parent / part
        parent.mkdir(exist_ok=True)


def delete(path: Path, within: Path | None = None) -> None:
    """Delete a file if it exists; a symbolic link is itself deleted.

    Args:
        path: The file.
        within: The folder below which no folder of the path may be a symbolic link; None: links are followed.

    Raises:
        UnsafeFileError: A folder of the path below ``within`` is a symbolic link or a file.
    """
    require_inside(path, within)
    path.unlink(missing_ok=True)


def delete_tree(folder: Path, within: Path | None) -> None:
    """Delete a folder with its content if it exists; symbolic links in it are deleted, not followed.

    Args:
        folder: The folder.
        within: The folder below which no part of the path may be a symbolic link; None: links are followed.

    Raises:
        UnsafeFileError: The folder, or a folder of its path below ``within``, is a symbolic link or a file.
        OSError: The folder cannot be deleted.
    """
    require_inside(folder / PARTIAL, within)
    if mode_of(folder) is not None:
        shutil.rmtree(folder)


def delete_partials(folder: Path) -> None:
    """Delete the temporary files that killed writers have left in a folder and below it."""
    for place, _, names in os.walk(folder):
        for name in names:
            if name.endswith(PARTIAL):
                (Path(place) / name).unlink(missing_ok=True)


def unsafe_error(path: Path, rule: str) -> UnsafeFileError:
    """Return the error for a path that is not followed or overwritten; ``rule`` completes "'PATH' ..."."""
    return UnsafeFileError(errno.ELOOP, f"'{path}' {rule}", str(path))


class HeldFolder:
    """A folder identified by its device and inode, to find out whether its path still leads to the same folder.

    Args:
        path: An existing folder. It is kept open until :meth:`close`, so that no new folder gets the same inode.

    Raises:
        OSError: The folder cannot be opened.
    """

    def __init__(self, path: Path) -> None:
        """Open the folder, and note its device and inode."""
        self.path = path.absolute()
        self._shown = path  # as the user wrote it, for messages
        self._descriptor = os.open(path, DIRECTORY) if POSIX else None
        self._identity = device_and_inode(path)

    def require_in_place(self) -> None:
        """Require that the path still leads to this folder, not to another or to none; raise ConfigError otherwise."""
        try:
            present = device_and_inode(self.path)
        except OSError:
            present = None  # nothing is there
        if present != self._identity:
            raise ConfigError(str(self._shown), self._fate())

    def _fate(self) -> str:
        """Return what became of the folder, in words: deleted, or moved to a place that only Linux can tell."""
        location = ""
        if self._descriptor is not None:
            with suppress(OSError):
                location = os.readlink(f"/proc/self/fd/{self._descriptor}")
        if location.endswith(" (deleted)"):
            return "was deleted while it was written; what it held is lost, run again"
        if location:
            return (
                f"was moved to '{location}' while it was written; it is not complete: "
                "finished blocks are there, continue with `out` and `resume`"
            )
        return "was moved or deleted while it was written; it is not complete: run again"

    def close(self) -> None:
        """Close the folder's descriptor."""
        if self._descriptor is not None:
            os.close(self._descriptor)
            self._descriptor = None


def device_and_inode(path: Path) -> tuple[int, int]:
    """Return device and inode of a file or folder, which no other file or folder has at the same time."""
    status = path.stat()
    return status.st_dev, status.st_ino
