"""The documentation's examples run as printed; its links lead somewhere."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGES = ["README.md", "docs/extending.md", "docs/statistics.md"]
BLOCK = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)


@pytest.mark.parametrize("page", PAGES)
def test_examples_run(page, tmp_path):
    """Files named in their first line are written, then every shell and Python block runs, in order."""
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}
    ran = 0
    for language, text in BLOCK.findall((ROOT / page).read_text()):
        named = re.match(r"# (\w+\.(?:toml|py))\n", text)
        if named:
            (tmp_path / named[1]).write_text(text)
            continue
        commands = [line for line in text.splitlines() if not line.startswith("make ")]
        if language == "python":
            arguments = [sys.executable, "-c", text]
        elif language == "sh" and commands:
            arguments = ["bash", "-euc", "\n".join(commands)]
        else:
            continue
        done = subprocess.run(arguments, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stdout + done.stderr
        ran += 1
    assert ran >= 1


def test_make_targets_of_the_readme_exist():
    makefile = (ROOT / "Makefile").read_text()
    for target in re.findall(r"^make (\w+)", (ROOT / "README.md").read_text(), re.MULTILINE):
        assert f"\n{target}:" in makefile


def test_links_lead_somewhere():
    for page in [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]:
        for link in re.findall(r"\]\(([^)#:]+)\)", page.read_text()):
            assert (page.parent / link).exists(), f"{page.name}: {link}"
