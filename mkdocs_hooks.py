"""What the site's build adds to mkdocs: the notebooks as pages; cross-references in docstrings lose their roles."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

NOTEBOOKS = Path(__file__).parent / "notebooks"
ROLE = re.compile(r":(?:class|data|func|meth|mod):(?=<code>)")


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add every notebook as a page of its cells with their stored outputs."""
    for path in sorted(NOTEBOOKS.glob("*.ipynb")):
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        text = "\n\n".join(part for cell in cells for part in parts_of(cell))
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
    return files


def parts_of(cell: dict[str, Any]) -> Iterator[str]:
    """A cell in Markdown: its text or code, then what it printed and plotted."""
    source = "".join(cell["source"])
    if cell["cell_type"] == "markdown":
        yield source
        return
    yield f"```python\n{source}\n```"
    for output in cell["outputs"]:
        data = output.get("data", {})
        if "image/png" in data:
            yield f"![figure](data:image/png;base64,{''.join(data['image/png']).strip()})"
        elif text := "".join(output.get("text", data.get("text/plain", ""))).rstrip():
            yield f"```text\n{text}\n```"


def on_page_content(html: str, **_: Any) -> str:
    """Take ``:class:`` and its like away before the code that they stand for."""
    return ROLE.sub("", html)
