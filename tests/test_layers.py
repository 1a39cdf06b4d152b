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
WRITER = "core/files.py"
"""The module that reads and writes files for all others."""

FILE_CALLS = {
    *("fdopen", "read_text", "read_bytes", "write_text", "write_bytes", "mkdir", "makedirs", "touch", "unlink"),
    *("rmdir", "removedirs", "symlink_to", "hardlink_to", "symlink", "mkfifo", "mknod", "chmod", "rmtree", "renames"),
    *("copyfile", "copytree", "savez", "savetxt", "tofile", "fromfile", "memmap", "loadtxt", "savefig", "imsave"),
    *("savemat", "to_csv", "to_parquet", "to_netcdf", "to_zarr", "to_pickle", "open_zarr", "open_group"),
    *("open_dataset", "read_csv", "read_parquet", "ParquetWriter", "ZipFile", "FileLock", "LocalStore", "ULog"),
    *("open", "TemporaryDirectory", "NamedTemporaryFile", "TemporaryFile", "mkstemp", "mkdtemp", "FileHandler"),
    *("to_json", "to_excel", "to_feather", "to_hdf", "read_excel", "read_pickle", "read_table", "genfromtxt"),
    *("loadmat", "load_dataset", "open_dataarray", "open_mfdataset", "unpack_archive", "make_archive", "extractall"),
}
"""Last names of functions that open, create, change or delete files."""

QUALIFIED = {
    *("os.replace", "os.rename", "os.link", "os.remove", "os.truncate", "shutil.copy", "shutil.copy2", "shutil.move"),
    *("np.save", "np.load", "numpy.save", "numpy.load"),
}
"""Functions that do so, whose last names have other meanings as well."""

MOVES = {"replace", "rename"}
"""Methods that move a file where they have one argument; those of texts and tables have others."""

ALLOWED = {
    "__init__.py": {"Path(__file__).with_suffix('.pyi').read_text"},  # of the package
    "cli/main.py": {"open"},  # the null device
    "cli/native_build.py": {"TemporaryDirectory"},  # private to the process
    "cli/trajectories.py": {"trajectory.to_dataframe().to_csv"},  # into the writer's file
    "core/native/fmu.py": {"TemporaryDirectory"},  # private to the process
    "core/native/libraries.py": {"TemporaryDirectory"},  # private to the process
    "exploration/serving.py": {"TemporaryDirectory", "webbrowser.open"},  # private to the process
    "flight_code/fmu.py": {"zipfile.ZipFile"},  # in memory
    "lanes/program_cache.py": {"self._path.mkdir", "path.read_bytes", "partial.open", "os.replace", "partial.unlink"}
    | {"file.unlink", "Path(path).unlink"},  # of the compiler, which stands alone
    "lanes/tracing/origins.py": {"Path(file).read_text"},  # a module's source
    "plotting/style.py": {"figure.savefig", "imsave"},  # into the writer's file
    "report/vector.py": {"draw().savefig"},  # in memory
    "results/analysis_folder.py": {"plain.to_zarr", "xr.open_zarr"},  # with ArrayFiles
    "results/array_files.py": {"LocalStore"},  # the type from which ArrayFiles derives
    "results/arrays.py": {"open_group", "zarr.open_group"},  # with ArrayFiles, or in memory
    "results/export.py": {"data.to_netcdf", "parquet.ParquetWriter", "piece.to_csv", "savemat"},  # the writer's file
    "results/lock.py": {"FileLock"},  # of a file that the writer has checked
    "flight_logs/reading/ulog.py": {"ULog"},  # from a file that the writer has opened
    "study/record_files.py": {"pd.read_csv", "pd.read_parquet"},  # from memory
}
"""Calls with such a name that stay outside of the writer, by module, each with its reason."""

PRINTING = {"cli"}
"""Layers that may print; ``console`` has consoles for it."""

PRINTING_MODULES = {"lanes/program_cache.py", "runs/run.py"}
"""Modules that may print: a process of the cache's own, to its caller; the default of ``notify``."""

