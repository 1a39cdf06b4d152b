"""Imports go one way, down the list of docs/architecture.md; and the architecture's other promises."""

import ast
import re
from pathlib import Path

import pytest

import dssc_jax

ROOT = Path(dssc_jax.__file__).parent
CHECKOUT = Path(__file__).parents[1]
PAGE = (CHECKOUT / "docs" / "architecture.md").read_text()
LAYERS = re.findall(r"^    (\w+) {2,}\S", PAGE[PAGE.index("## Layers") : PAGE.index("## Where to find")], re.MULTILINE)
"""The folders of the package, top to bottom."""

RANK = {name: rank for rank, name in enumerate(reversed(LAYERS))}
EDGE = {"backend", "cache", "cli", "console", "exploration", "plotting", "report", "results", "study"}
"""Layers that may read and write files; the simulator and the statistics may not."""

FILES = sorted(ROOT.rglob("*.py"))


def layer(path):
    """The layer that a file belongs to; None for the modules at the package's root."""
    parts = path.relative_to(ROOT).parts
    return parts[0] if len(parts) > 1 else None


def models(path):
    """Which kind of model a file belongs to."""
    return path.relative_to(ROOT).parts[1] if layer(path) == "models" else None


def imported(path):
    """Layers that a file imports, and which part of them, at any level but under TYPE_CHECKING."""
    tree = ast.parse(path.read_text())
    skipped = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        names = []
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("dssc_jax"):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        for name in names:
            parts = name.split(".")
            if parts[0] == "dssc_jax" and len(parts) > 2:
                yield parts[1], parts[2]


def test_every_folder_is_a_layer():
    assert {layer(path) for path in FILES} - {None} == set(LAYERS)
    assert {path.name for path in FILES if layer(path) is None} == {"__init__.py", "types.py"}


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_down(path):
    here = layer(path)
    if here is None:
        return
    for there, part in imported(path):
        if there == "types":
            raise AssertionError(f"{path} imports the user's module of types")
        if there in RANK and there != here:
            assert RANK[there] < RANK[here], f"{here} imports {there}"
        if there == here == "models":
            assert part == models(path), f"{path} imports its sibling {part}"


def test_places_that_the_architecture_names_exist():
    named = re.findall(r"`(\w+/[\w/]*(?:\.py)?)`", PAGE[PAGE.index("## Where to find") :])
    assert len(named) > 15
    assert [name for name in named if not (ROOT / name).exists() and not (CHECKOUT / name).exists()] == []


def test_modules_stay_short():
    """Those of tests and benchmarks too."""
    beside = [file for folder in ("tests", "benchmarks") for file in (CHECKOUT / folder).rglob("*.py")]
    assert len(beside) > 50
    assert [str(file) for file in (*FILES, *beside) if len(file.read_text().splitlines()) > 400] == []


def test_models_do_not_batch():
    """vmap, jit and map belong to the engine."""
    for path in FILES:
        if layer(path) == "models":
            text = path.read_text()
            assert not any(word in text for word in ("jax.vmap", "jax.jit", "lax.map", "pmap", "shard_map")), path


def test_only_the_edge_touches_files():
    for path in FILES:
        if layer(path) not in EDGE:
            assert not any(word in path.read_text() for word in ("open(", "write_text", "print(")), path


ODD = {
    "told",
    "found",
    "asked",
    "beside",
    "silent",
    "shared",
    "marching",
    "probing",
    "telling",
    "way",
    "probe",
    "meant",
}
"""Words that say nothing, or too much, as names."""

CONTRACTS = {
    "init",
    "step",
    "measure",
    "derivative",
    "prepare",
    "output",
    "input_gain",
    "explicit_update",
    "implicit_update",
    "Update",
    "explicit_carried",
    "implicit_carried",
    "Carried",
    "transfer",
}
"""What every model of a kind has."""

FIGURES = {"loop_margins", "margin", "region", "sensitivity", "rare"}
"""What `plotting` names as the analysis that it draws."""

SAME = {"write", "SOCCER_FIELD"}
"""Of one meaning in two places: figures and pages are written; a mission is listed."""


def names_in(tree):
    """Names that code gives to things: definitions, arguments, variables, fields."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg


def test_names_are_words_of_the_field():
    """docs/glossary.md has them."""
    for path in FILES:
        for name in names_in(ast.parse(path.read_text())):
            assert not set(re.findall(r"[a-z]+", name.lower())) & ODD, f"{path}: {name}"


def test_a_public_name_has_one_meaning():
    """Commands are named as what they run; controllers are written to one pattern."""
    homes = {}
    for path in FILES:
        if layer(path) == "cli":
            continue
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                names = [node.name]
            else:
                assigned = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", None)]
                names = [target.id for target in assigned if isinstance(target, ast.Name)]
            for name in names:
                if not name.startswith("_"):
                    homes.setdefault(name, set()).add(path.relative_to(ROOT))
    several = {name: paths for name, paths in homes.items() if len(paths) > 1}
    assert several.keys() == CONTRACTS | FIGURES | SAME
