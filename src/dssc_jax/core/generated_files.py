"""Generated files: a command replaces a file only if it wrote the file and nobody has changed it since."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError

SUMS = "dssc_jax_files.sha256"
"""File beside the others with the digest of each, as ``sha256sum`` writes and checks it."""


def require_replaceable(folder: Path, names: Iterable[str]) -> None:
    """Require that the files which a command is about to replace are unchanged files of an earlier command.

    Args:
        folder: The folder; it need not exist.
        names: Names of the files to write.

    Raises:
        ConfigError: A file's digest differs from the one that :func:`write_sums` stored, or none is stored. The file
            may then be somebody's work.
    """
    sums = stored_sums(folder)
    for name in names:
        path = folder / name
        is_own_file = path.is_file() and not path.is_symlink()
        if is_own_file and sums.get(name) != digest(path):
            rule = "was changed after it was generated" if name in sums else "is in the place of a generated file"
            raise ConfigError(str(path), f"{rule}, and would be replaced; move it away, or choose another folder")


def write_sums(folder: Path, names: Iterable[str]) -> None:
    """Write the digest of each generated file to :data:`SUMS` in their folder, in the form of ``sha256sum``.

    Raises:
        OSError: The file cannot be written.
    """
    lines = [f"{digest(folder / name)}  {name}\n" for name in names]
    files.write_text(folder / SUMS, lines)


def stored_sums(folder: Path) -> dict[str, str]:
    """Return the stored digest of each generated file, by the file's name; empty if :func:`write_sums` stored none."""
    path = folder / SUMS
    if not path.is_file():
        return {}
    digests = {}
    for line in files.read_text(path, errors="replace").splitlines():
        words = line.split(maxsplit=1)
        if len(words) == 2:  # digest and name; other lines are not of `write_sums`
            file_digest, name = words
            digests[name] = file_digest
    return digests


def digest(path: Path) -> str:
    """Return the SHA-256 digest of a file's content, in hexadecimal."""
    return hashlib.sha256(files.read_bytes(path)).hexdigest()