ROOT_NAMES = {"__version__"}
"""Names of the package's root that its modules may import; all others are for users."""

READER_OF_ALL = "core/trace_memory/names.py"
"""The module that imports the root itself, for a digest of the package's sources."""

FILES = sorted(ROOT.rglob("*.py"))


def layer(path):
    """The layer that a file belongs to; None for the modules at the package's root."""
    parts = path.relative_to(ROOT).parts
    return parts[0] if len(parts) > 1 else None


def models(path):
    """Which kind of model a file belongs to."""
    return path.relative_to(ROOT).parts[1] if layer(path) == "models" else None


def imported_modules(text):
    """Names of this package that a module's text imports, at any level but under TYPE_CHECKING."""
    tree = ast.parse(text)
    skipped = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and ast.unparse(node.test) in ("TYPE_CHECKING", "typing.TYPE_CHECKING")
        for statement in node.body
        for inner in ast.walk(statement)
    }
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        names = []
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition(".")[2] in ("import_module", "__import__"):
            names = [part.value for part in node.args if isinstance(part, ast.Constant) and isinstance(part.value, str)]
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("dssc_jax"):
            names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.level:
            names = ["dssc_jax.relative"]  # absolute imports are the rule here
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        yield from (name for name in names if name.split(".")[0] == "dssc_jax")


def forbidden_imports(path, text):
    """Imports of a module's text that the layers do not allow, each with the rule that it breaks."""
    here = layer(path)
    found = []
    for name in imported_modules(text):
        _, there, part, *_ = (*name.split("."), "", "")
        if there in RANK and there != here and RANK[there] > RANK[here]:
            found.append(f"{name}: {there} lies above {here}")
        elif there == here == "models" and part != models(path):
            found.append(f"{name}: models of different kinds do not know each other")
        elif there not in RANK and there not in ROOT_NAMES and path != ROOT / READER_OF_ALL:
            found.append(f"{name}: the package's root is for its users")
    return found


def test_every_folder_is_a_layer():
    assert {layer(path) for path in FILES} - {None} == set(LAYERS)
    assert {path.name for path in FILES if layer(path) is None} == {"__init__.py", "__main__.py", "types.py"}


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(ROOT)))
def test_imports_go_down(path):
    if layer(path) is not None:
        assert forbidden_imports(path, path.read_text()) == []


@pytest.mark.parametrize(
    ("module", "planted"),
    [
        ("results/store.py", "from dssc_jax.runs.run import run"),
        ("results/store.py", "from dssc_jax import runs"),
        ("results/store.py", "import dssc_jax.runs.run"),
        ("results/store.py", "def late():\n    from dssc_jax import report"),
        ("results/store.py", "if TYPE_CHECKING:\n    pass\nelse:\n    from dssc_jax import report"),
        ("results/store.py", "if not TYPE_CHECKING:\n    from dssc_jax import report"),
        ("results/store.py", "importlib.import_module('dssc_jax.report')"),
        ("results/store.py", "__import__('dssc_jax.report')"),
        ("results/store.py", "from dssc_jax import run"),
        ("results/store.py", "import dssc_jax as dj"),
        ("results/store.py", "from dssc_jax.types import Plant"),
        ("results/store.py", "from ..runs import run"),
        ("lanes/program.py", "from dssc_jax import core"),
        ("models/sensors/lag.py", "from dssc_jax.models.wind.record import RECORDED_WIND"),
        ("models/sensors/lag.py", "from dssc_jax.models import wind"),
        ("models/sensors/lag.py", "from dssc_jax import models"),
    ],
)
def test_a_planted_import_is_found(module, planted):
    path = ROOT / module
    text = path.read_text()
    assert forbidden_imports(path, text) == []
    assert len(forbidden_imports(path, f"{text}\n{planted}\n")) == 1


def foreign_to_verifier(text):
    """What a module of the verifier imports of the rest of this package."""
    return [name for name in imported_modules(text) if not name.startswith("dssc_jax.proofs.verifier.")]


