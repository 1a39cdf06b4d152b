"""The manifest of a run: writing, reading with validation, and comparison with a run that resumes it."""

import json
from pathlib import Path
from typing import TypeAlias

from dssc_jax.core import files
from dssc_jax.core.errors import ConfigError, errors_in_file
from dssc_jax.core.files import PARTIAL
from dssc_jax.core.json_types import JsonObject
from dssc_jax.engine.batching import Layout
from dssc_jax.results import lock
from dssc_jax.results.theorem import theorem_mark
from dssc_jax.statistics import Look
from dssc_jax.study import Described, Study, hash_of
from dssc_jax.study.code import code_digests
from dssc_jax.study.described import describe_study
from dssc_jax.study.laws import is_number
from dssc_jax.study.tables import require_shallow

Manifest: TypeAlias = JsonObject
"""Content of a manifest.json; its fields are checked when it is read."""

SCHEMA = 3
"""Version of the folder of a run or an analysis; folders of other versions are refused."""

REMEDY = "use the dssc_jax that wrote it, or run its study again into another `out`"
SEAL = "digest"
"""Entry of a JSON file with the digest of its other entries."""
DATA = "data.zarr"
MANIFEST = "manifest.json"
SUMMARY = "summary.json"
MANIFEST_TABLES = ("study", "layout", "versions", "device", "times")
"""Entries that every manifest has, each a table."""
TIME_FIELDS = ("seconds", "compile_seconds", "rate")
"""Fields of the table ``times`` of a finished run."""

OPTIONAL_TABLES = {
    "stopping": ("rule", "most", "verdict", "looks", "stops"),
    "cluster": ("workers", "lost"),
    "design": ("reason", "pilot", "asked", "asked_draws"),
}
"""Tables that a manifest may have, and their fields."""
NUMERICAL_PACKAGES = ("dssc_jax", "jax", "jaxlib", "numpy", "scipy")
"""Packages whose version may change a result in its last digits."""

EXTENSIBLE = ("random", "sobol")
"""Kinds of sampling in which draw i does not depend on the number of draws."""


def write_json(path: Path, content: object, within: Path | None = None, durable: bool = True) -> None:
    """Write a JSON file completely or not at all; raises the errors of :func:`dssc_jax.core.files.replacing`.

    Args:
        path: The file.
        content: Content of the file.
        within: Folder below which no part of the path may be a symbolic link; None: only the file itself must be none.
        durable: Whether to flush file and folder to disk, so that not even a power cut leaves a partial file.
    """
    files.write_text(path, [json.dumps(content, indent=2), "\n"], within, durable)


def write_sealed(path: Path, content: dict[str, object]) -> None:
    """Write a JSON file with a digest of its content, which :func:`unseal` checks."""
    write_json(path, content | {SEAL: hash_of(content)})


