"""Native code of a study: shared objects and FMUs, which the study names with the SHA-256 digests of their content."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native.allowed import LOADED, allow_native, native_digest
from dssc_jax.core.registry import Registry
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.controllers import CONTROLLERS
from dssc_jax.models.plants import PLANTS

NATIVE_SLOTS: dict[str, Registry] = {"plant": PLANTS, "controller": CONTROLLERS, "compare": CONTROLLERS}
"""Sections of a study whose parts may be native code, with the kinds of their parts."""


class NativeFile(NamedTuple):
    """A file of native code that a study names.

    Args:
        file: Name of the file in the study.
        sha256: SHA-256 digest of the file's content; empty if the study states no digest.
    """

    file: str
    sha256: str

    @property
    def loaded(self) -> bool:
        """Whether this process has loaded native code with this digest."""
        return self.sha256 in LOADED

    @property
    def text(self) -> str:
        """Name of the file, the path from which it was loaded, and its digest, in words."""
        origin = f" from {self.place}" if self.loaded else ""
        digest = self.sha256 or "unknown"
        return f"native code {self.file}{origin}, SHA-256 {digest}"

    @property
    def place(self) -> str | None:
        """Path from which this process has loaded the native code; None if the code is not loaded."""
        return LOADED[self.sha256].file if self.loaded else None


def native_files(table: Mapping[str, object]) -> tuple[NativeFile, ...]:
    """Files of native code that a study names, each once, in the order of the table; the table need not be valid."""
    files: list[NativeFile] = []
    for part in native_tables(table):
        digest = part.get("sha256", "")
        files.append(NativeFile(str(part["file"]), digest if isinstance(digest, str) else ""))
    return tuple(dict.fromkeys(files))


def native_tables(table: Mapping[str, object]) -> Iterator[Mapping[str, object]]:
    """Yield each table of a study that names native code; the study need not be valid.

    In ``[compare]``, a table without a kind has the kind of ``[controller]``.
    """
    controller = table.get("controller")
    kind = controller.get("kind") if isinstance(controller, Mapping) else None
    for slot, registry in NATIVE_SLOTS.items():
        yield from tables_within(table.get(slot), kind, registry)


def tables_within(node: object, inherited: object, registry: Registry) -> Iterator[Mapping[str, object]]:
    """Yield each table that names native code: the given table itself, and tables within it at any depth.

    Args:
        node: Part of a study's table; a part that is no table yields nothing.
        inherited: Kind that a table without ``kind`` has, that of the table around it.
        registry: Kinds of the section.
    """
    if not isinstance(node, Mapping):
        return
    kind = node.get("kind", inherited)
    entry = registry.get(kind) if isinstance(kind, str) else None
    is_native = entry is not None and entry.native
    if is_native and isinstance(node.get("file"), str):
        yield node
    for part in node.values():
        yield from tables_within(part, kind, registry)


def with_digests(table: Mapping[str, object], folder: Path) -> TomlTable:
    """Copy a study's table, with a digest for all native code; a missing digest is computed from the file.

    So a stored study tells with which native code it was run.

    Args:
        table: Table of the study.
        folder: Folder to which the names of files are relative.

    Raises:
        ConfigError: A file cannot be read.
    """
    native_parts = list(native_tables(table))
    if not native_parts:
        return dict(table)
    content = {}
    for name, value in table.items():
        content[name] = with_digest(value, native_parts, folder) if name in NATIVE_SLOTS else value
    return content


def with_digest(node: object, native_parts: Sequence[Mapping[str, object]], folder: Path) -> object:
    """Copy a part of a study's table, with a digest in every table that names native code.

    Args:
        node: The part; anything other than a table is returned as it is.
        native_parts: The tables that name native code. They are recognised by identity, since two of them may be equal.
        folder: Folder to which the names of files are relative.
    """
    if not isinstance(node, Mapping):
        return node
    content = {name: with_digest(value, native_parts, folder) for name, value in node.items()}
    is_native = any(part is node for part in native_parts)
    if is_native and not node.get("sha256"):
        content["sha256"] = native_digest(folder / str(node["file"]))
    return content


def without_old_digests(changes: Mapping[str, object]) -> dict[str, object]:
    """Add an empty digest to changes of a study for each file of native code that they change.

    The empty digest takes the place of the former file's digest, so that :func:`with_digests` computes the new one.

    Args:
        changes: New values by dotted name.
    """
    empty_digests: dict[str, object] = {}
    for name in changes:
        slot, _, field = name.partition(".")
        if slot in NATIVE_SLOTS and (field == "file" or field.endswith(".file")):
            empty_digests[f"{name.removesuffix('file')}sha256"] = ""
    return {**empty_digests, **changes}  # a stated digest takes precedence


def load_native(table: Mapping[str, object], folders: Sequence[Path], recorded: object = None) -> None:
    """Load the native code that a study names; see :func:`dssc_jax.core.native.allowed.allow_native`.

    Args:
        table: Table of the study, with digests.
        folders: Folders in which to look for each file; the first file that exists must have the digest.
        recorded: Entry ``code`` in the manifest of a stored result; the files that the run used are the last places to
            look for. None: there is no such result.

    Raises:
        ConfigError: A file is not found, has another digest, or cannot be loaded.
    """
    for native in native_files(table):
        if native.loaded:
            continue
        places = [folder / native.file for folder in folders]
        entry = recorded.get(native.file) if isinstance(recorded, Mapping) else None
        recorded_file = entry.get("file") if isinstance(entry, Mapping) else None
        if isinstance(recorded_file, str):
            places.append(Path(recorded_file))
        existing_place = next((place for place in places if place.is_file()), None)
        if existing_place is None:
            raise ConfigError("file", f"'{native.file}' is not found; looked for {', '.join(map(str, places))}")
        allow_native(existing_place, native.sha256)
