"""Runs the examples of a page of the documentation, in order: ``python page_examples.py PAGE``, in an empty folder.

Files named in their first line are written, then every shell and Python block runs. Commands run in this process,
which imports the package once for all of them; those that are not ours, or use the shell, run in a shell.
"""

import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

BLOCK = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)
SHELL = set("|&;<>$`*?~(){}")


def examples(page: Path) -> Iterator[tuple[str, str]]:
    """Language and text of each block that runs; files are written on the way."""
    for language, text in BLOCK.findall(page.read_text()):
        named = re.match(r"# (\w+\.(?:toml|py))\n", text)
        if named:
            Path(named[1]).write_text(text)
        elif language == "python":
            yield language, text
        elif language == "sh":
            for line in text.replace("\\\n", "").splitlines():
                if line.strip() and not line.startswith("make "):
                    yield language, line


def run(command: str) -> int:
    """The exit code of a line of a shell block."""
    words = shlex.split(command, comments=True)
    if words[:1] != ["dssc-jax"] or SHELL & set("".join(words)):
        return subprocess.run(["bash", "-euc", command], check=False).returncode
    from dssc_jax.cli import guarded

    return guarded(words[1:])


def main(page: str) -> None:
    """Run all examples of a page; end with the first that fails."""
    sys.path[0] = os.getcwd()
    for number, (language, text) in enumerate(examples(Path(page)), 1):
        print(f"--- {text}", flush=True)
        code = 0
        if language == "sh":
            code = run(text)
        else:
            exec(compile(text, f"example {number}", "exec"), {"__name__": "__main__"})
        if code:
            sys.exit(f"exit code {code}")


if __name__ == "__main__":
    main(sys.argv[1])
