"""Native code that this process may run, by the digest of its content: shared objects and FMUs.

Nothing here loads a file by itself: whoever calls :func:`allow_native` has decided to run its code. A study names
native code by its digest, so that no other file can take its place.
"""

import hashlib
from pathlib import Path
from typing import TypeAlias

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native.fmu import NativeFmu, is_fmu, loaded_fmu
from dssc_jax.core.native.fmu_trials import require_independent
from dssc_jax.core.native.libraries import NativeLibrary, loaded_library

Native: TypeAlias = NativeLibrary | NativeFmu

LARGEST_FILE = 2**28  # bytes

LOADED: dict[str, Native] = {}
"""Native code that this process has loaded, by digest; it stays loaded, since compiled lanes call it."""


def native_content(path: Path) -> bytes:
    """The content of a file of native code.

    Raises:
        ConfigError: The file cannot be read, or is larger than :data:`LARGEST_FILE`.
    """
    try:
        content = files.read_bytes(path, LARGEST_FILE + 1)  # one byte more tells that the file is too large
    except OSError as error:
        raise ConfigError("file", f"'{path}' cannot be read: {error.strerror or error}") from error
    if len(content) > LARGEST_FILE:
        raise ConfigError("file", f"'{path}' is larger than native code can be ({LARGEST_FILE} bytes)")
    return content


def native_digest(path: Path) -> str:
    """Return the SHA-256 digest of a file of native code, in hexadecimal.

    Raises:
        ConfigError: The file cannot be read, or is too large.
    """
    return hashlib.sha256(native_content(path)).hexdigest()


def allow_native(path: str | Path, sha256: str = "") -> Native:
    """Load a shared object or an FMU, whose code may do whatever this process may do.

    A private copy of the content is loaded, so that the code has the digest even if the file changes meanwhile.

    Args:
        path: The file.
        sha256: The SHA-256 digest that it must have; empty: any.

    Raises:
        ConfigError: The file cannot be read or loaded, has another digest, describes no controller or no co-simulation,
            or keeps numbers outside of the state of a flight.
    """
    path = Path(path)
    content = native_content(path)
    digest = hashlib.sha256(content).hexdigest()
    if sha256 and digest != sha256:
        rule = f"'{path}' has changed: its SHA-256 digest is {digest}, and {sha256} is asked for"
        raise ConfigError("file", f"{rule}; build that one again, or state the new one")
    if digest not in LOADED:
        LOADED[digest] = loaded_file(path, content, digest)
    return LOADED[digest]


def loaded_file(path: Path, content: bytes, digest: str) -> Native:
    """Load native code from the content of a file: an FMU or a shared object.

    Args:
        path: The file, for messages.
        content: The file's content.
        digest: SHA-256 digest of the content.

    Raises:
        ConfigError: The content cannot be loaded, describes no controller or no co-simulation, or keeps numbers outside
            of the state of a flight.
    """
    if not is_fmu(content):
        return loaded_library(path, content, digest)
    fmu = loaded_fmu(path, content, digest)
    require_independent(fmu)
    return fmu


def loaded_native(table: dict[str, object], requirement: str) -> Native:
    """Return the loaded native code that a study's table names by ``file`` and ``sha256``.

    Args:
        table: The table.
        requirement: The kind of file that is needed, such as "an FMU", for messages.

    Raises:
        ConfigError: The table names no file, or a file that :func:`allow_native` has not loaded.
    """
    file = table.get("file")
    digest = table.get("sha256", "")
    if not isinstance(file, str):
        raise ConfigError("file", f"must be the name of {requirement}, got {file!r}")
    native = LOADED.get(digest) if isinstance(digest, str) else None
    if native is None:
        rule = f"'{file}' is native code that was not loaded (SHA-256 {digest or 'unknown'})"
        raise ConfigError("file", f"{rule}; `allow_native` loads it (in Python: dj.allow_native(FILE))")
    return native
