"""Files of the code that a study names, as ``module:object`` or as native code, found without running the code."""

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Iterator, Mapping
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

from dssc_jax.core import files
from dssc_jax.study.native import native_files

REFERENCE_KEYS = ("kind", "metric", "names")
"""Keys of a study's tables whose values may be ``module:object``."""
FOLDERS_OF_INSTALLED = frozenset({"site-packages", "dist-packages"})
PACKAGE = __name__.partition(".")[0]


def code_names(table: Mapping[str, object]) -> tuple[str, ...]:
    """Every ``module:object`` that a study's table names, sorted; the table need not be valid."""
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
    """File of the module in ``module:object``; None if no file is found.

    The search runs no code. It descends package by package, since ``importlib.util.find_spec`` of a dotted name would
    import the packages above the module.
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
        File and digest by name, for three kinds of files: modules that the study names, by ``module:object``; a user's
        modules that these import, by the module's name; and native code, by the file's name in the study.
    """
    named_modules = {name: file_digest(code_file(name)) for name in code_names(table)}
    native = {part.file: {"file": part.place, "sha256": part.sha256} for part in native_files(table)}
    return named_modules | imported_digests(table) | native


def file_digest(file: Path | None) -> dict[str, str | None]:
    """Path of a file and SHA-256 digest of its content, for JSON; both are None if there is no file."""
    if file is None:
        return {"file": None, "sha256": None}
    return {"file": str(file), "sha256": hashlib.sha256(files.read_bytes(file)).hexdigest()}


def imported_digests(table: Mapping[str, object]) -> dict[str, dict[str, str | None]]:
    """File and digest of the user's modules that the code of a study imports, by the module's name."""
    imported: dict[str, Path] = {}
    for name in code_names(table):
        imported |= imported_files(name)
    return {name: file_digest(imported[name]) for name in sorted(imported)}


def imported_files(name: str) -> dict[str, Path]:
    """Files of the user's modules that the module in ``module:object`` imports, directly or through other modules.

    The search reads the text of import statements, and so runs no code. It follows modules of the named module's
    package, and modules below the folder from which the named module is imported, unless these lie in a folder of
    installed packages.

    Returns:
        Files by the module's name, without the named module itself.
    """
    start = name.partition(":")[0]
    file = code_file(start)
    if file is None:
        return {}
    top_package = start.partition(".")[0]
    folder = top_folder(start, file)
    found = {start: file}
    pending_modules = [*parent_packages(start), start]
    known_names = set(pending_modules)
    while pending_modules:
        module = pending_modules.pop()
        module_file = found.get(module) or code_file(module)
        if module_file is None:
            continue
        is_of_package = module.partition(".")[0] == top_package
        is_below_folder = module_file.is_relative_to(folder) and FOLDERS_OF_INSTALLED.isdisjoint(module_file.parts)
        if not is_of_package and not is_below_folder:
            continue
        found[module] = module_file
        new_names = set(imported_names(module, module_file)) - known_names
        known_names |= new_names
        pending_modules += new_names
    del found[start]
    return found


def parent_packages(module: str) -> list[str]:
    """Names of the packages above a module, such as ``a`` and ``a.b`` for ``a.b.c``; an import runs them first."""
    parts = module.split(".")
    return [".".join(parts[:count]) for count in range(1, len(parts))]


def imported_names(module: str, file: Path) -> Iterator[str]:
    """Yield the names of the modules that a file's import statements may load, and of the packages above them.

    Modules of Python's standard library and of this package are left out.

    Args:
        module: Name of the module, against which relative imports are resolved.
        file: File of the module; a file without Python source, such as a compiled module, yields no names.
    """
    if file.suffix != ".py":
        return
    try:
        tree = ast.parse(files.read_bytes(file))
    except (SyntaxError, ValueError):  # its import fails, and says why
        return
    package = module.split(".") if file.name == "__init__.py" else module.split(".")[:-1]
    for node in ast.walk(tree):
        for name in names_in_statement(node, package):
            top_name = name.partition(".")[0]
            if top_name and top_name != PACKAGE and top_name not in sys.stdlib_module_names:
                yield from (*parent_packages(name), name)


