"""Print messages of a command to standard error; its results go to standard output."""

import sys
from typing import TextIO

LONGEST = 1000
"""Largest number of characters of a message."""


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a warning of Python in one line, without its place in the source; it replaces ``warnings.showwarning``."""
    say(f"warning: {message}")


def say(text: str) -> None:
    """Print one line to standard error; control characters are replaced, and a long text is cut off."""
    line = " ".join(text.split())
    if len(line) > LONGEST:
        line = f"{line[:LONGEST]} ..."
    print("".join(character if character.isprintable() else "?" for character in line), file=sys.stderr)
