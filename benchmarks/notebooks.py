"""Runs the notebooks from top to bottom and writes what they print and plot into them: ``make notebooks``."""

import base64
import io
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellTimeoutError, DeadKernelError
from PIL import Image

NOTEBOOKS = Path(__file__).parents[1] / "notebooks"
COLOURS = 64
PATIENCE = 300  # s for a cell; the longest takes half a minute
ATTEMPTS = 3


def smaller(picture: str) -> str:
    """A picture with a palette, a third of the size; base64 of a PNG, as in a notebook."""
    with Image.open(io.BytesIO(base64.b64decode(picture))) as image:
        out = io.BytesIO()
        image.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE).save(out, "png", optimize=True)
    return base64.b64encode(out.getvalue()).decode()


def run_through(path: Path, attempts: int = ATTEMPTS) -> nbformat.NotebookNode:
    """The notebook after its execution; again if a kernel's reply was lost, which happens on a busy machine."""
    book = nbformat.read(path, as_version=4)
    where = {"metadata": {"path": path.parent}}
    try:
        return NotebookClient(book, timeout=PATIENCE, kernel_name="python3", resources=where).execute()
    except (CellTimeoutError, DeadKernelError):
        if attempts == 1:
            raise
        return run_through(path, attempts - 1)


def is_set_up(output: nbformat.NotebookNode) -> bool:
    """Whether an output sets up the page of a live cell: of no use in a stored notebook, and large."""
    return output.output_type == "display_data" and "image/png" not in output.data


def executed(path: Path) -> nbformat.NotebookNode:
    """The notebook, executed anew in its own folder, without the times and the widgets of this execution."""
    book = run_through(path)
    book.metadata.pop("widgets", None)
    book.metadata["language_info"] = {"name": "python"}  # whatever the version
    for cell in book.cells:
        cell.metadata.pop("execution", None)
        if "outputs" in cell:
            cell.outputs = [output for output in cell.outputs if not is_set_up(output)]
        for output in cell.get("outputs", []):
            if "image/png" in output.get("data", {}):
                output.data["image/png"] = smaller(output.data["image/png"])
    return book


def main() -> int:
    """Execute all notebooks, or those whose names are given."""
    for path in [Path(name) for name in sys.argv[1:]] or sorted(NOTEBOOKS.glob("*.ipynb")):
        nbformat.write(executed(path), path)
        print(path.name)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
