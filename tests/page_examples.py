"""Runs the examples of pages of the documentation, in order: ``python page_examples.py PAGE...``, in an empty folder.

Each page has a folder of its own there. Files named in their first line are written, then every shell and Python
block runs; a page's Python blocks share their names. Commands run in this process, which imports the package once for
all of them; those that are not ours, or use the shell, run in a shell.
"""

import gc
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

BLOCK = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)
SHELL = set("|&;<>$`*?~(){}")


def examples(page: Path) -> Iterator[tuple[str, str]]:
    """Language and text of each block that runs; files are written on the way."""
    for language, text in BLOCK.findall(page.read_text()):
        named = re.match(r"(?:#|/\*) (\w+\.(?:toml|py|c))\b", text)
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
    from dssc_jax.cli.main import guarded

    return guarded(words[1:])


def enter(folder: Path) -> None:
    """Make a folder, and work in it without the modules of the folder before."""
    left = Path.cwd()
    for name, module in list(sys.modules.items()):
        if left == Path(getattr(module, "__file__", None) or "/").parent:
            del sys.modules[name]
    folder.mkdir(exist_ok=True)
    os.chdir(folder)
    sys.path[0] = str(folder)


def run_page(page: Path) -> None:
    """Run all examples of a page; end with the first that fails. The files of the page's own folder are at hand."""
    for file in sorted(page.with_suffix("").glob("*")):
        shutil.copy(file, file.name)
    namespace = {"__name__": "__main__"}
    for number, (language, text) in enumerate(examples(page), 1):
        print(f"--- {page.name}: {text}", flush=True)
        code = 0
        if language == "sh":
            code = run(text)
        else:
            exec(compile(text, f"example {number}", "exec"), namespace)
        if code:
            sys.exit(f"{page.name}: exit code {code}")


if __name__ == "__main__":
    gc.set_threshold(1_000_000)  # as a command does
    here = Path.cwd()
    for page in [Path(name).resolve() for name in sys.argv[1:]]:
        enter(here / page.stem)
        run_page(page)
