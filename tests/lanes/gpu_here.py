"""A mark for tests that need this machine's GPU."""

import pytest

from dssc_jax.lanes.gpu.driver import GpuError, driver


def missing_gpu() -> str:
    """Why this machine has no GPU for lanes; empty if it has one."""
    try:
        driver()
    except GpuError as problem:
        return str(problem)
    return ""


MISSING = missing_gpu()
needs_gpu = pytest.mark.skipif(bool(MISSING), reason=f"compares the bits of this machine's GPU: {MISSING}")
