"""What the console tells of a result."""

from html import unescape

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.console.results import show_result
from dssc_jax.console.searches import show_falsification
from dssc_jax.core.signals import Outcome
from dssc_jax.report import html
from dssc_jax.report.elements import MINUS
from dssc_jax.results.missing import quantile_value
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


REQUIRED = [
    {"formula": "always[0.2,0.8] abs(e) < 0.9"},
    {"signal": "y", "metric": "lowest", "min": -0.5},
    {"metric": "error_rms", "max": 0.9},
]


def with_few_values(changes, missing, outcome):
    """A run in which the last draws have no value of some metrics, or of all: a result with 16 draws."""
    study = dj.Study.from_table({**TABLE, "requirement": REQUIRED, "draws": 16} | changes)
    result = dj.run(study)
    data = result.dataset.copy(deep=True)
    for name in missing or [measure.name for measure in study.measures]:
        data[name].values[..., -10:] = np.nan
    data["outcome"].values[..., -10:] = outcome
    return dj.Result(study, data, result.manifest, path=None)


def told_by(show, capsys):
    """What a function prints, by the first word of a line."""
    show()
    lines = capsys.readouterr().out.splitlines()
    return {line.split()[0]: line for line in lines if line}, " ".join(" ".join(lines).split())


def test_draws_that_ended_early_count_as_the_worst_value_of_each_metric(capsys):
    result = with_few_values({}, [], Outcome.NON_FINITE)
    rows, told = told_by(lambda: show_result(result), capsys)
    for name in ("formula_1", "lowest_y"):
        assert rows[name].split()[2:4] == ["-inf", "-inf"], name
    assert rows["error_rms"].split()[-1] == "inf"
    assert "-inf" not in rows["error_rms"].split()
    note = "10 draws that ended early have no value, and count as inf, but as -inf in formula_1 and lowest_y"
    assert note in told
    assert "(ended early" not in told
    page = unescape(html(result, worst=0))
    assert note.replace("inf", "∞").replace("-", MINUS) in page
    assert "A draw that ended early counts as" not in page


def test_draws_without_a_value_that_ran_to_the_end_are_told_as_that(capsys):
    result = with_few_values({}, ["error_rms"], Outcome.OK)
    rows, told = told_by(lambda: show_result(result), capsys)
    assert "10 draws that ran to the end have no value of error_rms, and count as inf" in told
    assert "ended early" not in told
    assert rows["error_rms"].split()[-1] == "inf"


def test_the_median_in_a_sweep_has_the_sign_of_the_worst_value(capsys):
    changes = {"sweep": {"controller.k_i": [0.5, 0.6]}, "requirement": REQUIRED[:1], "metrics": {"names": ["lowest_y"]}}
    changes["plot"] = {"metric": "formula_1"}
    result = with_few_values(changes, [], Outcome.NON_FINITE)
    _, told = told_by(lambda: show_result(result), capsys)
    assert "median formula_1" in told
    assert told.count("-inf") == 2
    assert f"{MINUS}∞" in unescape(html(result, worst=0))


@pytest.mark.parametrize(
    ("row", "level", "worst", "value"),
    [
        ({"q5": None, "q50": 1.0, "q95": None}, "q5", np.inf, -np.inf),
        ({"q5": None, "q50": 1.0, "q95": None}, "q95", -np.inf, np.inf),
        ({"q5": None, "q50": None, "q95": None}, "q50", -np.inf, -np.inf),
        ({"q5": None, "q50": None, "q95": None}, "q50", 1.0, np.inf),
        ({"q5": 1.0, "q50": 2.0, "q95": 3.0}, "q50", np.inf, 2.0),
    ],
)
def test_an_infinite_quantile_has_a_sign(row, level, worst, value):
    assert quantile_value(row, level, worst) == value