def used_of_verifier(text):
    """What a module of the search imports of the verifier."""
    return [name for name in imported_modules(text) if name.startswith("dssc_jax.proofs.verifier")]


def test_verifier_and_search_share_no_code():
    verifier = [path for path in FILES if path.is_relative_to(ROOT / "proofs" / "verifier")]
    search = [path for path in FILES if path.is_relative_to(ROOT / "proofs" / "search")]
    assert {path.parent.name for path in verifier} == {"verifier", "vehicle"}
    assert {path.parent.name for path in search} == {"search", "vehicle"}
    assert {str(path): names for path in verifier if (names := foreign_to_verifier(path.read_text()))} == {}
    assert {str(path): names for path in search if (names := used_of_verifier(path.read_text()))} == {}


@pytest.mark.parametrize(
    "planted",
    [
        "from dssc_jax.proofs.search.gains import gain_hull",
        "from dssc_jax.proofs.search import gains",
        "from dssc_jax.proofs import search",
        "import dssc_jax.proofs.search.gains",
        "def f():\n    from dssc_jax.proofs.search import gains",
        "from dssc_jax.proofs.problem import ProofProblem",
        "from dssc_jax.models.controllers.gain_functions import GAIN_FUNCTIONS",
        "import dssc_jax",
        "from ..search import gains",
        "importlib.import_module('dssc_jax.proofs.search.gains')",
    ],
)
def test_an_import_planted_in_the_verifier_is_found(planted):
    text = (ROOT / "proofs" / "verifier" / "verdict.py").read_text()
    assert not foreign_to_verifier(text)
    assert foreign_to_verifier(f"{text}\n{planted}\n")


@pytest.mark.parametrize(
    "planted",
    [
        "from dssc_jax.proofs.verifier.balls import enclosing",
        "from dssc_jax.proofs.verifier import balls",
        "from dssc_jax.proofs import verifier",
        "import dssc_jax.proofs.verifier.balls",
    ],
)
def test_an_import_planted_in_the_search_is_found(planted):
    text = (ROOT / "proofs" / "search" / "box_search.py").read_text()
    assert not used_of_verifier(text)
    assert used_of_verifier(f"{text}\n{planted}\n")


def test_places_that_the_architecture_names_exist():
    named = re.findall(r"`(\w+/[\w/]*(?:\.py)?)`", PAGE[PAGE.index("## Where to find") :])
    assert len(named) > 15
    assert [name for name in named if not (ROOT / name).exists() and not (CHECKOUT / name).exists()] == []


def test_modules_stay_short():
    """Those of tests and benchmarks too."""
    beside = [file for folder in ("tests", "benchmarks") for file in (CHECKOUT / folder).rglob("*.py")]
    assert len(beside) > 50
    assert [str(file) for file in (*FILES, *beside) if len(file.read_text().splitlines()) > 400] == []


def full_names(tree):
    """Each name that is read in a tree: its node, as written, and with the modules that its import names."""
    imported = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            imported |= {alias.asname: alias.name for alias in node.names if alias.asname}
        elif isinstance(node, ast.ImportFrom) and node.module:
            imported |= {alias.asname or alias.name: f"{node.module}.{alias.name}" for alias in node.names}
    for node in ast.walk(tree):
        if isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Load):
            written = ast.unparse(node)
            first, dot, following = written.partition(".")
            yield node, written, f"{imported.get(first, first)}{dot}{following}"


def batching(path, text):
    """Transformations over draws that a model's text uses; they belong to the engine."""
    if layer(path) != "models":
        return []
    names = {full for _, _, full in full_names(ast.parse(text)) if full.startswith("jax.")}
    transformations = ("vmap", "jit", "pmap", "shard_map")
    return sorted(full for full in names if full.rpartition(".")[2] in transformations or full == "jax.lax.map")


