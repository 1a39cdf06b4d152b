"""Load the study or the result of a command, and announce the code of others that is about to run."""

import os
import re
from collections.abc import Mapping
from pathlib import Path

from dssc_jax.analyses.loading import Loaded, description, load
from dssc_jax.cli.declarations.types import DrawsOptions, SeededOptions, StudyOptions
from dssc_jax.cli.output import say
from dssc_jax.cli.parsing import parse_changes
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError
from dssc_jax.proofs.certificate_text import certificate_content
from dssc_jax.results.manifest import Manifest, read_manifest
from dssc_jax.results.result import Result, load_result
from dssc_jax.study import Study, read_toml
from dssc_jax.study.code import describe_modules, module_folders
from dssc_jax.study.importing import allow_imports
from dssc_jax.study.library import find_study
from dssc_jax.study.native import load_native, native_files
from dssc_jax.study.study import with_files
from dssc_jax.study.tables import with_changes


def study_of(options: StudyOptions) -> Study:
    """The study of a command, with the changes that the options request.

    Raises:
        ConfigError: The study is not valid, or an option and ``--set`` give the same number.
    """
    settings = parse_changes(options.settings)
    numbers: dict[str, object] = {}
    if isinstance(options, DrawsOptions) and options.draws is not None:
        numbers["draws"] = options.draws
    if isinstance(options, SeededOptions) and options.seed is not None:
        numbers["seed"] = options.seed
    for name in numbers.keys() & settings.keys():
        rule = f"gives a second value of {name}; leave out this option, or --set {name}={settings[name]}"
        raise ConfigError(f"--{name}", rule)
    return load_study(options.study, settings | numbers, options.allow_local, options.allow_native)


def load_study(name: str, changes: Mapping[str, object], local: bool, native: bool) -> Study:
    """Load a study with changes.

    Args:
        name: A file, or the name of a packaged study.
        changes: New values by dotted name.
        local: Whether ``module:object`` names in the study may be imported from its folder.
        native: Whether to load the shared objects that the study names, after announcing them.
    """
    path = find_study(name)
    if local:
        allow_imports(path.parent)
    changed_table = with_changes(read_toml(path), changes, str(path))  # both name the file in their errors
    try:
        table = with_files(changed_table, path.parent)
    except ConfigError as error:
        raise error.within(str(path)) from None
    if native:
        show_native("study", table)
        load_native(table, [path.parent])
    show_code("study", table)
    return Study.from_table(table, str(path))


def spare_gpu_memory() -> None:
    """Leave a GPU's memory to the worker that computes on it; called before a study is loaded, which starts JAX."""
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


def stored_result(folder: Path, trust_code: bool, local: bool, native: bool) -> Result:
    """Load a stored result, which may come from an untrusted source.

    Args:
        folder: The results folder.
        trust_code: Whether to import the code that the study names, after announcing it.
        local: Whether trusted code may be imported from the folder of the study file, see :func:`show_trusted`.
        native: Whether to load the shared objects that the study names, after announcing them.
    """
    if native:
        load_stored_native(read_manifest(folder))
    if trust_code:
        show_trusted(read_manifest(folder), local)
    return load_result(folder, trust_code)


def stored_analysis(folder: Path, trust_code: bool = False, local: bool = False, native: bool = False) -> Loaded:
    """Load a stored result or analysis; arguments as for :func:`stored_result`."""
    if native:
        load_stored_native(description(folder))
    if trust_code:
        show_trusted(description(folder), local)
    return load(folder, trust_code)


def load_stored_native(manifest: Manifest) -> None:
    """Announce and load the native code of a stored study, which must have the digest that the run recorded."""
    table = manifest["study"]
    show_native("result", table)
    load_native(table, [Path(str(manifest.get("source", ""))).parent], manifest.get("code"))


def show_native(subject: str, table: Mapping[str, object]) -> None:
    """Announce the native code that is about to be loaded, with file and digest; arguments as for :func:`show_code`."""
    for native in native_files(table):
        say(f"this {subject} runs {native.text}")


def show_trusted(manifest: Manifest, local: bool) -> None:
    """Announce the code of a stored study that is about to be imported.

    Args:
        manifest: Manifest of the result.
        local: Whether the code may come from the folder of the study file, or from those of the modules that ran.
    """
    if local:
        for folder in (Path(str(manifest.get("source", ""))).parent, *module_folders(manifest.get("code"))):
            allow_imports(folder)
    show_code("result", manifest["study"], manifest.get("code"))


def show_code(subject: str, table: Mapping[str, object], recorded: Manifest | None = None) -> None:
    """Announce the code that is about to be imported, with its files.

    Args:
        subject: What runs the code: a study, a result or a command.
        table: The table that names the code.
        recorded: The code that a stored result ran.
    """
    if names := describe_modules(table, recorded):
        say(f"this {subject} runs code: {names}")


def controller_names(text: str) -> list[str]:
    """Parse controllers from ``A,B,..``, and announce code that is about to be imported for them.

    Raises:
        ConfigError: The names are separated by something other than commas.
    """
    names = [name.strip() for name in text.split(",")]
    if any(set(name) & set("; +&") for name in names):
        suggestion = ",".join(re.split(r"[\s,;+&]+", text.strip()))
        raise ConfigError("--controllers", f"takes names separated by commas; did you mean '{suggestion}'?")
    show_code("command", {"names": names})
    return names


def read_json(path: Path) -> object:
    """Read a JSON file.

    Raises:
        ConfigError: The file cannot be read, or is not plain JSON.
    """
    try:
        return certificate_content(files.read_text(path))
    except (OSError, ValueError) as error:
        raise ConfigError(str(path), f"cannot be read: {error}") from None
