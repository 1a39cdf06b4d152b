"""A cache of compiled programs in the user's cache directory, which all processes share.

A truncated program, or a different one under the same name, would end the process that runs it. Every file therefore
begins with the digest of its name and content. A file that does not match is deleted with a one-line message, and the
program is compiled again. Files are moved into place atomically, so processes need not wait for each other. Where the
cache cannot be written, the process says so once and goes on without it.

The environment variable ``DSSC_JAX_CACHE=off`` disables the cache.
"""

import errno
import hashlib
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from uuid import uuid4

CACHE_VARIABLE = "DSSC_JAX_CACHE"
OFF = ("off", "0", "false")
"""Values of the variable that disable the cache."""
CACHE_SIZE = 2**28  # bytes
SEARCHES = 16  # mean number of searches for old files while CACHE_SIZE bytes are stored; each visits every file
DISK_BLOCK = 4096  # bytes of the disk that a file occupies at least
UNUSABLE: set[Path] = set()
"""Caches that this process has warned of."""
DIGEST = hashlib.sha256().digest_size
"""Bytes of the digest with which a file begins."""


class ProgramCache:
    """A folder of programs by name.

    Args:
        folder: The folder; created when a program is stored.
        limit: Maximum size in bytes, exceeded by about a sixteenth between two searches for old files.
    """

    def __init__(self, folder: Path, limit: int = CACHE_SIZE) -> None:
        """Use a folder, which need not exist."""
        self._path = folder
        self.limit = limit

    def get(self, key: str) -> bytes | None:
        """Return the program stored under a name; None if the cache has no such program.

        A file that does not match its digest is deleted, with a message, and the result is None.
        """
        file = self._file(key)
        try:
            content = read_file(file)
        except OSError:
            return None
        stored_digest = content[:DIGEST]
        program = content[DIGEST:]
        if stored_digest == digest(key, program):
            with suppress(OSError):
                os.utime(file)  # marks it as used
            return program
        delete_damaged(file)
        return None

    def put(self, key: str, value: bytes) -> None:
        """Store a program under its name, and at random times delete old programs.

        Deletion searches the whole folder, on average SEARCHES times while ``limit`` bytes are written.

        Args:
            key: The name.
            value: The program.

        Raises:
            OSError: The program cannot be written.
        """
        self._path.mkdir(parents=True, exist_ok=True)
        content = digest(key, value) + value
        write_file(self._file(key), content)
        size = max(len(content), DISK_BLOCK)
        uniform = int.from_bytes(content[:8]) / 2**64  # the digest is as good as a random number
        if uniform * self.limit < SEARCHES * size:  # with probability SEARCHES size/limit; the limit may be 0
            self._make_room()

    def _file(self, key: str) -> Path:
        """Return the path of the file that holds the program of a name."""
        return self._path / f"{key}.program"

    def _make_room(self) -> None:
        """Delete the files that have not been read for the longest time, until the others fit within the limit."""
        stored_files = []  # (time of the last use, bytes on the disk, path) of each file
        with os.scandir(self._path) as entries:
            for entry in entries:
                if entry.is_file(follow_symlinks=False):
                    status = entry.stat()
                    stored_files.append((status.st_mtime_ns, max(status.st_size, DISK_BLOCK), entry.path))
        excess_bytes = sum(size for _, size, _ in stored_files) - self.limit
        for _, size, path in sorted(stored_files):
            if excess_bytes <= 0:
                return
            Path(path).unlink(missing_ok=True)
            excess_bytes -= size


def delete_damaged(file: Path) -> None:
    """Delete a file of the cache that does not match its digest, and print what was done."""
    try:
        file.unlink()
        outcome = "deleted"
    except OSError as error:
        outcome = f"could not delete ({error.strerror})"
    print(f"{outcome} {file}: it does not hold what was kept there; the program is compiled again", file=sys.stderr)


def read_file(path: Path) -> bytes:
    """Return the content of a regular file.

    Raises:
        OSError: The file cannot be read, or is not regular; a named pipe, for example, could block the process.
    """
    if not path.is_file():
        raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(path))
    return path.read_bytes()


def write_file(path: Path, content: bytes) -> None:
    """Write a file completely, or not at all, by a temporary file that is moved into the file's place.

    Raises:
        OSError: The file cannot be written, or the path leads to something other than a regular file.
    """
    if path.exists() and not path.is_file():
        raise FileExistsError(errno.EEXIST, "is no regular file", str(path))
    partial = path.with_name(f"{path.name}.{uuid4().hex}.partial")
    try:
        with partial.open("xb") as file:
            file.write(content)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def digest(key: str, program: bytes) -> bytes:
    """Return the digest of a name and its program, with which the program's file begins."""
    return hashlib.sha256(key.encode() + b"\n" + program).digest()


def cached(name: str, make: Callable[[], bytes]) -> bytes:
    """Return the program of a name from the user's cache; if the cache has none, make the program and store it.

    Args:
        name: Name of the program. It must differ whenever anything differs on which the program depends.
        make: Makes the program.
    """
    folder = cache_directory()
    if folder is None:
        return make()
    cache = ProgramCache(folder)
    stored_content = cache.get(name)
    if stored_content is not None:
        return stored_content
    content = make()
    try:
        cache.put(name, content)
    except OSError as error:  # it is made again next time
        warn_of_cache(folder, error.strerror or str(error))
    return content


def warn_of_cache(folder: Path, reason: str) -> None:
    """Print a warning, once in this process, that nothing can be stored in a cache.

    Args:
        folder: Folder of the cache.
        reason: Why nothing can be stored, in the system's words.
    """
    if folder in UNUSABLE:
        return
    UNUSABLE.add(folder)
    line = f"warning: nothing is kept in {folder} ({reason}), so each command compiles again"
    print(f"{line}; {CACHE_VARIABLE}=off silences this", file=sys.stderr)


def cache_directory() -> Path | None:
    """Return the cache's folder; None if the user has disabled the cache, or has no home directory."""
    if os.environ.get(CACHE_VARIABLE, "").lower() in OFF:
        return None
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dssc_jax"
    except RuntimeError:  # no home
        return None
