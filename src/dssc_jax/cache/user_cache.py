"""A cache of compiled programs, and of what else a trace tells, in the user's cache directory; all processes share it.

A truncated program, or a different one under the same name, would end the process that runs it. Every file therefore
begins with the digest of its name and content. A file that does not match is deleted with a one-line message, and the
program is compiled again. Files are moved into place atomically, so processes need not wait for each other.

The environment variable ``DSSC_JAX_CACHE=off`` disables the cache.
"""

import hashlib
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, TypeVar
from uuid import uuid4

from dssc_jax.cache.facts import decoded, encoded
from dssc_jax.cache.names import name_of

T = TypeVar("T")

CACHE_VARIABLE = "DSSC_JAX_CACHE"
OFF = ("off", "0", "false")
CACHE_SIZE = 2**28  # bytes; what has not been read for the longest time goes first
SEARCHES = 16  # of the whole folder, while as much is stored as it may hold: one visits every file
DISK_BLOCK = 4096  # bytes of a disk that a file takes at least
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
            content = file.read_bytes()
            os.utime(file)  # it is in use
        except OSError:
            return None
        program = content[DIGEST:]
        if content[:DIGEST] == digest(key, program):
            return program
        file.unlink(missing_ok=True)
        print(f"deleted {file}: it does not hold what was kept there; the program is compiled again", file=sys.stderr)
        return None

    def put(self, key: str, value: bytes) -> None:
        """Store a program under its name."""
        self._path.mkdir(parents=True, exist_ok=True)
        partial = self._path / f"{uuid4().hex}.partial"
        content = digest(key, value) + value
        try:
            partial.write_bytes(content)
            os.replace(partial, self._file(key))
        except OSError:
            partial.unlink(missing_ok=True)
            raise
        chance = int.from_bytes(content[:8]) / 2**64  # the digest is as good as a random number
        if chance * self.most < SEARCHES * max(len(content), DISK_BLOCK):
            self._make_room()

    def _file(self, key: str) -> Path:
        return self._path / f"{key}.program"

    def _make_room(self) -> None:
        """Delete the files that have not been read for the longest time."""
        with os.scandir(self._path) as entries:
            files = [(entry.stat(), entry.path) for entry in entries if entry.is_file()]
        known = [(about.st_mtime_ns, max(about.st_size, DISK_BLOCK), path) for about, path in files]
        excess = sum(size for _, size, _ in known) - self.most
        for _, size, path in sorted(known):
            if excess <= 0:
                return
            Path(path).unlink(missing_ok=True)
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
    with suppress(OSError):  # a full disk: it is made again next time
        cache.put(name, made)
    return made


def remembered(what: str, compute: Callable[[], T], *things: Any) -> T:
    """What follows from things alone: from the user's cache, or computed and kept there.

    Args:
        what: What of the things it is.
        compute: Computes it, as a tree that :func:`dssc_jax.cache.facts.encoded` knows.
        things: All that it follows from, beside this package's code; see :func:`dssc_jax.cache.names.name_of`.
    """
    name = None if cache_directory() is None else name_of(what, *things)
    return compute() if name is None else decoded(kept(f"{what}-{name}", lambda: encoded(compute())))


def cache_directory() -> Path | None:
    """The cache's folder; None if the user has disabled the cache, or has no directory that can be written."""
    if os.environ.get(CACHE_VARIABLE, "").lower() in OFF:
        return None
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    except RuntimeError:  # no home
        return None
    existing = next(folder for folder in (home, *home.parents, Path.cwd()) if folder.exists())
    return home / "dssc_jax" if os.access(existing, os.W_OK) else None
