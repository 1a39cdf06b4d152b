"""Compiling what was generated, where there are compilers."""

import shutil
import subprocess

import pytest

FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic", "-ffp-contract=off"]


def require(*programs):
    """Skip the test where a program is missing."""
    missing = [program for program in programs if shutil.which(program) is None]
    if missing:
        pytest.skip(f"needs {', '.join(missing)}")


def made(folder, *targets, fails=False):
    """What `make` prints in a folder."""
    done = subprocess.run(["make", *targets], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode != 0) == fails, done.stdout + done.stderr
    return done.stdout + done.stderr
