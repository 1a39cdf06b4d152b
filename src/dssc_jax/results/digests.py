"""Digests of the blocks of a results folder, which detect altered and misplaced data.

Each block has a small JSON file with the block's position and the SHA-256 digest of every variable's values. It is
written after the block's chunks and therefore marks the block as complete. Any number of processes may write, each
for its own blocks. The manifest of a finished run contains a digest over all blocks.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Layout
from dssc_jax.results.manifest import write_json
from dssc_jax.study import hash_of

DIGESTS = "digests"
Index = tuple[int, ...]


class Piece(NamedTuple):
    """The digests of a range of draws in a block; an extended block has several.

    Args:
        draws: The first draw, and the last draw plus one.
        sums: Digest of each variable's values.
    """

    draws: tuple[int, int]
    sums: dict[str, str]


def sum_of(values: np.ndarray, context: str = "") -> str:
    """Digest of an array's shape, type and values, independent of the machine's byte order.

    Args:
        values: The array.
        context: Further text to include in the digest.
    """
    plain = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    head = f"{values.shape} {plain.dtype.str} {context}\n"
    return hashlib.sha256(head.encode() + plain.tobytes()).hexdigest()


def file_of(folder: Path, index: Index) -> Path:
    """The file of a block's digests.

    Raises:
        ConfigError: There is a folder in its place.
    """
    file = folder / DIGESTS / f"{'.'.join(map(str, index))}.json"
    if file.is_dir():
        raise ConfigError(str(file), "is damaged: it is a folder, not a file; remove it")
    return file


def content_of(folder: Path, index: Index) -> Any:
    """The content of that file; None if it is absent or not JSON."""
    try:
        return json.loads(files.read_text(file_of(folder, index)))
    except (OSError, ValueError, RecursionError):
        return None


def pieces_of(folder: Path, index: Index) -> list[Piece]:
    """A block's digests; none if they are absent, damaged, or those of another block."""
    content = content_of(folder, index)
    try:
        if content["block"] != list(index):
            return []
        pieces = [Piece((int(start), int(stop)), dict(sums)) for (start, stop), sums in content["pieces"]]
    except (TypeError, KeyError, ValueError):
        return []
    return pieces


def add_piece(folder: Path, index: Index, piece: Piece) -> None:
    """Write a block's digests: the previous ones, and those of the piece."""
    earlier = [stored for stored in pieces_of(folder, index) if stored.draws[1] <= piece.draws[0]]
    files.make_folder(folder / DIGESTS, folder)
    write_json(file_of(folder, index), {"block": index, "pieces": [*earlier, piece]}, folder, durable=False)


def over_all(folder: Path, layout: Layout) -> str:
    """The digest over the digests of all blocks."""
    return hash_of({"blocks": [content_of(folder, layout.index(block)) for block in layout.blocks()]})