def names_in_statement(node: ast.AST, package: list[str]) -> list[str]:
    """Names of the modules that an import statement may load; empty for any other statement.

    In ``from a import b``, b may be a module or an object. So both ``a`` and ``a.b`` are among the names.

    Args:
        node: The statement.
        package: Parts of the name of the package that contains the statement, for relative imports.
    """
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if not isinstance(node, ast.ImportFrom):
        return []
    parts = []
    if node.level:  # number of leading dots: one stands for the package itself, each further one for the one above
        parts = package[: len(package) - node.level + 1]
    if node.module:
        parts = [*parts, node.module]
    origin = ".".join(parts)
    return [origin, *(f"{origin}.{alias.name}" for alias in node.names)]


def top_folder(module: str, file: Path) -> Path:
    """The folder from which a module is imported: the folder that contains its top package, or its single file.

    Args:
        module: Name of the module, such as ``a.b``, whose file is ``a/b.py`` or ``a/b/__init__.py`` below the folder.
        file: File of the module.
    """
    levels_below = module.count(".")
    if file.name == "__init__.py":
        levels_below += 1
    return file.parents[levels_below]


def module_folders(modules: object) -> tuple[Path, ...]:
    """Folders from which a run imported its modules, each once; empty if the entry is damaged.

    Args:
        modules: Result of :func:`code_digests` at the time of the run, as read from its manifest.
    """
    if not isinstance(modules, Mapping):
        return ()
    paths = []
    for name, module in modules.items():
        file = module.get("file") if isinstance(module, Mapping) else None
        if isinstance(file, str) and Path(file).is_file():
            paths.append(top_folder(name.partition(":")[0], Path(file)))
    return tuple(dict.fromkeys(paths))


def describe_code(table: Mapping[str, object], modules: Mapping[str, object] | None = None) -> str:
    """Describe all code that a study refers to, in words: its modules and their files, then its native code.

    Args:
        table: Table of the study.
        modules: Result of :func:`code_digests` when the study was run, to report changes; None if unknown.
    """
    parts = [describe_modules(table, modules), *(native.text for native in native_files(table))]
    return "; ".join(filter(None, parts))


def describe_modules(table: Mapping[str, object], modules: Mapping[str, object] | None) -> str:
    """Describe each ``module:object`` that a study refers to and its file, in words; empty if there is none.

    A user's module that these modules import is described only if it has changed since the run.

    Args:
        table: Table of the study.
        modules: Result of :func:`code_digests` when the study was run, to report changes; None if it is unknown.
    """
    lines = []
    for name in code_names(table):
        current = file_digest(code_file(name))
        recorded = recorded_digest(modules, name)
        if current["file"] is None:
            former_file = f" (the run used {recorded['file']})" if recorded.get("file") else ""
            lines.append(f"{name} from no file that is found{former_file}")
        elif recorded and recorded.get("sha256") != current["sha256"]:
            lines.append(f"{name} from {current['file']}, changed since the run")
        else:
            lines.append(f"{name} from {current['file']}")
    if modules:
        for name, current in imported_digests(table).items():
            recorded = recorded_digest(modules, name)
            if recorded and recorded.get("sha256") != current["sha256"]:
                lines.append(f"{name} from {current['file']}, which it imports, changed since the run")
    return "; ".join(lines)


def recorded_digest(modules: Mapping[str, object] | None, name: str) -> Mapping[str, object]:
    """File and digest of a module when the study was run, as in :func:`file_digest`; empty if they are unknown."""
    entry = modules.get(name) if modules else None
    return entry if isinstance(entry, Mapping) else {}
