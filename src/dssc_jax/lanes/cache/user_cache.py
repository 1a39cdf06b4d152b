"""A cache of compiled programs, and of what else a trace tells, in the user's cache directory; all processes share it.

A truncated program, or a different one under the same name, would end the process that runs it. Every file therefore
begins with the digest of its name and content. A file that does not match is deleted with a one-line message, and the
program is compiled again. Files are moved into place atomically, so processes need not wait for each other. Where the
cache cannot be written, the process says so once and goes on without it.

The environment variable ``DSSC_JAX_CACHE=off`` disables the cache.
"""

import hashlib
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar

from dssc_jax.core import files
from dssc_jax.lanes.cache.facts import decoded, encoded
from dssc_jax.lanes.cache.names import name_of

T = TypeVar("T")

CACHE_VARIABLE = "DSSC_JAX_CACHE"
OFF = ("off", "0", "false")
CACHE_SIZE = 2**28  # bytes; what has not been read for the longest time goes first
SEARCHES = 16  # of the whole folder, while as much is stored as it may hold: one visits every file
DISK_BLOCK = 4096  # bytes of a disk that a file takes at least
UNUSABLE: set[Path] = set()
"""Caches that this process has warned of."""
DIGEST = hashlib.sha256().digest_size


class ProgramCache:
    """A folder of programs by name.

    Args:
        folder: The folder; created when a program is stored.
        most: Maximum size in bytes; about a sixteenth more between two searches for what may go.
    """

    def __init__(self, folder: Path, most: int = CACHE_SIZE) -> None:
        self._path, self.most = folder, most

    def get(self, key: str) -> bytes | None:
        """The program of a name; None if there is none, or if the file does not match."""
        file = self._file(key)
        try:
            content = files.read_bytes(file)
        except OSError:
            return None
        program = content[DIGEST:]
        if content[:DIGEST] == digest(key, program):
            with suppress(OSError):
                os.utime(file)  # it is in use
            return program
        try:
            files.delete(file)
            done = "deleted"
        except OSError as error:
            done = f"could not delete ({error.strerror})"
        print(f"{done} {file}: it does not hold what was kept there; the program is compiled again", file=sys.stderr)
        return None

    def put(self, key: str, value: bytes) -> None:
        """Store a program under its name.

        Raises:
            OSError: It cannot be written.
        """
        files.make_folder(self._path)
        content = digest(key, value) + value
        files.write_bytes(self._file(key), content, durable=False)
        chance = int.from_bytes(content[:8]) / 2**64  # the digest is as good as a random number
        if chance * self.most < SEARCHES * max(len(content), DISK_BLOCK):
            self._make_room()

    def _file(self, key: str) -> Path:
        return self._path / f"{key}.program"

    def _make_room(self) -> None:
        """Delete the files that have not been read for the longest time."""
        with os.scandir(self._path) as entries:
            present = [(entry.stat(), entry.path) for entry in entries if entry.is_file(follow_symlinks=False)]
        known = [(about.st_mtime_ns, max(about.st_size, DISK_BLOCK), path) for about, path in present]
        excess = sum(size for _, size, _ in known) - self.most
        for _, size, path in sorted(known):
            if excess <= 0:
                return
            files.delete(Path(path))
            excess -= size


def digest(key: str, program: bytes) -> bytes:
    """The digest that binds a program to its name."""
    return hashlib.sha256(key.encode() + b"\n" + program).digest()


def kept(name: str, make: Callable[[], bytes]) -> bytes:
    """What has a name in the user's cache, or is now made and kept there.

    Args:
        name: Identifies everything that it depends on.
        make: Makes it.
    """
    folder = cache_directory()
    if folder is None:
        return make()
    cache = ProgramCache(folder)
    known = cache.get(name)
    if known is not None:
        return known
    made = make()
    try:
        cache.put(name, made)
    except OSError as error:  # it is made again next time
        warn_of_cache(folder, error.strerror or str(error))
    return made


def warn_of_cache(folder: Path, reason: str) -> None:
    """Say once in this process that nothing can be kept."""
    if folder in UNUSABLE:
        return
    UNUSABLE.add(folder)
    line = f"warning: nothing is kept in {folder} ({reason}), so each command compiles again"
    print(f"{line}; {CACHE_VARIABLE}=off silences this", file=sys.stderr)


def remembered(what: str, compute: Callable[[], T], *things: Any) -> T:
    """What follows from things alone: from the user's cache, or computed and kept there.

    Args:
        what: What of the things it is.
        compute: Computes it, as a tree that :func:`dssc_jax.lanes.cache.facts.encoded` knows.
        things: All that it follows from, beside this package's code; see :func:`dssc_jax.lanes.cache.names.name_of`.
    """
    name = None if cache_directory() is None else name_of(what, *things)
    return compute() if name is None else decoded(kept(f"{what}-{name}", lambda: encoded(compute())))


def cache_directory() -> Path | None:
    """The cache's folder; None if the user has disabled the cache, or has no home directory."""
    if os.environ.get(CACHE_VARIABLE, "").lower() in OFF:
        return None
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "dssc_jax"
    except RuntimeError:  # no home
        return None
