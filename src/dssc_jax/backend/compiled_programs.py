"""A cache of compiled programs in the user's cache directory, shared by all processes.

JAX's own cache trusts its files: a truncated program causes a warning at every start, and a different program under
the same name is run, which ends the process. Here every file begins with the digest of its name and content. A file
that does not match is deleted with a one-line message, and the program is compiled again. Files are moved into place
atomically, so processes need not wait for each other.

The environment variable ``DSSC_JAX_CACHE=off`` disables the cache. A cache that the user has configured for JAX takes
precedence.
"""

import hashlib
import os
import sys
from pathlib import Path
from uuid import uuid4

import jax

from dssc_jax.backend import xla

CACHE_VARIABLE = "DSSC_JAX_CACHE"
LEAST_COMPILE_TIME = 0.05  # s of compiling, from which on a program is kept
CACHE_SIZE = 2**28  # bytes; what has not been read for the longest time goes first
DIGEST = hashlib.sha256().digest_size


class ProgramCache:
    """A folder of programs by name, with the interface that JAX requires.

    Args:
        folder: The folder; created when a program is stored.
        most: Maximum size in bytes.
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
        try:
            partial.write_bytes(digest(key, value) + value)
            os.replace(partial, self._file(key))
        except OSError:
            partial.unlink(missing_ok=True)
            raise
        self._make_room()

    def _file(self, key: str) -> Path:
        return self._path / f"{key}.program"

    def _make_room(self) -> None:
        """Delete the files that have not been read for the longest time."""
        with os.scandir(self._path) as entries:
            known = [
                (about.stat().st_mtime_ns, about.stat().st_size, about.path) for about in entries if about.is_file()
            ]
        excess = sum(size for _, size, _ in known) - self.most
        for _, size, path in sorted(known):
            if excess <= 0:
                return
            Path(path).unlink(missing_ok=True)
            excess -= size


def digest(key: str, program: bytes) -> bytes:
    """The digest that binds a program to its name."""
    return hashlib.sha256(key.encode() + b"\n" + program).digest()


def keep_programs() -> None:
    """Make JAX store compiled programs in a :class:`ProgramCache`, unless the user has configured or disabled a cache.

    JAX has no public interface to change how a cache is read. If a version lacks the function that creates its
    cache, programs are not cached: JAX's own cache would run a file without checking it.
    """
    folder = xla.cache_directory()
    off = os.environ.get(CACHE_VARIABLE, "").lower() in xla.OFF
    if off or folder is None or getattr(jax.config, "jax_compilation_cache_dir", ""):
        return
    try:
        from jax._src import compilation_cache

        others = compilation_cache.get_file_cache
    except (ImportError, AttributeError):
        return
    own = str(folder)
    compilation_cache.get_file_cache = lambda path: (ProgramCache(folder), path) if path == own else others(path)
    jax.config.update("jax_compilation_cache_dir", str(folder))
    if "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS" not in os.environ:
        jax.config.update("jax_persistent_cache_min_compile_time_secs", LEAST_COMPILE_TIME)
