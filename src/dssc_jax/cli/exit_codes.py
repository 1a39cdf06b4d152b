"""Exit codes of the commands."""

DONE = 0
"""The command did what was asked. Its answer may have warnings."""
FAILS = 1
"""A check fails, a verification differs, or a search found a failure; also an exception of the program's own."""
BAD_INPUT = 2
"""The command cannot do what was asked; one line on stderr says why."""
