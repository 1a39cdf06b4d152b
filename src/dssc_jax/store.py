"""Results on disk: a Zarr store read with xarray, manifest.json and summary.json in one folder.

The store is laid out in full first and filled block by block, each block being one chunk of every variable. The
chunk of ``outcome`` is written last: where it exists, the block is complete.
"""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr
import zarr

from dssc_jax.dataset import NOT_COMPUTED, Variable, coordinate_values, coordinates, variables
from dssc_jax.engine import Arrays, Layout
from dssc_jax.errors import ConfigError
from dssc_jax.study import Study

SCHEMA = 1
DATA, MANIFEST, SUMMARY = "data.zarr", "manifest.json", "summary.json"


def write_json(path: Path, content: Any) -> None:
    """Replace a JSON file in one move, so that a reader never sees half of it."""
    partial = path.with_suffix(".partial")
    partial.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
    os.replace(partial, path)


def require_place(path: Path, study: Study) -> None:
    """Require that an answer of the study may be written.

    Raises:
        ConfigError: the file holds something else, or its folder is a file.
    """
    if path.parent.exists() and not path.parent.is_dir():
        raise ConfigError(str(path.parent), "is a file, not a results folder; nothing was written")
    if path.exists():
        try:
            same = json.loads(path.read_text(encoding="utf-8"))["hash"] == study.hash
        except (ValueError, KeyError, TypeError):
            same = False
        if not same:
            raise ConfigError(str(path), "holds the answer to another study; choose another --out, nothing was written")


def write_answer(path: Path, content: dict[str, Any], study: Study) -> None:
    """Write an analysis that has no dataset, with the study that it is of.

    Args:
        path: A JSON file that :func:`require_place` has passed; its folder is made when absent.
        content: The answer.
        study: What it answers for.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, {**content, "hash": study.hash, "source": study.source, "inputs": study.table})


def read_manifest(folder: Path) -> dict[str, Any]:
    """The manifest of a results folder.

    Raises:
        ConfigError: there is none, it is damaged, or it is of another schema version.
    """
    path = folder / MANIFEST
    try:
        manifest = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(
            str(folder), f"is not a results folder: {MANIFEST} cannot be read ({error.strerror})"
        ) from error
    except (ValueError, RecursionError) as error:
        raise ConfigError(str(path), f"is damaged, not valid JSON: {error}") from error
    if not isinstance(manifest, dict) or not {"schema", "study", "hash", "layout"} <= manifest.keys():
        raise ConfigError(str(path), "is damaged: schema, study, hash or layout is missing")
    if not isinstance(manifest["study"], dict) or not isinstance(manifest["layout"], dict):
        raise ConfigError(str(path), "is damaged: study and layout must be tables")
    if manifest["schema"] != SCHEMA:
        raise ConfigError(str(path), f"has schema version {manifest['schema']!r}, this program reads {SCHEMA}")
    return manifest


def stored_layout(folder: Path, study: Study, manifest: dict[str, Any]) -> Layout:
    """The layout that a manifest tells, checked against its study.

    Raises:
        ConfigError: they do not fit, or the study is not the one that was hashed.
    """
    place = str(folder / MANIFEST)
    if manifest["hash"] != study.hash:
        raise ConfigError(place, "is damaged: the study is not the one that its hash was taken of")
    shape, block = (manifest["layout"].get(name) for name in ("shape", "block"))
    sizes = [value for part in (shape, block) if isinstance(part, list) for value in part]
    whole = all(isinstance(value, int) and value > 0 for value in sizes)
    if not whole or shape != list(Layout.of(study).shape) or not isinstance(block, list) or len(block) != len(shape):
        raise ConfigError(place, f"is damaged: the layout {manifest['layout']} does not fit the study")
    return Layout.from_dict(manifest["layout"])


def differences(old: Any, new: Any, path: str = "") -> list[str]:
    """Where two studies differ, a line each."""
    if isinstance(old, dict) and isinstance(new, dict):
        found = []
        for name in sorted(old.keys() | new.keys()):
            found += differences(old.get(name), new.get(name), f"{path}.{name}" if path else name)
        return found
    return [] if old == new else [f"{path}: {old!r} there, {new!r} here"]


class Store:
    """A results folder being filled.

    Args:
        folder: Where; made when absent.
        study: The study as run.
        layout: Its blocks; a resumed run keeps those it began with.
        manifest: What manifest.json says until the run is complete.
        resume: Keep the blocks that an earlier run of the same study finished.

    Raises:
        ConfigError: the folder holds another study's results, or something that is no result.
    """

    def __init__(
        self, folder: Path, study: Study, layout: Layout, manifest: dict[str, Any], resume: bool = False
    ) -> None:
        self.folder, self.study, self.layout = folder, study, layout
        occupied = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
        if occupied:
            self._require_same_study(resume)
        if occupied and resume:
            self.layout = stored_layout(folder, study, read_manifest(folder))
            self.group = open_group(folder, mode="a")
            if all(name in self.group for name in variables(study)):
                return
        folder.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(folder / DATA, ignore_errors=True)
        (folder / SUMMARY).unlink(missing_ok=True)
        self.layout = layout
        write_json(folder / MANIFEST, manifest)  # before the data, so that an interrupted run is known as one
        self.group = lay_out(folder, study, layout)

    def _require_same_study(self, resume: bool) -> None:
        if not self.folder.is_dir():
            raise ConfigError(str(self.folder), "is a file, not a results folder; nothing was written")
        manifest = read_manifest(self.folder)
        if manifest["hash"] != self.study.hash:
            differing = differences(manifest["study"], self.study.table)
            differing = differing or ["its hash differs"]
            shown = "; ".join(differing[:3]) + (f"; and {len(differing) - 3} more" if len(differing) > 3 else "")
            if self.study.config.sampling == "lhs" and [text.partition(":")[0] for text in differing] == ["draws"]:
                shown += "; a Latin hypercube cannot be extended"
            raise ConfigError(
                str(self.folder), f"holds results of another study ({shown}); choose another --out, nothing was written"
            )
        if resume and manifest.get("stopping"):
            raise ConfigError(str(self.folder), "ended where its draws decided; that cannot be resumed, start over")

    def pending(self) -> list[tuple[slice, ...]]:
        """Blocks that are not complete yet."""
        return [block for block in self.layout.blocks() if not self._chunk("outcome", block).exists()]

    def _chunk(self, name: str, block: tuple[slice, ...]) -> Path:
        index = [str(part.start // size) for part, size in zip(block, self.layout.block, strict=True)]
        return self.folder / DATA / name / "c" / Path(*index)

    def write(self, block: tuple[slice, ...], results: Arrays, drawn: Arrays) -> None:
        """Write a block; ``outcome`` last. Chunks of NaN are written like others, since presence has a meaning."""
        with zarr.config.set({"array.write_empty_chunks": True}):
            if all(part.start == 0 for part in block[:-1]):
                for name, values in drawn.items():
                    self.group[name][block[-1]] = values  # type: ignore[index]
            for name in variables(self.study):
                if name in results:
                    self.group[name][block] = results[name]  # type: ignore[index]


def lay_out(folder: Path, study: Study, layout: Layout) -> zarr.Group:
    """Every array of the store, empty."""
    group = zarr.open_group(folder / DATA, mode="w", attributes={"title": study.name, "source": "dssc_jax"})
    for name, values in coordinate_values(study).items():
        array = create(group, name, coordinates(study)[name], values.shape, values.shape)
        array[...] = values
    for name, variable in variables(study).items():
        drawn = variable.dims == ("draw",)
        shape = layout.shape[-1:] if drawn else layout.shape
        create(group, name, variable, shape, layout.block[-1:] if drawn else layout.block)
    return group


def create(
    group: zarr.Group, name: str, variable: Variable, shape: tuple[int, ...], chunks: tuple[int, ...]
) -> zarr.Array:
    """One array with its dimensions and attributes."""
    return group.create_array(
        name,
        shape=shape,
        chunks=chunks,
        dtype=variable.dtype,
        fill_value=np.nan if variable.dtype.startswith("float") else NOT_COMPUTED,
        dimension_names=variable.dims,
        attributes=dict(variable.attributes),
    )


def open_group(folder: Path, mode: str) -> zarr.Group:
    """The folder's Zarr group.

    Raises:
        ConfigError: it is absent or damaged.
    """
    try:
        return zarr.open_group(folder / DATA, mode=mode)  # type: ignore[arg-type]
    except Exception as error:  # zarr has no common base class of its errors
        raise ConfigError(str(folder / DATA), f"cannot be opened: {one_line(error)}") from error


def one_line(error: BaseException) -> str:
    """An exception's message without its line breaks."""
    return " ".join(str(error).split()) or type(error).__name__


