"""Runs the notebooks from top to bottom and writes what they print and plot into them: ``make notebooks``."""

import base64
import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import nbformat
from jupyter_client.manager import KernelManager
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


@contextmanager
def kernel() -> Iterator[KernelManager]:
    """A kernel that runs one notebook after another, which saves imports."""
    manager = KernelManager(kernel_name="python3")
    manager.start_kernel(cwd=str(NOTEBOOKS))
    try:
        yield manager
    finally:
        manager.shutdown_kernel(now=True)


def run_through(path: Path, manager: KernelManager, attempts: int = ATTEMPTS) -> nbformat.NotebookNode:
    """The notebook after its execution; again if a kernel's reply was lost, which happens on a busy machine."""
    book = nbformat.read(path, as_version=4)
    client = manager.client()
    client.start_channels()
    try:
        client.wait_for_ready(PATIENCE)
        client.execute_interactive("%reset -f", silent=True, timeout=PATIENCE)  # names of earlier notebooks
        runner = NotebookClient(book, km=manager, timeout=PATIENCE)
        runner.kc = client
        return runner.execute()
    except (CellTimeoutError, DeadKernelError):
        if attempts == 1:
            raise
        manager.restart_kernel(now=True)
        return run_through(path, manager, attempts - 1)
    finally:
        client.stop_channels()


def is_set_up(output: nbformat.NotebookNode) -> bool:
    """Whether an output sets up the page of a live cell: of no use in a stored notebook, and large."""
    return output.output_type == "display_data" and "image/png" not in output.data


def executed(path: Path, manager: KernelManager) -> nbformat.NotebookNode:
    """The notebook, executed anew in a kernel, without the times and the widgets of this execution."""
    book = run_through(path, manager)
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
    with kernel() as manager:
        for path in [Path(name) for name in sys.argv[1:]] or sorted(NOTEBOOKS.glob("*.ipynb")):
            nbformat.write(executed(path, manager), path)
            print(path.name)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
