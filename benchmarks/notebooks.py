"""Runs the notebooks from top to bottom and writes what they print and plot into them: ``make notebooks``."""

import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"


def executed(path: Path) -> nbformat.NotebookNode:
    """The notebook, executed anew in its own folder, without the times and the widgets of this execution."""
    book = nbformat.read(path, as_version=4)
    NotebookClient(book, timeout=600, kernel_name="python3", resources={"metadata": {"path": path.parent}}).execute()
    book.metadata.pop("widgets", None)
    book.metadata["language_info"] = {"name": "python"}  # whatever the version
    for cell in book.cells:
        cell.metadata.pop("execution", None)
    return book


def main() -> int:
    """Execute all notebooks, or those whose names are given."""
    for path in [Path(name) for name in sys.argv[1:]] or sorted(NOTEBOOKS.glob("*.ipynb")):
        nbformat.write(executed(path), path)
        print(path.name)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
