"""Imports go one way, down the list of docs/architecture.md; and the architecture's other promises."""

import ast
import re
from pathlib import Path

import pytest

import dssc_jax

ROOT = Path(dssc_jax.__file__).parent
CHECKOUT = Path(__file__).parents[1]
LAYERS = [
    {"xla", "errors", "fusion"},
    {"types"},
    {"tracking", "numerics", "vectors", "zero_dynamics", "integrators", "marching"},
    {"plants", "uav", "environment", "controllers", "unmodelled", "design"},
    {"metrics"},
    {"performance", "requirements"},
    {"loop"},
    {"simulation"},
    {"study"},
    {"sampling", "certification", "kernels"},
    {"engine", "statistics"},
    {"global_sensitivity", "rare_events"},
    {"dataset", "lock", "manifest"},
    {"chunks"},
    {"store"},
    {"results", "cluster", "analysis", "probing"},
    {"plotting", "running", "trajectories", "margins", "verification", "exports"},
    {"theory", "falsification"},
    {"comparison", "report", "tuning"},
    {"stopping", "loading"},
    {"console"},
    {"design_tables"},
    {"cli"},
]
RANK = {name: rank for rank, layer in enumerate(LAYERS) for name in layer}
MODELS = {"plants", "uav", "environment", "controllers", "unmodelled", "design"}
EDGE = {
    "exports",
    "lock",
    "manifest",
    "store",
    "analysis",
    "plotting",
    "report",
    "console",
    "design_tables",
    "cli",
    "study",
    "xla",  # reads the processor's name, by which compiled programs are kept
}
EDGE |= {"__init__"}
FILES = sorted(ROOT.rglob("*.py"))


def unit(path):
    """The layer's unit that a file belongs to."""
    return path.relative_to(ROOT).parts[0].removesuffix(".py")


def imported(path):
    """Units of this package that a file imports, at any level but under TYPE_CHECKING."""
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
            if parts[0] == "dssc_jax" and len(parts) > 1:
                yield parts[1]


def test_every_unit_has_its_layer():
    assert {unit(path) for path in FILES} - {"__init__"} == set(RANK)


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_down(path):
    here = unit(path)
    if here == "__init__":
        return
    for there in imported(path):
        if there == here or there not in RANK:
            continue
        assert RANK[there] < RANK[here], f"{here} imports {there}"
        assert not (here in MODELS and there in MODELS), f"{here} imports its sibling {there}"


def test_the_architecture_names_every_module():
    """One row each; and no module that is gone."""
    page = (CHECKOUT / "docs" / "architecture.md").read_text()
    rows = re.findall(r"^\| `(\S+(?:\.py|/))` \| \S", page, re.MULTILINE)
    modules = [str(path.relative_to(ROOT)).replace("__init__.py", "") for path in FILES]
    assert sorted(rows) == sorted(name for name in modules if name)


def test_modules_stay_short():
    """Those of tests and benchmarks too."""
    beside = [file for folder in ("tests", "benchmarks") for file in (CHECKOUT / folder).rglob("*.py")]
    assert len(beside) > 50
    assert [str(file) for file in (*FILES, *beside) if len(file.read_text().splitlines()) > 400] == []


def test_models_do_not_batch():
    """vmap, jit and map belong to the engine."""
    for path in FILES:
        if unit(path) in MODELS:
            text = path.read_text()
            assert not any(word in text for word in ("jax.vmap", "jax.jit", "lax.map", "pmap", "shard_map")), path


def test_only_the_edge_touches_files():
    for path in FILES:
        if unit(path) not in EDGE:
            assert not any(word in path.read_text() for word in ("open(", "write_text", "print(")), path
