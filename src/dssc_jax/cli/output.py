"""Messages beside a command's results: lines on standard error."""

import sys
from typing import TextIO

LONGEST = 1000  # characters of a message


def show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    """Print a warning of the library as one line, without the place in the source; for ``warnings.showwarning``."""
    say(f"warning: {message}")


def say(text: str) -> None:
    """Print one line on stderr, so that stdout is left for results; control characters are replaced."""
    line = " ".join(text.split())
    line = line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."
    print("".join(c if c.isprintable() else "?" for c in line), file=sys.stderr)
