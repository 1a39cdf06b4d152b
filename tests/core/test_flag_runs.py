"""Runs of true flags."""

import doctest

import numpy as np
import pytest

from dssc_jax.core import flag_runs as module
from dssc_jax.core.flag_runs import flag_runs, longest_run


@pytest.mark.parametrize(
    ("flags", "begins", "ends"),
    [([], [], []), ([0, 0], [], []), ([1], [0], [1]), ([1, 1, 0, 1], [0, 3], [2, 4]), ([0, 1, 0], [1], [2])],
)
def test_runs_at_the_edges_and_of_nothing(flags, begins, ends):
    mask = np.array(flags, bool)
    found = flag_runs(mask)
    assert [part.tolist() for part in found] == [begins, ends]
    assert longest_run(mask) == max((end - begin for begin, end in zip(begins, ends, strict=True)), default=0)


def test_the_example_holds():
    assert doctest.testmod(module).failed == 0
