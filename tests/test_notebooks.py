"""Every notebook runs from top to bottom, and prints and plots what is stored in it."""

import math
import re
from copy import deepcopy
from pathlib import Path

import nbformat
import pytest

from benchmarks.notebooks import executed, kernel

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
NUMBER = re.compile(r"[-+]?\d[\d,]*\.?\d*(?:e[-+]?\d+)?")
NEAR = 0.3  # relative: a search of its own path may end after other steps where another processor rounds otherwise


def pictures(book):
    """Number of figures that each code cell left."""
    cells = [cell for cell in book.cells if cell.cell_type == "code"]
    return [sum("image/png" in output.get("data", {}) for output in cell.outputs) for cell in cells]


def printed(book):
    """What the notebook prints, and the numbers in it."""
    text = "".join(output.get("text", "") for cell in book.cells for output in cell.get("outputs", []))
    return NUMBER.sub("#", text).split(), [float(number.replace(",", "")) for number in NUMBER.findall(text)]


def differences(old, new):
    """Where what a notebook printed before is not what it prints now."""
    (old_words, old_numbers), (new_words, new_numbers) = printed(old), printed(new)
    if old_words != new_words:
        return [f"{a!r} is now {b!r}" for a, b in zip(old_words, new_words, strict=False) if a != b] or ["length"]
    pairs = zip(old_numbers, new_numbers, strict=True)
    return [f"{a} is now {b}" for a, b in pairs if not math.isclose(a, b, rel_tol=NEAR, abs_tol=1e-3)]


@pytest.fixture(scope="module")
def manager():
    with kernel() as running:
        yield running


def test_there_are_notebooks():
    assert [path.stem[3:] for path in NOTEBOOKS] == [
        "first_loop",
        "margins",
        "design_inequalities",
        "uav_wind",
        "compare_controllers",
        "tuning",
        "proved_survived_unknown",
        "plain_jax",
    ]


@pytest.mark.long
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
@pytest.mark.filterwarnings("default")  # of the notebook machinery, not of this package
def test_a_notebook_prints_and_plots_what_is_stored_in_it(path, manager):
    stored, fresh = nbformat.read(path, as_version=4), executed(path, manager)
    assert sum(pictures(stored)) >= 1
    assert pictures(fresh) == pictures(stored)
    assert differences(stored, fresh) == [], "run `make notebooks`"
    assert "Warning" not in "".join(printed(fresh)[0])
    assert path.stat().st_size < 300_000


def test_an_old_output_is_told():
    book = nbformat.read(NOTEBOOKS[0], as_version=4)
    older = deepcopy(book)
    cell = next(cell for cell in older.cells if "draws fail" in str(cell.get("outputs", "")))
    text = cell.outputs[0].text
    cell.outputs[0].text = text.replace("fail", "failed")
    assert differences(older, book) == ["'failed:' is now 'fail:'"]
    cell.outputs[0].text = NUMBER.sub("7", text, count=1)
    assert len(differences(older, book)) == 1


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_use_the_public_api_only(path):
    code = "\n".join(cell.source for cell in nbformat.read(path, as_version=4).cells if cell.cell_type == "code")
    assert "import dssc_jax as dj" in code
    assert "dssc_jax." not in code.replace("import dssc_jax as dj", "")
