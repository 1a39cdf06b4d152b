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


class DrawRange(NamedTuple):
    """The digests of a range of a block's draws; a block that was extended has several such ranges.

    Args:
        draws: The first draw, and the last draw plus one.
        digests: Digest of each variable's values.
    """

    draws: tuple[int, int]
    digests: dict[str, str]


def digest_of(values: np.ndarray, context: str = "") -> str:
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


def ranges_of(folder: Path, index: Index) -> list[DrawRange]:
    """A block's digests; none if they are absent, damaged, or those of another block."""
    content = content_of(folder, index)
    try:
        if content["block"] != list(index):
            return []
        pairs = content["pieces"]
        ranges = [DrawRange((int(start), int(stop)), dict(digests)) for (start, stop), digests in pairs]
    except (TypeError, KeyError, ValueError):
        return []
    return ranges


def add_range(folder: Path, index: Index, addition: DrawRange) -> None:
    """Write a block's digests: the previous ones, and those of one more range."""
    earlier = [draw_range for draw_range in ranges_of(folder, index) if draw_range.draws[1] <= addition.draws[0]]
    files.make_folder(folder / DIGESTS, folder)
    write_json(file_of(folder, index), {"block": index, "pieces": [*earlier, addition]}, folder, durable=False)


def over_all(folder: Path, layout: Layout) -> str:
    """The digest over the digests of all blocks."""
    return hash_of({"blocks": [content_of(folder, layout.index(block)) for block in layout.blocks()]})
