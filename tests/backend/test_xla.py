"""Compiler settings: applied before the backend starts, off on request, and a warning when too late."""

import os
import subprocess
import sys

import numpy as np

UNSET = ("XLA_FLAGS", "DSSC_JAX_XLA", "DSSC_JAX_CACHE", "JAX_COMPILATION_CACHE_DIR")
CLEAN = {k: v for k, v in os.environ.items() if k not in UNSET}


def python(code, **environment):
    return subprocess.run(
        [sys.executable, "-c", code], env={**CLEAN, **environment}, capture_output=True, text=True, check=True
    )


SHOW = "import dssc_jax, os; print(os.environ.get('XLA_FLAGS', ''))"


def test_flags_are_set_on_import():
    out = python(SHOW).stdout
    assert "xla_cpu_small_while_loop_byte_threshold" in out
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


def test_flags_make_one_kernel_of_the_time_loop():
    """What the flags are for: the run of a batch is one compiled call, and its time loop no sequence of kernels."""
    code = """
import numpy as np
import dssc_jax as dj
from dssc_jax.engine.batching import Engine
from dssc_jax.study.library import find
study = dj.Study.load(find("mu_robustness")).without_sweep()
engine = Engine(study, 512, devices=1)
entry = engine.compiled().as_text().partition("ENTRY")[2]
print(entry.count(" while("), entry.count("xla_cpu_small_call"))
"""
    assert python(code).stdout.split() == ["0", "1"]
    assert python(code, DSSC_JAX_XLA="off").stdout.split() == ["1", "0"]


AGREE = """
import os, sys
import numpy as np
import dssc_jax as dj
from dssc_jax.study.library import find
study = dj.Study.load(find("paper_case1")).override(
    {"loop.duration": 10.0, "draws": 16, "requirement.0.after": 5.0, "plant.vehicle.mass": {"uniform": [10.5, 11.3]}}
)
found = dj.run(study).dataset
np.savez(sys.argv[1], **{name: found[name].values for name in found.data_vars if found[name].dtype == float})
"""


def test_flagged_and_unflagged_compilers_agree(tmp_path):
    """10 s of the whole vehicle under the implicit controller, to 1e-9."""
    for name, environment in (("flagged", {}), ("plain", {"DSSC_JAX_XLA": "off"})):
        code = AGREE.replace("sys.argv[1]", repr(str(tmp_path / name)))
        python(code, **environment)
    flagged, plain = (np.load(tmp_path / f"{name}.npz") for name in ("flagged", "plain"))
    assert sorted(flagged) == sorted(plain)
    worst = max(np.max(np.abs(flagged[n] - plain[n]) / np.maximum(np.abs(plain[n]), 1e-3)) for n in flagged)
    print(f"\nlargest relative difference {worst:.1e}")
    assert worst < 1e-9
