"""Ratios in one run, of processor time, with bounds that a lost optimisation falls below.

They read the clock, so `make ratios` runs them, and `make test` does not.
"""

import pytest

from benchmarks.speed import native
from benchmarks.speed.contest import OURS, PLAIN, C, Contender, contest, quartiles, ratios
from benchmarks.speed.workloads import Case


@pytest.fixture
def c() -> Contender:
    """The baseline in C; without its compiler this check would be half of one."""
    assert native.compiler(), "no GCC on the path, which compiles the baseline"
    return C


def shares(case: Case, draws: int, duration: float, *others: Contender) -> list[float]:
    """Our rate over each other contender's: median of nine rounds."""
    found = contest(case, [OURS, *others], draws, duration, 9, at_once=True, clock="processor")
    return [quartiles(ratios(found[OURS.name], found[other.name]))[1] for other in others]


def test_one_axis_against_the_plain_form():
    assert shares(Case("axis"), 16384, 5.0, PLAIN)[0] > 2.5


def test_one_axis_against_c(c):
    """Measured: 1.1 of C (docs/performance.md)."""
    assert shares(Case("axis"), 16384, 5.0, c)[0] > 0.8


def test_the_vehicle_against_c(c):
    """Measured: 1.0 of C (docs/performance.md)."""
    assert shares(Case("uav"), 1024, 2.5, c)[0] > 0.8
