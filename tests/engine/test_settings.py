"""Importing the package changes nothing, and no private or deprecated name of JAX is used."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from dssc_jax.lanes.llvm import machine

CHECKOUT = Path(__file__).parents[2]
FORBIDDEN = re.compile(
    "|".join((r"\bjax\._" + "src", "XLA_" + "FLAGS", r"\bjax\." + r"core\b", r"primitive\." + "bind"))
)


def python(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()


def test_import_changes_no_environment_and_loads_no_jax():
    code = """
import os, sys
before = dict(os.environ)
import dssc_jax
print(before == dict(os.environ), "jax" in sys.modules)
"""
    assert python(code) == "True False"


def test_import_may_come_after_jax_and_leaves_its_settings():
    code = """
import os, jax
jax.devices()
before, names = dict(os.environ), [name for name in dir(jax.config) if name.startswith("jax_")]
values = {name: getattr(jax.config, name) for name in names}
import dssc_jax, dssc_jax.engine.batching, dssc_jax.runs.run
print(before == dict(os.environ), values == {name: getattr(jax.config, name) for name in names})
"""
    assert python(code) == "True True"


def test_no_private_name_is_used():
    files = [file for folder in ("src", "tests", "benchmarks") for file in (CHECKOUT / folder).rglob("*.py")]
    assert len(files) > 200
    assert [str(file) for file in files if FORBIDDEN.search(file.read_text())] == []


def test_the_environment_may_limit_the_cores(monkeypatch):
    monkeypatch.delenv(machine.CORES_VARIABLE, raising=False)
    every = machine.usable_cores()
    assert every == len(os.sched_getaffinity(0))
    for limit, cores in (("1", 1), ("1000", every), ("none", every), ("0", 1)):
        monkeypatch.setenv(machine.CORES_VARIABLE, limit)
        assert machine.usable_cores() == cores


@pytest.mark.parametrize("bits", [machine.vector_bits()])
def test_the_widest_vectors_are_those_of_the_processor(bits):
    flags = Path("/proc/cpuinfo").read_text().split()
    assert bits == (512 if "avx512f" in flags else 256 if "avx" in flags else 128)
    assert np.log2(bits).is_integer()
