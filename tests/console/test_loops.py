"""Printed margins: why a limit is missing."""

import math

from dssc_jax.analyses.loop_margins.result import LoopStatistics, MarginStatistics
from dssc_jax.console.loops import no_margins_text


def statistics(stable, no_operating_point, limit):
    disk = MarginStatistics("1", 0.5, (0.4, 0.6), 0.3, limit, "lower")
    return LoopStatistics(stable, (0.0, 1.0), no_operating_point, {"disk": disk})


def test_unstable_draws_are_the_reason_why_no_limit_exists():
    level = "95 % of all draws with 95 % confidence"
    assert no_margins_text(statistics(127, 3, -math.inf), 200, 59, level) == (
        "70 of 200 draws without margins: the loop is unstable; 3 of 200 draws without margins: no operating point "
        "within the limits; "
        "hence no finite limit holds for 95 % of all draws with 95 % confidence"
    )
    few = no_margins_text(statistics(199, 0, 0.4), 200, 59, level)
    assert few == "1 of 200 draws without margins: the loop is unstable"
    assert not no_margins_text(statistics(200, 0, 0.4), 200, 59, level)
