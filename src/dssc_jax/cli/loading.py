"""Load the study or the stored result of a command, and announce each piece of code that loading it will run."""

import os
import re
from collections.abc import Mapping
from pathlib import Path

from dssc_jax.analyses.loading import Loaded, description, load
from dssc_jax.cli.declarations.types import DrawsOptions, SeededOptions, StudyOptions
from dssc_jax.cli.output import say
from dssc_jax.cli.parsing import parse_changes
from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError, errors_in_file
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

WRONG_SEPARATORS = frozenset("; +&")
"""Characters that users type between the names of controllers in place of commas."""


def study_of(options: StudyOptions) -> Study:
    """Load the study of a command, with the changes that the options request.

    Raises:
        ConfigError: The study is not valid, or both an option and ``--set`` give ``draws`` or ``seed``.
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

    Raises:
        ConfigError: There is no such study, it is not valid, or its code cannot be loaded; the message names the file.
    """
    path = find_study(name)
    if local:
        allow_imports(path.parent)
    changed_table = with_changes(read_toml(path), changes, str(path))
    with errors_in_file(str(path)):
        table = with_files(changed_table, path.parent)
    if native:
        announce_native("study", table)
        load_native(table, [path.parent])
    announce_code("study", table)
    return Study.from_table(table, str(path))


def spare_gpu_memory() -> None:
    """Keep JAX from reserving a GPU's memory, so that a worker on the same GPU can have it.

    It has no effect once JAX has started. Therefore call it before a study is loaded.
    """
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")


def stored_result(folder: Path, trust_code: bool, local: bool, native: bool) -> Result:
    """Load a stored result, which may come from an untrusted source.

    Args:
        folder: The results folder.
        trust_code: Whether to import the code that the study names, after announcing it.
        local: Whether trusted code may be imported from local folders, see :func:`trust_stored_code`.
        native: Whether to load the shared objects that the study names, after announcing them.

    Raises:
        ConfigError: The folder holds no readable result, or its code cannot be loaded.
    """
    if native:
        load_stored_native(read_manifest(folder))
    if trust_code:
        trust_stored_code(read_manifest(folder), local)
    return load_result(folder, trust_code)


def stored_analysis(folder: Path, trust_code: bool = False, local: bool = False, native: bool = False) -> Loaded:
    """Load a stored result or analysis; arguments and errors as for :func:`stored_result`."""
    if native:
        load_stored_native(description(folder))
    if trust_code:
        trust_stored_code(description(folder), local)
    return load(folder, trust_code)


def load_stored_native(manifest: Manifest) -> None:
    """Announce and load the native code of a stored study.

    Raises:
        ConfigError: A file is not found, has another digest than the run recorded, or cannot be loaded.
    """
    table = manifest["study"]
    announce_native("result", table)
    load_native(table, [Path(str(manifest.get("source", ""))).parent], manifest.get("code"))


def announce_native(subject: str, table: Mapping[str, object]) -> None:
    """Announce the native code that will be loaded, with file and digest; arguments as for :func:`announce_code`."""
    for native in native_files(table):
        say(f"this {subject} runs {native.text}")


def trust_stored_code(manifest: Manifest, local: bool) -> None:
    """Announce the code that a stored study will import, and let it come from local folders if requested.

    Args:
        manifest: Manifest of the result.
        local: Whether the code may come from the folder of the study file, and from those of the modules that ran.
    """
    recorded = manifest.get("code")
    if local:
        study_folder = Path(str(manifest.get("source", ""))).parent
        for folder in (study_folder, *module_folders(recorded)):
            allow_imports(folder)
    announce_code("result", manifest["study"], recorded)


def announce_code(subject: str, table: Mapping[str, object], recorded: Manifest | None = None) -> None:
    """Announce the code that will be imported, with its files; nothing is printed if there is none.

    Args:
        subject: Who runs the code, for the message: ``study``, ``result`` or ``command``.
        table: The table that names the code.
        recorded: The code that a stored result ran; None for a new study.
    """
    description_of_code = describe_modules(table, recorded)
    if description_of_code:
        say(f"this {subject} runs code: {description_of_code}")


def controller_names(text: str) -> list[str]:
    """Parse the names of controllers from ``A,B,..``, and announce the code that will be imported for them.

    Raises:
        ConfigError: The names are separated by something other than commas.
    """
    names = [name.strip() for name in text.split(",")]
    for name in names:
        if WRONG_SEPARATORS.intersection(name):
            suggestion = ",".join(re.split(r"[\s,;+&]+", text.strip()))
            raise ConfigError("--controllers", f"takes names separated by commas; did you mean '{suggestion}'?")
    announce_code("command", {"names": names})
    return names


def read_json(path: Path) -> object:
    """Read a file of certificates as JSON, by the strict rules of :func:`certificate_content`.

    Raises:
        ConfigError: The file cannot be read, or breaks these rules.
    """
    try:
        return certificate_content(files.read_text(path))
    except (OSError, ValueError) as error:
        raise ConfigError(str(path), f"cannot be read: {error}") from None
