"""Digests of what a results folder holds, block by block: nothing is read from another's place, nor once it is altered.

Each block has a small JSON file that says where it belongs and gives the SHA-256 digest of every variable's values. It
is written after the block's chunks, and therefore marks the block as complete. Any number of processes may write, each
for its own blocks. A digest over all of them stands in the manifest of a finished run.
"""

import hashlib
import json
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Layout
from dssc_jax.results.manifest import write_json
from dssc_jax.study import hash_of

DIGESTS = "digests"
Index = tuple[int, ...]


class Piece(NamedTuple):
    """What a block holds of a range of draws; a block that grew has several.

    Args:
        draws: First draw, and the one after the last.
        sums: Digest of each variable's values.
    """

    draws: tuple[int, int]
    sums: dict[str, str]


def sum_of(values: np.ndarray, about: str = "") -> str:
    """Digest of an array: of its shape, type and values, whatever the machine's order of bytes.

    Args:
        values: The array.
        about: What else the digest shall bind.
    """
    plain = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    head = f"{values.shape} {plain.dtype.str} {about}\n"
    return hashlib.sha256(head.encode() + plain.tobytes()).hexdigest()


def file_of(folder: Path, index: Index) -> Path:
    """Where a block's digests stand.

    Raises:
        ConfigError: a folder stands in their place.
    """
    file = folder / DIGESTS / f"{'.'.join(map(str, index))}.json"
    if file.is_dir():
        raise ConfigError(str(file), "is damaged: a folder stands in the place of a file; take it away")
    return file


def content_of(folder: Path, index: Index) -> Any:
    """What stands there; None where that is nothing, or no JSON."""
    try:
        return json.loads(file_of(folder, index).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return None


def pieces_of(folder: Path, index: Index) -> list[Piece]:
    """A block's digests; none where they are absent, damaged, or another block's."""
    content = content_of(folder, index)
    try:
        if content["block"] != list(index):
            return []
        pieces = [Piece((int(first), int(last)), dict(sums)) for (first, last), sums in content["pieces"]]
    except (TypeError, KeyError, ValueError):
        return []
    return pieces


def add_piece(folder: Path, index: Index, piece: Piece) -> None:
    """Write a block's digests: of what it held before the piece, and of the piece."""
    before = [other for other in pieces_of(folder, index) if other.draws[1] <= piece.draws[0]]
    (folder / DIGESTS).mkdir(exist_ok=True)
    write_json(file_of(folder, index), {"block": index, "pieces": [*before, piece]}, durable=False)


def over_all(folder: Path, layout: Layout) -> str:
    """The digest over the digests of all blocks."""
    return hash_of({"blocks": [content_of(folder, layout.index(block)) for block in layout.blocks()]})
