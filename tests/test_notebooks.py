"""Every notebook runs from top to bottom, and each of its figures appears."""

import time
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
LIMIT = 120  # s, from top to bottom


def pictures(book):
    """Number of figures that each code cell left."""
    cells = [cell for cell in book.cells if cell.cell_type == "code"]
    return [sum("image/png" in output.get("data", {}) for output in cell.outputs) for cell in cells]


def test_there_are_notebooks():
    assert [path.stem[3:] for path in NOTEBOOKS] == [
        "first_loop",
        "margins",
        "design_inequalities",
        "uav_wind",
        "compare_controllers",
        "tuning",
    ]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("default")  # of the notebook machinery, not of this package
def test_notebook_runs_and_leaves_its_pictures(path):
    book = nbformat.read(path, as_version=4)
    stored = pictures(book)
    assert sum(stored) >= 1
    began = time.monotonic()
    NotebookClient(book, timeout=LIMIT, kernel_name="python3", resources={"metadata": {"path": path.parent}}).execute()
    assert time.monotonic() - began < LIMIT
    assert pictures(book) == stored
    text = "".join(output.get("text", "") for cell in book.cells for output in cell.get("outputs", []))
    assert "Warning" not in text
    assert path.stat().st_size < 300_000


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_use_the_public_api_only(path):
    code = "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code")
    assert "import dssc_jax as dj" in code
    assert "dssc_jax." not in code.replace("import dssc_jax as dj", "")
