"""What the console tells of a result."""

from html import unescape

import dssc_jax as dj
from dssc_jax.console.results import show_result
from dssc_jax.console.searches import show_falsification
from dssc_jax.report import html
from tests.runs.test_run_until import TABLE

FORMULA = "always[0.5,0.9] (abs(e) > 0.1 implies eventually[0,0.05] abs(e) < 0.9)"


def test_a_named_formula_is_written_out_once(capsys):
    """Its list of requirements holds it; the tables name it."""
    required = [{"name": "comes_near", "formula": FORMULA}, {"metric": "error_rms", "max": 0.9}]
    study = dj.Study.from_table({**TABLE, "requirement": required, "draws": 16})
    result = dj.run(study)
    show_result(result)
    lines = capsys.readouterr().out.splitlines()
    (listed,) = (line for line in lines if FORMULA in line)
    assert f"comes_near: {FORMULA}" in listed
    assert any(line.startswith("comes_near ") and "/16 " in line for line in lines)
    page = unescape(html(result, worst=0))
    assert "violates comes_near" in page
    assert f"violates comes_near: {FORMULA}" not in page
    show_falsification(dj.falsify(study, budget=32), [])
    assert capsys.readouterr().out.count(FORMULA) == 1
