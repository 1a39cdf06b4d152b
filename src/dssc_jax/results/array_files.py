"""A store for Zarr that reads and writes files by :mod:`dssc_jax.core.files`, as the rest of the package does."""

import asyncio
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from zarr.abc.store import ByteRequest, OffsetByteRequest, RangeByteRequest, Store, SuffixByteRequest
from zarr.core.buffer import Buffer, BufferPrototype, default_buffer_prototype
from zarr.storage import LocalStore

from dssc_jax.core import files


class ArrayFiles(LocalStore):
    """A Zarr store in a folder.

    Each chunk is a regular file, which is written completely or not at all. A store that is open for writing must
    neither be nor contain a symbolic link. The folder above it must exist, so that a results folder that vanishes is
    not created anew.

    Args:
        root: Folder of the store.
        read_only: Whether the store is only read.
    """

    def __init__(self, root: Path | str, *, read_only: bool = False) -> None:
        """Set the folder of the store; opening the store creates or requires the folder."""
        super().__init__(Path(root), read_only=read_only)

    def _ensure_open_sync(self) -> None:
        """Open the store unless it is open; Zarr's method for synchronous access."""
        if not self._is_open:
            self._require_root()
            self._is_open = True

    async def _open(self, *, mode: Any = None) -> None:
        """Open the store; Zarr's method for asynchronous access."""
        self._require_root()
        await Store._open(self)

    def _require_root(self) -> None:
        """Require that the folder exists; a store for writing first creates it if the folder above it exists."""
        if not self.read_only:
            files.make_folder(self.root, self.root.parent)
        if not self.root.is_dir():
            raise FileNotFoundError(f"{self.root} does not exist")

    def get_sync(
        self, key: str, *, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """The content of a file as a buffer; None if there is no file.

        Args:
            key: Path of the file within the store.
            prototype: Kind of the buffer; None: Zarr's default.
            byte_range: The requested range of bytes; None: all of them.
        """
        self._ensure_open_sync()
        try:
            content = files.read_bytes(self.root / key)
        except (FileNotFoundError, IsADirectoryError, NotADirectoryError):
            return None
        buffer_type = (prototype or default_buffer_prototype()).buffer
        return buffer_type.from_bytes(requested_bytes(content, byte_range))

    async def get(
        self, key: str, prototype: BufferPrototype | None = None, byte_range: ByteRequest | None = None
    ) -> Buffer | None:
        """The content of a file as a buffer, read in another thread; see :meth:`get_sync`."""
        return await asyncio.to_thread(self.get_sync, key, prototype=prototype, byte_range=byte_range)

    async def get_partial_values(
        self, prototype: BufferPrototype, key_ranges: Iterable[tuple[str, ByteRequest | None]]
    ) -> list[Buffer | None]:
        """The requested ranges of bytes of several files, one after the other; see :meth:`get_sync`."""
        return [await self.get(key, prototype, byte_range) for key, byte_range in key_ranges]

    def set_sync(self, key: str, value: Buffer) -> None:
        """Write a file completely or not at all, and create its folder within the store.

        Args:
            key: Path of the file within the store.
            value: Content of the file.
        """
        self._check_writable()
        self._ensure_open_sync()
        path = self.root / key
        folder = self.root.parent
        files.make_folder(path.parent, folder)
        files.write_bytes(path, value.as_numpy_array().data, folder, durable=False)

    async def set(self, key: str, value: Buffer) -> None:
        """Write a file in another thread; see :meth:`set_sync`."""
        await asyncio.to_thread(self.set_sync, key, value)

    async def set_if_not_exists(self, key: str, value: Buffer) -> None:
        """Write a file unless it exists; the lock of the results folder keeps other processes from creating it."""
        if not await self.exists(key):
            await self.set(key, value)

    def delete_sync(self, key: str) -> None:
        """Delete a file, or a folder with its content."""
        self._check_writable()
        path = self.root / key
        folder = self.root.parent
        if path.is_dir() and not path.is_symlink():
            files.delete_tree(path, folder)
        else:
            files.delete(path, folder)

    async def delete(self, key: str) -> None:
        """Delete a file or a folder in another thread; see :meth:`delete_sync`."""
        await asyncio.to_thread(self.delete_sync, key)

    async def delete_dir(self, prefix: str) -> None:
        """Delete a folder with its content."""
        self._check_writable()
        await asyncio.to_thread(files.delete_tree, self.root / prefix, self.root.parent)

    async def clear(self) -> None:
        """Delete every file of the store; the empty folder remains."""
        await self.delete_dir("")
        files.make_folder(self.root, self.root.parent)


def requested_bytes(content: bytes, request: ByteRequest | None) -> bytes:
    """Select the bytes that Zarr requests: a range, all from an offset on, or the last ones; None: all bytes."""
    match request:
        case RangeByteRequest():
            return content[request.start : request.end]
        case OffsetByteRequest():
            return content[request.offset :]
        case SuffixByteRequest():
            return content[max(0, len(content) - request.suffix) :]
    return content
