"""Files of the code that a study refers to, as ``module:object`` or as native code, found without running it."""

import hashlib
import importlib.util
from collections.abc import Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

from dssc_jax.core import files
from dssc_jax.study.native import native_files

REFERENCE_KEYS = ("kind", "metric", "names")
"""Keys of a study's tables whose values may be ``module:object``."""


def code_names(table: Mapping[str, object]) -> tuple[str, ...]:
    """Find every ``module:object`` in a study's table, sorted; the table need not be valid."""
    names: set[str] = set()
    pending_nodes: list[Any] = [table]
    while pending_nodes:
        node = pending_nodes.pop()
        if isinstance(node, Mapping):
            for key in REFERENCE_KEYS:
                value = node.get(key)
                texts = value if isinstance(value, list | tuple) else [value]
                names.update(text for text in texts if isinstance(text, str) and ":" in text)
            pending_nodes.extend(node.values())
        elif isinstance(node, list | tuple):
            pending_nodes.extend(node)
    return tuple(sorted(names))


def code_file(name: str) -> Path | None:
    """File of the module in ``module:object``; None if it is not found.

    The search runs no code: ``importlib.util.find_spec`` of a dotted name would import the packages above the module.
    """
    top_package, *submodules = name.partition(":")[0].split(".")
    try:
        spec = importlib.util.find_spec(top_package)
        for submodule in submodules:
            search_paths = spec.submodule_search_locations if spec else None
            spec = PathFinder.find_spec(submodule, list(search_paths)) if search_paths else None
    except (ImportError, ValueError):  # not the name of a module, or a module without a spec
        return None
    return Path(spec.origin) if spec and spec.has_location and spec.origin else None


def code_digests(table: Mapping[str, object]) -> dict[str, dict[str, str | None]]:
    """File and SHA-256 digest of all code that a study refers to, for JSON.

    Returns:
        The files of modules by ``module:object``, and those of native code by their name in the study.
    """
    modules = {name: file_digest(code_file(name)) for name in code_names(table)}
    native = {part.file: {"file": part.place, "sha256": part.sha256} for part in native_files(table)}
    return modules | native


def file_digest(file: Path | None) -> dict[str, str | None]:
    """Path of a file and SHA-256 digest of its content, for JSON; both None without a file."""
    if file is None:
        return {"file": None, "sha256": None}
    return {"file": str(file), "sha256": hashlib.sha256(files.read_bytes(file)).hexdigest()}


def module_folders(modules: object) -> tuple[Path, ...]:
    """Folders from which a run imported the modules of :func:`code_digests`; of a package, the folder that holds it."""
    if not isinstance(modules, Mapping):
        return ()
    paths = []
    for name, module in modules.items():
        file = module.get("file") if isinstance(module, Mapping) else None
        if isinstance(file, str) and Path(file).is_file():
            depth = name.partition(":")[0].count(".") + (Path(file).name == "__init__.py")
            paths.append(Path(file).parents[depth])
    return tuple(dict.fromkeys(paths))


def describe_code(table: Mapping[str, object], modules: Mapping[str, object] | None = None) -> str:
    """Describe all code that a study refers to, in words; arguments as of :func:`describe_modules`."""
    parts = [describe_modules(table, modules), *(native.text for native in native_files(table))]
    return "; ".join(filter(None, parts))


def describe_modules(table: Mapping[str, object], modules: Mapping[str, object] | None = None) -> str:
    """Describe each ``module:object`` that a study refers to and its file, in words; empty if there is none.

    Args:
        table: Table of the study.
        modules: Result of :func:`code_digests` when the study was run, to report changes; None if it is unknown.
    """
    lines = []
    for name in code_names(table):
        current = file_digest(code_file(name))
        entry = (modules or {}).get(name)
        recorded_entry = entry if isinstance(entry, Mapping) else {}
        if current["file"] is None:
            former_file = f" (the run used {recorded_entry['file']})" if recorded_entry.get("file") else ""
            lines.append(f"{name} from no file that is found{former_file}")
        else:
            is_changed = bool(recorded_entry) and recorded_entry.get("sha256") != current["sha256"]
            lines.append(f"{name} from {current['file']}{', changed since the run' * is_changed}")
    return "; ".join(lines)
