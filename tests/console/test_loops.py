"""Printed margins: why a limit is missing."""

from dssc_jax.console.loops import without_margins


def test_unstable_draws_are_the_reason_why_no_limit_exists():
    level = "95 % of all draws with 95 % confidence"
    own = {"stable": 127, "no_operating_point": 3, "disk": {"tolerance_limit": None}}
    assert without_margins(own, 200, 59, level) == (
        "70 of 200 draws without margins: the loop is unstable; 3 of 200 draws without margins: no operating point; "
        "hence no finite limit holds for 95 % of all draws with 95 % confidence"
    )
    few = {"stable": 199, "no_operating_point": 0, "disk": {"tolerance_limit": 0.4}}
    assert without_margins(few, 200, 59, level) == "1 of 200 draws without margins: the loop is unstable"
    assert not without_margins(few | {"stable": 200}, 200, 59, level)
