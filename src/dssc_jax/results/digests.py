"""Digests of the blocks of a results folder, which detect altered and misplaced data.

Each block has a small JSON file with the block's position and the SHA-256 digest of each variable's values. This file
is written after the chunks, and so marks the block as complete. Several processes may write, each for blocks of its
own. The manifest of a finished run contains a digest over all blocks.
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

DIGESTS = "digests"  # folder of the files, and entry of the manifest
Index = tuple[int, ...]
"""Position of a block along each dimension of the grid, in blocks."""


class DrawRange(NamedTuple):
    """The digests of a range of draws in a block; a block to which draws were added has several ranges.

    Args:
        draws: Index of the first draw, and the index after the last.
        digests: Digest of each variable's values, by name.
    """

    draws: tuple[int, int]
    digests: dict[str, str]


def digest_of(values: np.ndarray, context: str = "") -> str:
    """SHA-256 digest of the shape, type and values of an array, independent of the machine's byte order.

    Args:
        values: The array.
        context: Further text that the digest covers, such as the attributes of the array.
    """
    little_endian = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    head = f"{values.shape} {little_endian.dtype.str} {context}\n"
    return hashlib.sha256(head.encode() + little_endian.tobytes()).hexdigest()


def digest_file(folder: Path, index: Index) -> Path:
    """Path of the file with the digests of a block.

    Args:
        folder: The results folder.
        index: Position of the block.

    Raises:
        ConfigError: There is a folder in the place of the file.
    """
    file = folder / DIGESTS / f"{'.'.join(map(str, index))}.json"
    if file.is_dir():
        raise ConfigError(str(file), "is damaged: it is a folder, not a file; remove it")
    return file


def digest_content(folder: Path, index: Index) -> Any:
    """Unchecked content of the file with the digests of a block; None if the file is absent or not JSON."""
    try:
        return json.loads(files.read_text(digest_file(folder, index)))
    except (OSError, ValueError, RecursionError):
        return None


def stored_ranges(folder: Path, index: Index) -> list[DrawRange]:
    """The stored digests of a block, for each range of its draws.

    The list is empty if the file of the digests is absent or damaged, or belongs to another block.
    """
    content = digest_content(folder, index)
    ranges = []
    try:
        if content["block"] != list(index):
            return []
        for (start, stop), digests in content["pieces"]:
            ranges.append(DrawRange((int(start), int(stop)), dict(digests)))
    except (TypeError, KeyError, ValueError):
        return []
    return ranges


def add_range(folder: Path, index: Index, addition: DrawRange) -> None:
    """Store the digests of a range of draws, after the digests of the block's earlier draws.

    Stored ranges that reach into the new range, or lie after it, are dropped.

    Args:
        folder: The results folder.
        index: Position of the block.
        addition: The digests of the range.
    """
    first_draw, _ = addition.draws
    earlier_ranges = []
    for draw_range in stored_ranges(folder, index):
        _, stop = draw_range.draws
        if stop <= first_draw:
            earlier_ranges.append(draw_range)
    files.make_folder(folder / DIGESTS, folder)
    content = {"block": index, "pieces": [*earlier_ranges, addition]}
    write_json(digest_file(folder, index), content, folder, durable=False)


def digest_of_all(folder: Path, layout: Layout) -> str:
    """The digest over the digests of all blocks, which the manifest of a finished run contains."""
    contents = [digest_content(folder, layout.index(block)) for block in layout.blocks()]
    return hash_of({"blocks": contents})