def test_models_do_not_batch():
    assert {str(path): words for path in FILES if (words := batching(path, path.read_text()))} == {}
    path = ROOT / "models" / "uav" / "plant.py"
    for planted in (
        "fast = jax.vmap(step)",
        "from jax import vmap as v\nfast = v(step)",
        "import jax as j\nj.vmap(step)",
    ):
        assert batching(path, f"{path.read_text()}\n{planted}\n") == ["jax.vmap"]


def file_calls(text):
    """The functions by which a module's text accesses files, called or passed on, as they are written."""
    tree = ast.parse(text)
    for _, written, full in full_names(tree):
        owner, _, last = full.rpartition(".")
        if owner.rpartition(".")[2] != "files" and (last in FILE_CALLS or full in QUALIFIED):
            yield written
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            called = ast.unparse(node.func)
            owner, _, last = called.rpartition(".")
            if last in MOVES and owner and len(node.args) == 1 and not node.keywords:
                yield called
            named = called == "getattr" and len(node.args) > 1 and isinstance(node.args[1], ast.Constant)
            if named and node.args[1].value in FILE_CALLS | MOVES:
                yield node.args[1].value


def unallowed(path, text):
    """The calls of a module that ought to be in the writer."""
    here = str(path.relative_to(ROOT))
    return set() if here == WRITER else set(file_calls(text)) - ALLOWED.get(here, set())


def test_only_one_module_touches_files():
    outside = {str(path): calls for path in FILES if (calls := unallowed(path, path.read_text()))}
    assert outside == {}
    for name, calls in ALLOWED.items():
        assert calls <= set(file_calls((ROOT / name).read_text())), f"{name} no longer needs all of {calls}"


@pytest.mark.parametrize(
    "planted",
    [
        "open('a', 'w')",
        "Path('a').open('w')",
        "path.write_text('a')",
        "path.with_suffix('.b').write_bytes(b'a')",
        "io.open('a')",
        "os.open('a', os.O_CREAT)",
        "os.replace('a', 'b')",
        "Path('a').replace('b')",
        "Path('a').rename('b')",
        "from os import replace as moved\nmoved('a', 'b')",
        "from os import replace\nreplace('a', 'b')",
        "import os as system\nsystem.replace('a', 'b')",
        "import shutil as sh\nsh.move('a', 'b')",
        "import numpy as n\nn.save('a', values)",
        "from numpy import save\nsave('a', values)",
        "read = open\nread('a')",
        "list(map(Path.read_text, paths))",
        "from pathlib import Path as P\nP('a').open('w')",
        "logging.FileHandler('a')",
        "frame.to_json('a')",
        "getattr(path, 'write_text')('a')",
        "figure.savefig('a.png')",
        "np.save('a', values)",
        "np.savez('a', values)",
        "frame.to_csv('a')",
        "dataset.to_netcdf('a')",
        "shutil.copyfile('a', 'b')",
        "shutil.rmtree('a')",
        "folder.mkdir()",
        "path.unlink()",
        "tempfile.mkstemp()",
    ],
)
def test_a_planted_access_is_found(planted):
    for module in ("core/vectors.py", "report/page.py", "results/store.py", "engine/sampling.py"):
        path = ROOT / module
        text = path.read_text()
        assert not unallowed(path, text)
        assert unallowed(path, f"{text}\n{planted}\n")


def printing(path, text):
    """Uses of print, and writes to the standard streams, outside of the layers that may."""
    if layer(path) in PRINTING or str(path.relative_to(ROOT)) in PRINTING_MODULES:
        return []
    ways = {"print", "builtins.print"}
    ways |= {f"sys.{stream}.{write}" for stream in ("stdout", "stderr") for write in ("write", "writelines")}
    return [written for _, written, full in full_names(ast.parse(text)) if full in ways]


def test_only_the_edge_prints():
    assert [str(path) for path in FILES if printing(path, path.read_text())] == []
    path = ROOT / "lanes" / "llvm" / "module_text.py"
    for planted in ("print(1)", "say = print", "sys.stderr.write('1')", "from sys import stdout\nstdout.write('1')"):
        assert len(printing(path, f"{path.read_text()}\n{planted}\n")) == 1
