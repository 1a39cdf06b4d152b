"""What commands say beside their results: lines on standard error."""

import sys

LONGEST = 1000  # characters of a message


def say(text: str) -> None:
    """Print one line on stderr, so that stdout is left for results; control characters are replaced."""
    line = " ".join(text.split())
    line = line if len(line) <= LONGEST else f"{line[:LONGEST]} ..."
    print("".join(c if c.isprintable() else "?" for c in line), file=sys.stderr)
