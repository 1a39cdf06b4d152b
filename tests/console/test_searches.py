"""Printed searches."""

import math
from types import SimpleNamespace

from dssc_jax.analyses.tuning.result import ObjectiveAnswer
from dssc_jax.console.searches import show_verdict


def test_intervals_without_bounds_are_printed(capsys):
    """Where a draw ends early there is no interval, and its text in square brackets is no markup."""
    verdict = SimpleNamespace(
        draws=20,
        objective=(1.0, math.inf),
        limits={},
        failures=(0, 1),
        requirements={},
        reduction=-math.inf,
        reduction_interval=(math.nan, math.nan),
        difference=(0.25, -0.5, math.inf),
    )
    show_verdict(verdict, ObjectiveAnswer({"error_rms": 1.0}, "mean", 0.95))
    out = capsys.readouterr().out
    assert "reduction none in [none, none] (95 %, bootstrap over draws)" in out
    assert "median +0.25 in [-0.5, none] (95 %, exact)" in out