def read(folder: Path) -> tuple[Study, xr.Dataset, dict[str, Any]]:
    """Study, dataset and manifest of a results folder.

    Raises:
        ConfigError: it is no results folder, it is damaged, or its run did not finish.
    """
    manifest = read_manifest(folder)
    study = Study.from_table(manifest["study"], str(folder / MANIFEST))
    layout = stored_layout(folder, study, manifest)
    try:
        dataset = xr.open_zarr(folder / DATA, consolidated=False, chunks=None).load()
    except Exception as error:  # zarr, its codecs and xarray raise errors of many kinds
        raise ConfigError(str(folder / DATA), f"is damaged: {one_line(error)}") from error
    missing = [name for name in (*coordinates(study), *variables(study)) if name not in dataset.variables]
    if missing:
        raise ConfigError(str(folder / DATA), f"is damaged: {', '.join(missing)} missing")
    sizes = {name: len(values) for name, values in coordinate_values(study).items()}
    if dict(dataset.sizes) != sizes:
        raise ConfigError(str(folder / DATA), f"is damaged: its dimensions are {dict(dataset.sizes)}, not {sizes}")
    unfinished = int(np.count_nonzero(dataset["outcome"].values == NOT_COMPUTED))
    if unfinished:
        total = dataset["outcome"].size
        raise ConfigError(
            str(folder), f"is not complete: {unfinished} of {total} lanes are missing; finish with --resume"
        )
    require_all_chunks(folder, study, layout)
    return study, dataset[list(variables(study))], manifest


def require_all_chunks(folder: Path, study: Study, layout: Layout) -> None:
    """Every chunk file is there: an absent one would read as NaN without a word.

    Raises:
        ConfigError: otherwise.
    """
    blocks = len(layout.blocks())
    along_draws = -(-layout.shape[-1] // layout.block[-1])
    for name, variable in variables(study).items():
        expected = along_draws if variable.dims == ("draw",) else blocks
        found = sum(1 for file in (folder / DATA / name / "c").rglob("*") if file.is_file())
        if found < expected:
            raise ConfigError(str(folder / DATA / name), f"is damaged: {expected - found} of {expected} chunks missing")
