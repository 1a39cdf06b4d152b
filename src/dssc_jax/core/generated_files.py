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
        ConfigError: A file has not the digest that :func:`write_sums` stored; it may be somebody's work.
    """
    sums = stored_sums(folder)
    for name in names:
        path = folder / name
        if path.is_file() and not path.is_symlink() and sums.get(name) != digest(path):
            rule = "is in the place of a generated file" if name not in sums else "was changed after it was generated"
            raise ConfigError(str(path), f"{rule}, and would be replaced; move it away, or choose another folder")


def write_sums(folder: Path, names: Iterable[str]) -> None:
    """Write the digests of generated files to :data:`SUMS`; raises OSError."""
    lines = [f"{digest(folder / name)}  {name}\n" for name in names]
    files.write_text(folder / SUMS, lines)


def stored_sums(folder: Path) -> dict[str, str]:
    """The digests that :func:`write_sums` stored, by name; empty where it stored none."""
    path = folder / SUMS
    if not path.is_file():
        return {}
    pairs = [line.split(maxsplit=1) for line in files.read_text(path, errors="replace").splitlines()]
    return {pair[1]: pair[0] for pair in pairs if len(pair) == 2}


def digest(path: Path) -> str:
    """SHA-256 digest of a file."""
    return hashlib.sha256(files.read_bytes(path)).hexdigest()
