"""Every field of a window through all that reads, writes and copies it; a new field is covered by its declaration."""

import math
import tomllib

import pytest
import tomli_w
from pydantic import ValidationError

import dssc_jax as dj
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.closed_loop.metrics.window import WHOLE_RUN, Window, window_entries
from dssc_jax.report.study_sections import requirement_text
from dssc_jax.results.schema import variables
from dssc_jax.study.schema import MetricsTable, RequirementTable

FIELDS = sorted(window_entries())


def study(**tables):
    return dj.Study.from_table(
        {
            "name": "windowed",
            "draws": 2,
            "loop": {"duration": 40.0, "sample_time": 0.02},
            "plant": {"kind": "normal_form", "k_p": {"uniform": [0.8, 1.2]}, "a_p": 1.0},
            "reference": {"kind": "step", "size": 1.0},
            "controller": {"kind": "pi", "k_p": 2.0, "k_i": 0.5, "l0": 1.0},
            "requirement": [{"metric": "settling_time_percent", "max": 9.0}],
            "tune": {"parameters": {"controller.k_p": [1.0, 4.0]}, "objective": {"error_rms": 1.0}},
            **tables,
        }
    )


def admissible(name):
    """A value that is neither the default nor excluded by the field's bounds."""
    bounds = window_entries()[name].bounds
    low = max(bounds.get("ge", 0.0), bounds.get("gt", 0.0))
    default = getattr(WHOLE_RUN, name)
    shift = 0.0 if math.isinf(default) else default / 128.0
    return low + 0.7 * (min(bounds.get("lt", low + 2.0), low + 2.0) - low) + shift


@pytest.mark.parametrize("name", FIELDS)
def test_a_field_is_parsed_printed_and_copied(name):
    entry, value = window_entries()[name], admissible(name)
    assert value != getattr(WHOLE_RUN, name)
    for table, place in (
        ({"metrics": {entry.key: value}}, "metrics"),
        ({"requirement": [{"metric": "settling_time_percent", entry.key: value, "max": 9.0}]}, "requirement"),
    ):
        read = study(**table)
        (requirement,) = read.requirements
        window = requirement.measure.window
        assert getattr(window, name) == value
        assert Window.of(window.entries()) == window
        parsed = dj.Study.from_table(tomllib.loads(tomli_w.dumps(read.table)))
        assert parsed.requirements == read.requirements
        assert read.override({"draws": 3}).requirements[0].measure.window == window
        tuned = Plan.of(read).trial()
        assert tuned.requirements[0].measure == requirement.measure
        assert tuned.config.metrics.window == read.config.metrics.window
        assert {m.name: m.window for m in tuned.measures}["error_rms"] == read.config.metrics.window
        if place == "requirement":
            said = entry.words.format(value, output="m")
            assert said in requirement.text
            assert said in "".join(str(part) for part in requirement_text(requirement))
            assert said in variables(read)[requirement.name].attributes["long_name"]
            assert requirement.measure.name.endswith(entry.suffix.format(value))
            usual = study(metrics={entry.key: value}).requirements[0].measure
            assert usual.name == "settling_time_percent"


def test_a_settling_band_has_the_unit_of_the_output():
    required = [{"metric": "settling_time", "settling_band": 0.5, "max": 9.0}]
    (requirement,) = study(requirement=required, units={"output": "rad/s"}).requirements
    assert requirement.text == "settling_time with a settling band of 0.5 rad/s <= 9 s"


@pytest.mark.parametrize("name", FIELDS)
def test_an_override_moves_a_field(name):
    entry, value = window_entries()[name], admissible(name)
    moved = study().override({f"metrics.{entry.key}": value})
    assert getattr(moved.config.metrics.window, name) == value
    assert getattr(moved.requirements[0].measure.window, name) == value


@pytest.mark.parametrize("name", FIELDS)
def test_both_tables_have_the_declared_bounds(name):
    entry = window_entries()[name]
    low = entry.bounds.get("ge", entry.bounds.get("gt", 0.0))
    for table, windows in ((MetricsTable, {}), (RequirementTable, {"metric": "error_rms", "max": 1.0})):
        with pytest.raises(ValidationError, match=entry.key):
            table(**windows, **{entry.key: low - 1.0})
    assert MetricsTable().window == WHOLE_RUN
    assert RequirementTable(metric="error_rms", max=1.0).window(Window(3.0, 0.1, 5.0)) == Window(3.0, 0.1, 5.0)


def test_names_of_measures():
    usual = Window(1.0, 0.05, 2.0)
    assert usual.suffix(usual) == ""
    assert Window(1.0, 0.05, 0.5).suffix(usual) == "_after_1_within_0.5_percent"
    assert Window(2.0, 0.1, 2.0).suffix(usual) == "_after_2_within_0.1"