def unseal(path: Path, content: object) -> JsonObject:
    """Check the content of a file that :func:`write_sealed` wrote, and return it without its digest.

    Args:
        path: The file, for messages.
        content: Content of the file.

    Raises:
        ConfigError: The content has another schema version or none, or does not match its digest.
    """
    if not isinstance(content, dict) or "schema" not in content:
        raise ConfigError(str(path), f"is damaged, or of another version: it has no schema version; {REMEDY}")
    if content["schema"] != SCHEMA:
        rule = f"has schema version {content['schema']!r}, this program reads {SCHEMA}; {REMEDY}"
        raise ConfigError(str(path), rule)
    unsealed_content = dict(content)
    seal = unsealed_content.pop(SEAL, None)
    if seal != hash_of(unsealed_content):
        raise ConfigError(str(path), "is damaged: its content does not match its digest")
    return unsealed_content


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write manifest.json with a digest of itself."""
    write_sealed(folder / MANIFEST, manifest)


def read_manifest(folder: Path) -> Manifest:
    """Read and check the manifest of a results folder.

    Raises:
        ConfigError: There is no manifest, it is damaged, or it has another schema version.
    """
    path = folder / MANIFEST
    try:
        manifest = json.loads(files.read_text(path))
    except OSError as error:
        kinds = sorted(file.stem for file in folder.glob("*.json") if file.name != SUMMARY)
        holds_analysis = kinds and (folder / DATA).exists()
        hint = f"; it holds what `{kinds[0]}` wrote, which dj.load reads" if holds_analysis else ""
        rule = f"is not a results folder: {MANIFEST} cannot be read ({error.strerror}){hint}"
        raise ConfigError(str(folder), rule) from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(str(path), f"is damaged, not valid JSON: {error}") from error
    manifest = unseal(path, manifest)
    for name in MANIFEST_TABLES:
        if not isinstance(manifest.get(name), dict):
            raise ConfigError(str(path), f"is damaged: {name} is not a table")
    require_valid_fields(path, manifest)
    with errors_in_file(str(path)):
        require_shallow(manifest["study"])
    if manifest.get("hash") != hash_of(manifest["study"]):
        raise ConfigError(str(path), "is damaged: its study does not match its hash")
    return manifest


def require_valid_fields(path: Path, manifest: Manifest) -> None:
    """Refuse a manifest in which a field that a summary reads is missing or of another type; the study is not checked.

    Args:
        path: File of the manifest, for messages.
        manifest: Content of the manifest.

    Raises:
        ConfigError: A field is not valid; the message has the field and the rule.
    """
    for name, value in manifest["times"].items():
        if not is_number(value):
            raise ConfigError(str(path), f"is damaged: times.{name} must be a number, got {value!r}")
    if manifest.get("complete"):
        require_fields(path, "times", manifest["times"], TIME_FIELDS)
    for name, fields in OPTIONAL_TABLES.items():
        if manifest.get(name) is not None:
            require_fields(path, name, manifest[name], fields)
    code = manifest.get("code", {})
    if not isinstance(code, dict) or not all(isinstance(module, dict) for module in code.values()):
        raise ConfigError(str(path), f"is damaged: code must be a table of tables, got {code!r}")
    stopping = manifest.get("stopping")
    if stopping:
        require_looks(path, stopping["looks"], stopping["stops"])


def require_looks(path: Path, looks: object, stops: object) -> None:
    """Refuse a manifest whose looks of a stopping rule are not valid.

    Args:
        path: File of the manifest, for messages.
        looks: The looks that were taken, each with its number of draws, its thresholds and its failures.
        stops: Largest possible number of looks.

    Raises:
        ConfigError: A look, or the number of looks, is not valid.
    """
    if not isinstance(looks, list) or not looks or not isinstance(stops, int) or stops < len(looks):
        rule = f"is damaged: stopping must have one or more looks and at most `stops`, got {looks!r} and {stops!r}"
        raise ConfigError(str(path), rule)
    for look in looks:
        require_fields(path, "stopping.looks", look, (*Look._fields, "failures"))
        if not all(isinstance(count, int) for count in look.values()):
            raise ConfigError(str(path), f"is damaged: stopping.looks must have whole numbers, got {look!r}")


def require_fields(path: Path, name: str, table: object, fields: tuple[str, ...]) -> None:
    """Refuse an entry of a manifest that is not a table with certain fields.

    Args:
        path: File of the manifest, for messages.
        name: Name of the entry.
        table: Content of the entry.
        fields: Names of the required fields.

    Raises:
        ConfigError: The entry is not a table, or lacks a field.
    """
    if not isinstance(table, dict) or not table.keys() >= set(fields):
        raise ConfigError(str(path), f"is damaged: {name} must be a table with {', '.join(fields)}, got {table!r}")


def stored_layout(folder: Path, study: Study, manifest: Manifest, draws: int | None = None) -> Layout:
    """The layout of a study's grid, with the shape of blocks that a manifest states.

    Args:
        folder: The results folder, for messages.
        study: The study, which may have more draws than the study in the manifest.
        manifest: The manifest.
        draws: Number of draws of the study in the manifest; None: as many as ``study`` has.

    Raises:
        ConfigError: The layout in the manifest does not match the manifest's study.
    """
    grid = Layout.of(study).shape
    expected_shape = [*grid[:-1], grid[-1] if draws is None else draws]
    shape = manifest["layout"].get("shape")
    block = manifest["layout"].get("block")
    is_valid = is_list_of_counts(shape) and is_list_of_counts(block)
    if not is_valid or shape != expected_shape or len(block) != len(expected_shape):
        raise ConfigError(str(folder / MANIFEST), f"is damaged: the layout {manifest['layout']} does not fit the study")
    return Layout(grid, tuple(block))


def is_list_of_counts(value: object) -> bool:
    """Whether a value from a JSON file is a list of positive whole numbers."""
    if not isinstance(value, list):
        return False
    return all(isinstance(count, int) and not isinstance(count, bool) and count > 0 for count in value)


def differences(stored: object, present: object, path: str = "") -> list[str]:
    """Describe the differences between two nested tables, in one line for each value that differs.

    Args:
        stored: The stored table or value.
        present: The present table or value.
        path: Dotted name under which both stand; empty for the outermost tables.
    """
    if isinstance(stored, dict) and isinstance(present, dict):
        lines = []
        for name in sorted(stored.keys() | present.keys()):
            lines += differences(stored.get(name), present.get(name), f"{path}.{name}" if path else name)
        return lines
    return [] if stored == present else [f"{path}: {stored!r} there, {present!r} here"]


def listed(lines: list[str], limit: int = 3) -> str:
    """The first ``limit`` lines in one line, followed by the number of the others."""
    parts = lines[:limit]
    if len(lines) > limit:
        parts.append(f"and {len(lines) - limit} more")
    return "; ".join(parts)


def is_occupied(folder: Path) -> bool:
    """Whether a folder holds anything besides the files that an aborted start leaves: locks and temporary files.

    Raises:
        ConfigError: The path leads to a file.
    """
    if not folder.exists():
        return False
    if not folder.is_dir():
        raise ConfigError(str(folder), "is a file, not a results folder; nothing was written")
    return any(file.name not in (lock.LOCK, lock.HOLDER) and file.suffix != PARTIAL for file in folder.iterdir())


def require_startable(folder: Path, study: Study, resume: bool) -> None:
    """Refuse a folder into which a study must not be run, before anything is changed.

    Args:
        folder: The folder, which may be absent.
        study: The study to run.
        resume: Whether the run resumes the run of the folder.

    Raises:
        ConfigError: The folder holds results of another study or something else, such as a symbolic link.
    """
    if folder.is_dir():
        files.require_plain_tree(folder)
    if is_occupied(folder):
        require_same_study(folder, read_manifest(folder), study, resume)


def require_same_study(folder: Path, manifest: Manifest, study: Study, resume: bool) -> None:
    """Refuse a folder with the results of another study; a run that resumes the folder may ask for more draws.

    Args:
        folder: The folder, for messages.
        manifest: Manifest of the folder.
        study: The study to run.
        resume: Whether the run resumes the run of the folder.

    Raises:
        ConfigError: The study is different (the message gives the differences), or draws cannot be added.
    """
    if resume and manifest.get("stopping"):
        rule = "ended by a stopping rule that depends on its draws, so it cannot be resumed"
        raise ConfigError(str(folder), f"{rule}; start over")
    if manifest["hash"] == study.hash:
        return
    stored_table = manifest["study"]
    if not asks_for_more_draws(manifest, study):
        lines = listed(differences(stored_table, study.table))
        raise ConfigError(
            str(folder), f"holds results of another study ({lines}); choose another `out`, nothing was written"
        )
    draws = stored_table.get("draws", 1)
    requested_draws = study.config.draws
    if study.config.sampling not in EXTENSIBLE:
        raise ConfigError(
            str(folder),
            f"holds {draws} draws of '{study.config.sampling}' sampling, which depend on their number: "
            f"{requested_draws} of them are another set; choose another `out`, nothing was written",
        )
    if not resume:
        raise ConfigError(
            str(folder),
            f"holds {draws} draws of this study; add {requested_draws - draws} with `resume`, or choose another `out`, "
            "nothing was written",
        )


def asks_for_more_draws(manifest: Manifest, study: Study) -> bool:
    """Whether a study differs from a manifest's study only by a larger number of draws."""
    if manifest["hash"] == study.hash:
        return False
    stored_table = manifest["study"]
    draws = stored_table.get("draws", 1)
    lines = differences(stored_table, study.table)
    only_draws_differ = len(lines) == 1 and lines[0].startswith("draws:")
    return only_draws_differ and isinstance(draws, int) and study.config.draws > draws


