"""What the scripts share that write a part of a page by hand otherwise."""

import os
from pathlib import Path

from dssc_jax.console.environment import machine

PAGE = Path(__file__).parents[1] / "docs" / "statistics.md"


def stored_part(part: str, page: Path) -> str:
    """What stands on a page between the marks of a part, with the marks: for a script that writes the rest anew."""
    start, end = f"<!-- {part} -->", f"<!-- end of {part} -->"
    return start + page.read_text().split(start)[1].split(end)[0] + end


def put(part: str, text: str, page: Path = PAGE) -> None:
    """Replace what stands on a page between ``<!-- part -->`` and ``<!-- end of part -->``; machine and load follow."""
    whole = page.read_text()
    start, end = f"<!-- {part} -->\n", f"<!-- end of {part} -->"
    before, rest = whole.split(start)
    after = rest.split(end)[1]
    load = f"mean load in the last quarter of an hour {os.getloadavg()[2]:.0f}"
    page.write_text(f"{before}{start}\n{text}\n\nMachine: {machine()}; {load}.\n\n{end}{after}")
