"""Ratios in one run, of processor time, with bounds that a lost optimisation falls below.

They read the clock, so `make ratios` runs them, and `make test` does not.
"""

import pytest

from benchmarks.speed import native
from benchmarks.speed.contest import OURS, PLAIN, C, Contender, contest, quartiles, ratios
from benchmarks.speed.workloads import Case

needs_c = pytest.mark.skipif(
    native.compiler() is None,
    reason="no GCC on the path, which compiles the baseline; the comparison with plain XLA runs without",
)


def shares(case: Case, draws: int, duration: float, *others: Contender) -> list[float]:
    """Our rate over each other contender's: median of nine rounds."""
    found = contest(case, [OURS, *others], draws, duration, 9, at_once=True, clock="processor")
    return [quartiles(ratios(found[OURS.name], found[other.name]))[1] for other in others]


def test_one_axis_against_the_plain_form():
    assert shares(Case("axis"), 16384, 5.0, PLAIN)[0] > 2.5


@needs_c
def test_one_axis_against_c():
    """Measured: 1.1 of C (docs/performance.md)."""
    assert shares(Case("axis"), 16384, 5.0, C)[0] > 0.8


@needs_c
def test_the_vehicle_against_c():
    """Measured: 1.0 of C (docs/performance.md)."""
    assert shares(Case("uav"), 1024, 2.5, C)[0] > 0.8
