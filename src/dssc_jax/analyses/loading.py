"""Load a folder that any command has written: the result of a run or sweep, or an analysis of any kind."""

import importlib
from pathlib import Path
from typing import TypeAlias

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.json_types import JsonObject
from dssc_jax.results import result as results
from dssc_jax.results.analysis import Analysis
from dssc_jax.results.analysis_folder import read_description
from dssc_jax.results.manifest import MANIFEST, read_manifest
from dssc_jax.results.result import Result

Loaded: TypeAlias = Result | Analysis
KINDS = {
    "margin": "dssc_jax.analyses.margins:Margins",
    "margins": "dssc_jax.analyses.comparison:MarginContest",
    "compare": "dssc_jax.analyses.comparison:Comparison",
    "sensitivity": "dssc_jax.analyses.sensitivity:Sensitivity",
    "probability": "dssc_jax.analyses.probability:FailureProbability",
    "select": "dssc_jax.analyses.selection:Selection",
    "rare": "dssc_jax.analyses.rare_events.rare:RareEvent",
    "falsify": "dssc_jax.analyses.falsification.falsify:Falsified",
    "tune": "dssc_jax.analyses.tuning:Tuned",
    "loop": "dssc_jax.analyses.loop_margins:LoopMargins",
    "laws": "dssc_jax.analyses.laws.law_errors:LawErrors",
    "law-ranges": "dssc_jax.analyses.laws.law_ranges:LawRanges",
    "region": "dssc_jax.analyses.region.safe_region:SafeRegion",
    "compare-log": "dssc_jax.flight_logs.comparison:LogComparison",
    "worst-loop": "dssc_jax.analyses.worst_loop:WorstLoop",
    "next-flight": "dssc_jax.flight_logs.next_flight:NextFlight",
    "worst-wind": "dssc_jax.analyses.worst_wind.worst_wind:WorstWind",
    "theory": "dssc_jax.analyses.theory:Assessment",
}
"""The class of each kind of analysis as ``module:class``, imported when needed."""


def class_of(kind: str) -> type[Analysis]:
    """Import and return the class of a kind of analysis, which is one of :data:`KINDS`."""
    module, name = KINDS[kind].split(":")
    return getattr(importlib.import_module(module), name)


def kind_in(folder: Path) -> str | None:
    """The kind of analysis that a folder contains; None for a run or a sweep.

    Raises:
        ConfigError: The folder does not exist, or contains neither an analysis nor a run nor a sweep.
    """
    if not folder.is_dir():
        raise ConfigError(str(folder), "is no folder")
    if (folder / MANIFEST).exists():
        return None
    for kind in KINDS:
        if (folder / f"{kind}.json").exists():
            return kind
    names = " or ".join(f"{name}.json" for name in KINDS)
    other_files = sorted(file.name for file in folder.glob("*.json"))
    remark = ""
    if other_files:
        remark = f"; what it has is plain JSON: {', '.join(other_files)}"
    raise ConfigError(str(folder), f"is not a results folder: it has no {MANIFEST} or {names}{remark}")


def description(folder: Path) -> JsonObject:
    """The description of a folder's content: the manifest of a result, or the description of an analysis.

    Raises:
        ConfigError: The folder contains nothing that :func:`load` can read, or it is damaged.
    """
    kind = kind_in(folder)
    if kind is None:
        return read_manifest(folder)
    return read_description(folder, kind)


def load(folder: str | Path, trust_code: bool = False) -> Loaded:
    """Load a folder written by a command, or by ``save`` of a result or an analysis.

    Args:
        folder: The folder. No code in it is run, see docs/trust.md.
        trust_code: Import the models that the stored study names as ``module:object``. They are needed only to simulate
            again: for :func:`dssc_jax.replay`, :func:`dssc_jax.verify`, or any change of the study.

    Returns:
        A :class:`Result` for ``run`` and ``sweep``, else an :class:`Analysis`, equal to the one saved.

    Raises:
        ConfigError: The folder contains no result and no analysis, it is damaged, or its run did not finish.
    """
    path = Path(folder)
    kind = kind_in(path)
    if kind is None:
        return results.load_result(path, trust_code)
    return class_of(kind).load(path, trust_code)
