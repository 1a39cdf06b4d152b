"""The page's own words: tables, laws, the wind's drag."""

import pytest

from benchmarks.paper import monte_carlo, page


def test_table_escapes_bars():
    assert page.table(("a", "b"), [("|e|", "1")]) == ["| a | b |", "| --- | --- |", "| \\|e\\| | 1 |"]


def test_laws_are_all_told():
    assert page.laws().count("[") == len(monte_carlo.LAWS)
    assert "kappa_m loguniform [0.002, 8]" in page.laws()


def test_drag_of_case_1s_wind():
    """K_Fd |v_w| v_w/M plus the propellers' K_Fdi sum |thetadot| v_w/M, which is 2 % of it."""
    speed = 8.0 * 3.0**0.5
    found = page.wind_drag()
    assert found["x"] == pytest.approx(0.03 * speed * 8.0 / 10.9, rel=0.03)
    assert found["x"] > 0.03 * speed * 8.0 / 10.9
    assert found["y"] == pytest.approx(-found["x"])
    assert found["z"] < found["x"]
