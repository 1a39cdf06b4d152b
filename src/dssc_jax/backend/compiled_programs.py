"""Compiled programs, kept in the user's cache directory, so that the second process that needs one only reads it.

JAX has such a cache, but one that believes its files: half of a program warns at every start, and another program under
its name is run, which ends the process. Here every file begins with the digest of its name and content. What does not
match is deleted with one line, and compiled again. A file is moved to its place in one piece, so that processes need
not wait for each other.

Setting the environment variable ``DSSC_JAX_CACHE=off`` keeps nothing; whoever has given JAX a cache keeps that.
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
    """A folder of programs by name, as JAX asks for them.

    Args:
        folder: Where; made when a program is put in.
        most: Bytes that it may hold.
    """

    def __init__(self, folder: Path, most: int = CACHE_SIZE) -> None:
        self._path, self.most = folder, most

    def get(self, key: str) -> bytes | None:
        """The program of a name; None where there is none, or where the file holds anything else."""
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
        """Keep a program under its name."""
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
        """Delete the files that have not been read for the longest time, whoever wrote them."""
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
    """What binds a program to its name."""
    return hashlib.sha256(key.encode() + b"\n" + program).digest()


def keep_programs() -> None:
    """Have JAX keep compiled programs here, unless the user has given it a cache or wants none.

    JAX has no public way to say how a cache is read. In a version where the function that makes it is gone, nothing is
    kept: rather no cache than one that is believed.
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
