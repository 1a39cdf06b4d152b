"""Tells which JAX an environment has, and fails if pip finds a newer one within the bounds of pyproject.toml.

``python tests/newest_jax.py``, which ``make quick`` runs first: a test of a new version must not test an old one.
"""

import json
import subprocess
import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

PROJECT = Path(__file__).parents[1] / "pyproject.toml"


def bounds() -> str:
    """What pyproject.toml requires of JAX, such as ``jax>=0.10.2,<0.13``."""
    required = tomllib.loads(PROJECT.read_text())["project"]["dependencies"]
    return next(entry for entry in required if entry.startswith("jax>"))


def newer(requirement: str) -> str | None:
    """A version of JAX that pip would install in place of the present one; None if there is none."""
    ask = ["install", "--dry-run", "--quiet", "--upgrade", "--no-deps", "--report", "-", requirement]
    command = [sys.executable, "-m", "pip", "--disable-pip-version-check", *ask]
    report = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
    versions = [entry["metadata"]["version"] for entry in report["install"]]
    return versions[0] if versions else None


def main() -> int:
    python = ".".join(str(part) for part in sys.version_info[:3])
    found = newer(bounds())
    print(f"JAX {version('jax')} on Python {python}; pyproject.toml admits {bounds()}")
    if found is None:
        print("it is the newest of these that pip finds for this Python; a newer Python may have a newer one")
        return 0
    print(f"pip finds {found} for this Python: install it first", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