def code_entries(study: Study) -> Manifest:
    """Entries of a manifest about a study's own code: files, digests, and a description for readers without the code.

    The result is empty for a study that uses only models of the package.
    """
    if isinstance(study, Described):
        return {"code": study.code, "described": study.description.model_dump(mode="json")}
    code = code_digests(study.table)
    if not code:
        return {}
    certified, reason = theorem_mark(study) or (None, "")
    return {"code": code, "described": describe_study(study, certified, reason)}


def machinery_differences(stored: Manifest, present: Manifest) -> list[str]:
    """Describe differences between two manifests that may change the last digits of a result, in a line each.

    The lines concern versions of numerical packages, device, compiler settings and the user's code. A file of code that
    the stored manifest does not name counts as no difference: older manifests lack the modules that a user's modules
    import.
    """
    known_code = {name: module for name, module in present.get("code", {}).items() if name in stored.get("code", {})}
    return differences(machinery(stored), machinery({**present, "code": known_code}))


def machinery(manifest: Manifest) -> dict[str, object]:
    """The entries of a manifest that may change the last digits of a result, for a comparison."""
    versions = manifest.get("versions", {})
    return {
        "versions": {name: versions.get(name) for name in NUMERICAL_PACKAGES},
        "device": manifest.get("device", {}).get("kind"),
        "compiler": manifest.get("compiler"),
        "code": {name: module.get("sha256") for name, module in manifest.get("code", {}).items()},
    }


def require_same_machinery(folder: Path, stored: Manifest, present: Manifest) -> None:
    """Refuse to continue a run with other versions, device, compiler settings or code than the run began with.

    Args:
        folder: The results folder, for messages.
        stored: Manifest of the run that began.
        present: Manifest of the run that resumes it.

    Raises:
        ConfigError: One of these differs, so that rounding may differ.
    """
    lines = machinery_differences(stored, present)
    if lines:
        raise ConfigError(
            str(folder),
            f"was begun otherwise ({listed(lines)}), and its rest would not be bit-identical; go on as it was begun, "
            "or start over without `resume`, nothing was written",
        )
