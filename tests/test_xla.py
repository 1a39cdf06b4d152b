"""Compiler settings: applied before the backend starts, off on request, and a warning when too late."""

import os
import subprocess
import sys

CLEAN = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "DSSC_JAX_XLA")}


def python(code, **environment):
    return subprocess.run(
        [sys.executable, "-c", code], env={**CLEAN, **environment}, capture_output=True, text=True, check=True
    )


SHOW = "import dssc_jax, os; print(os.environ.get('XLA_FLAGS', ''))"


def test_flags_are_set_on_import():
    out = python(SHOW).stdout
    assert "xla_cpu_use_multi_output_fusion" in out
    assert "xla_force_host_platform_device_count" in out


def test_switched_off():
    assert python(SHOW, DSSC_JAX_XLA="off").stdout.strip() == ""


def test_a_users_own_flags_win():
    out = python(SHOW, XLA_FLAGS="--xla_force_host_platform_device_count=3").stdout
    assert "device_count=3" in out
    assert out.count("device_count") == 1


def test_too_late_is_told():
    late = "import jax; jax.devices(); import dssc_jax"
    assert "LateSettingsWarning" in python(late).stderr
    assert "DSSC_JAX_XLA=off" in python(late).stderr
    assert "Warning" not in python(late, DSSC_JAX_XLA="off").stderr
    assert "Warning" not in python("import jax, dssc_jax; jax.devices()").stderr


def test_import_loads_no_jax():
    assert python("import dssc_jax, sys; print('jax' in sys.modules)").stdout.strip() == "False"


def test_flags_reduce_the_work():
    """What the flags are for: fewer kernels in the compiled step."""
    code = """
import json, re, sys
import numpy as np
import dssc_jax as dj
from dssc_jax.engine import Engine
from dssc_jax.study.library import find
study = dj.Study.load(find("mu_robustness")).without_sweep()
engine = Engine(study, 512, devices=1)
engine({name: np.ones(512) for name in engine.names}, np.arange(512))()
text = engine._run.as_text()
print(len(re.findall(r" fusion\\(", text)))
"""
    flagged, plain = int(python(code).stdout), int(python(code, DSSC_JAX_XLA="off").stdout)
    print(f"\nfusions: {flagged} with the flags, {plain} without")
    assert flagged < plain
