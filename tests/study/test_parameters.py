"""Named numbers: expressions of parameters are the numbers that somebody would have written by hand."""

import copy
import math
from random import Random
from typing import Any

import jax
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.warnings import warn_of_units
from dssc_jax.core.errors import ConfigError
from dssc_jax.engine.batching import Engine, evaluate
from dssc_jax.engine.sampling import draw
from dssc_jax.study.described import Described, describe_study
from dssc_jax.study.tables import with_changes
from tests.conftest import UNCERTAIN
from tests.mutations import places

DRAWS = 12
FILTER: dict[str, Any] = {
    "name": "filter",
    "draws": DRAWS,
    "loop": {"duration": 2e-3, "sample_time": "=1/f_s"},
    "parameters": {
        "L": {"uniform": [8e-6, 12e-6], "unit": "H", "meaning": "inductance"},
        "C": {"uniform": [80e-6, 120e-6], "unit": "F"},
        "R": {"loguniform": ["=R_0/2", "=2*R_0"], "unit": "ohm"},
        "R_0": 1.0,
        "V": {"value": 12.0, "unit": "V", "meaning": "input voltage"},
        "f_s": {"value": 1e5, "unit": "1/s"},
        "w0": {"value": "=1/sqrt(L*C)", "unit": "rad/s", "meaning": "corner frequency"},
        "bandwidth": 2000.0,
    },
    "plant": {
        "kind": "transfer_function",
        "numerator": ["=V*w0**2"],
        "denominator": [1.0, "=1/(R*C)", "=w0**2"],
    },
    "controller": {"kind": "pid", "k_p": 0.0, "k_i": "=bandwidth/V", "k_d": 0.0},
    "reference": {"kind": "step", "size": 5.0},
    "units": {"output": "V", "command": "1"},
    "metrics": {"after": 1e-3},
    "requirement": [{"metric": "error_max", "after": 1e-3, "max": "=5*0.2"}],
}
BY_HAND = ("plant.numerator.0", "plant.denominator.1", "plant.denominator.2")


def by_hand(values: dict[str, np.ndarray], v: float = 12.0) -> dict[str, np.ndarray]:
    """The plant's numbers as NumPy computes them."""
    inductance, capacitance, load = (values[f"parameters.{name}"] for name in "LCR")
    w0 = 1.0 / np.sqrt(inductance * capacitance)
    rate = 1.0 / (load * capacitance)
    return {"plant.numerator.0": v * w0**2, "plant.denominator.1": rate, "plant.denominator.2": w0**2}


def written_out(study: dj.Study) -> dj.Study:
    """The study whose plant's numbers are laws of their own, to be replaced by any values."""
    changes: dict[str, Any] = {"parameters": {}, "loop.sample_time": 1e-5, "controller.k_i": 2000.0 / 12.0}
    changes |= {name: {"uniform": [1.0, 1e12]} for name in BY_HAND}
    return dj.Study.from_table(
        with_changes(study.table | {"requirement": [{"metric": "error_max", "max": 1.0}]}, changes, "")
    )


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(FILTER)


@pytest.mark.parametrize("kernel", ["strict", "lanes", "scan"])
def test_each_draw_has_the_numbers_that_numpy_computes(study, kernel):
    indices = np.arange(DRAWS)
    values = draw(study, indices)
    assert set(values) == {"parameters.L", "parameters.C", "parameters.R"}
    assert values["parameters.R"].min() >= 0.5
    found = evaluate(Engine(study, DRAWS, kernel=kernel), values, indices)
    plain = written_out(study)
    expected = evaluate(Engine(plain, DRAWS, kernel=kernel), by_hand(values), indices)
    for name in ("error_max", "command_tv", "error_rms"):
        np.testing.assert_allclose(found[name], expected[name], rtol=1e-9)
    assert np.ptp(found["error_rms"]) > 1e-3


def test_derived_numbers_are_those_of_numpy(study):
    values = draw(study, np.arange(DRAWS))
    derived = study.derived(values)
    assert set(derived) == {"parameters.w0", *BY_HAND}
    for name, expected in by_hand(values).items():
        np.testing.assert_allclose(derived[name], expected, rtol=1e-15)


def test_a_sweep_over_a_parameter_is_that_written_out_by_hand_bit_for_bit():
    r = [0.5, 0.7, 1.3, 4.0]
    table = with_changes(FILTER, {"parameters.L": 1e-5, "parameters.C": 1e-4, "draws": 1}, "")
    named = dj.Study.from_table(with_changes(table, {"sweep.parameters.R": r}, ""))
    rates = sorted(1.0 / (value * 1e-4) for value in r)
    plain = dj.Study.from_table(
        with_changes(table, {"plant.denominator.1": 1.0, "sweep.plant.denominator.1": rates}, "")
    )
    by_name, by_number = (dj.run(study).dataset for study in (named, plain))
    for metric in ("error_max", "error_rms", "command_tv", "settling_time"):
        np.testing.assert_array_equal(by_name[metric].values[::-1], by_number[metric].values)
    assert len(set(by_name["error_rms"].values.ravel())) == len(r)


def test_plain_parameters_are_constants_of_the_program(study):
    plain = study.override({f"parameters.{name}": value for name, value in (("L", 1e-5), ("C", 1e-4), ("R", 1.0))})
    assert plain.laws == {}
    assert plain.template.plant.denominator == (1.0, 1.0 / 1e-4, (1.0 / math.sqrt(1e-5 * 1e-4)) ** 2)
    assert plain.template.controller[0].k_i == 2000.0 / 12.0
    assert plain.loop.sample_time == 1e-5
    written = plain.override(
        {"parameters": {}, "loop.sample_time": 1e-5, "controller.k_i": 2000.0 / 12.0}
        | {
            "plant.numerator": [plain.template.plant.numerator[0]],
            "plant.denominator": list(plain.template.plant.denominator),
            "requirement": [{"metric": "error_max", "after": 1e-3, "max": 1.0}],
        }
    )
    for name, column in dj.run(written).dataset.items():
        np.testing.assert_array_equal(dj.run(plain).dataset[name].values, column.values)


@pytest.mark.parametrize("name", ["parameters.L", "parameters.R", "parameters.bandwidth"])
def test_a_gradient_by_a_parameter_is_that_of_finite_differences(study, name):
    with jax.enable_x64(True):
        lane = dj.lane(study)
        values, index = lane.example
        start = values | {name: values.get(name, study.numbers[name].value)}
        error = jax.jit(lambda value: lane(start | {name: value}, index)["error_rms"])
        slope = jax.jit(jax.grad(error))(start[name])
        width = 1e-5 * start[name]
        difference = (error(start[name] + width) - error(start[name] - width)) / (2.0 * width)
        np.testing.assert_allclose(slope, difference, rtol=1e-5)
        assert abs(slope * start[name]) > 1e-6


def test_units_and_meanings_stay_when_a_value_is_replaced(study):
    assert study.quantities["parameters.L"].unit == "H"
    for value in (1e-5, {"normal": [1e-5, 1e-7]}, "=2*5e-6"):
        table = study.override({"parameters.L": 1e-5 if isinstance(value, dict) else value}).table["parameters"]
        assert table["L"]["unit"] == "H"
        assert table["L"]["meaning"] == "inductance"
    result = dj.run(study.override({"draws": 2}))
    assert result.dataset["parameters.L"].attrs["units"] == "H"


def test_a_law_that_spreads_through_a_number_moves_with_it(study):
    wider = study.override({"parameters.R_0": 2.0})
    assert wider.laws["parameters.R"].arguments == (1.0, 4.0)


BAD = {
    "unknown name": (
        {"plant.denominator.1": "=1/(R*C*bandwith)"},
        "plant.denominator.1: '=1/(R*C*bandwith)' names 'bandwith', which is no parameter; did you mean 'bandwidth'?",
    ),
    "no parameters": ({"parameters": {}}, "loop.sample_time: '=1/f_s' names 'f_s', which is no parameter; name num"),
    "circle": (
        {"parameters.L": "=x*2", "parameters.x": "=y", "parameters.y": "=L"},
        "parameters.L: depends on itself: L -> x -> y -> L",
    ),
    "itself": ({"parameters.L": "=L"}, "parameters.L: depends on itself: L -> L"),
    "syntax": ({"parameters.w0": "=1/sqrt(L*C"}, "parameters.w0: '=1/sqrt(L*C' is no expression: '(' was never closed"),
    "in a law": (
        {"parameters.R": {"uniform": ["=R_0/2", "=2*R_1"]}},
        "names 'R_1', which is no parameter; did you mean",
    ),
    "a law in a law": (
        {"parameters.R_0": {"uniform": [1.0, 2.0]}},
        "parameters.R.0: must be known before tracing, and '=R_0/2' depends on the law of parameters.R_0",
    ),
    "division by zero": (
        {"parameters.V": 0.0},
        "controller.k_i: '=bandwidth/V' has no finite value at parameters.V = 0",
    ),
    "pole within a law": (
        {"parameters.R": {"uniform": [-1.0, 2.0]}},
        "plant.denominator.1: '=1/(R*C)' has no finite value near parameters.",
    ),
    "root of a negative number": ({"parameters.L": -1e-5}, "parameters.w0: '=1/sqrt(L*C)' has no finite value near"),
    "overflow": ({"parameters.V": "=exp(1000*L*1e5)"}, "parameters.V: '=exp(1000*L*1e5)' exceeds the largest number"),
    "range": (
        {"reference": {"kind": "sine", "amplitude": 1.0, "period": "=R - 0.6"}},
        "must be > 0, got =R - 0.6, whose support is [-0.1, 1.4]",
    ),
    "clock of a law": (
        {"parameters.f_s": {"uniform": [1e4, 1e5]}},
        "loop.sample_time: must be known before tracing, and '=1/f_s' depends on the law of parameters.f_s",
    ),
    "clock as axis": (
        {"sweep.parameters.f_s": [1e5, 1.25e5]},
        "sweep.parameters.f_s: is fixed before tracing; run once per value",
    ),
    "axis that follows": (
        {"sweep.plant.denominator.2": [1.0, 2.0]},
        "sweep.plant.denominator.2: follows from parameters.L, parameters.C, parameters.w0 by '=w0**2'; take",
    ),
    "axis with a pole": ({"sweep.parameters.C": [-1e-4, 1e-4]}, "sweep: parameters.w0: '=1/sqrt(L*C)' has no finite"),
    "axis out of a part's rule": (
        {"unmodelled": {"kind": "delay", "samples": "=R", "memory": 3.0}, "sweep.parameters.R": [1.0, 5.0]},
        "sweep: unmodelled.samples: must be <= memory = 3, got up to 5",
    ),
    "jitter beyond a sample": (
        {"sensor": {"kind": "noisy", "jitter": "=1e-6*R"}, "sweep.parameters.R": [1.0, 11.0]},
        "at most one sample [s] must be <= 1e-05, got =1e-6*R, whose support is [1e-06, 1.1e-05]",
    ),
    "unit": ({"parameters.L": {"value": 1.0, "unit": "H/"}}, "parameters.L.unit: must be a product of powers"),
    "entry": (
        {"parameters.L": {"value": 1.0, "units": "H"}},
        "parameters.L.units: is no entry",
    ),
    "law name": (
        {"parameters.L": {"unifrm": [1.0, 2.0]}},
        "parameters.L.unifrm: is no entry",
    ),
    "text": ({"parameters.L": "1e-5"}, "parameters.L: must be a number, a law, an expression, or a table such as"),
    "two contents": ({"parameters.L": {"value": 1.0, "uniform": [1, 2]}}, "parameters.L: must be a number, a law, an"),
    "name": ({"parameters": {"L-1": 1.0}}, "parameters.L-1: a parameter's name consists of letters, digits and _"),
    "word": ({"parameters": {"lambda": 1.0}}, "parameters.lambda: 'lambda' is a word of Python; take another name"),
    "function": ({"parameters": {"exp": 1.0}}, "parameters.exp: 'exp' has a meaning in expressions; take another name"),
    "record": (
        {"reference": {"kind": "record", "time": [0.0, 1.0], "value": [0.0, "=V"]}},
        "reference.value: must be a plain number in a record, got '=V'",
    ),
    "whole number": ({"draws": "=1.5*R_0"}, "draws: input should be a valid integer"),
    "kind": ({"plant.kind": "=V"}, "plant.kind: must be a name, got '=V'"),
    "table": ({"parameters": [1.0]}, "parameters: must be a table, got [1.0]"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_told_in_one_line(case):
    changes, message = BAD[case]
    with pytest.raises(ConfigError) as error:
        dj.Study.from_table(with_changes(FILTER, changes, "filter.toml"), "filter.toml")
    assert message in str(error.value)
    assert "\n" not in str(error.value)
    assert str(error.value).startswith("filter.toml: ")


def test_a_long_chain_of_parameters_takes_no_time():
    chain = {"x0": 1.0} | {f"x{i}": f"=x{i - 1} + x{i - 1}" for i in range(1, 60)}
    study = dj.Study.from_table(
        with_changes(FILTER, {"parameters.x": 0.0}, "")
        | {"parameters": FILTER["parameters"] | chain, "plant": FILTER["plant"] | {"numerator": ["=x59*R"]}}
    )
    assert study.derived(dict.fromkeys(study.laws, 1.0))["plant.numerator.0"] == 2.0**59
    with pytest.raises(ConfigError, match="holds at most 200 parameters, got 201"):
        dj.Study.from_table(FILTER | {"parameters": {f"x{i}": 1.0 for i in range(201)}})


def test_unused_parameters_are_named(study):
    assert study.unused_parameters() == ()
    assert study.override({"plant.denominator.1": 5.0, "parameters.T": 1.0}).unused_parameters() == (
        "parameters.R",
        "parameters.T",
    )


def test_multiples_of_si_units_are_told(capsys):
    """Formulas take numbers as they are, so 38 uH would be 38 H."""
    parameters = {
        "L": {"value": 38.0, "unit": "uH"},
        "w": {"value": 10.0, "unit": "rpm"},
        "m": {"value": 2.0, "unit": "kg m^2/s"},
        "p": {"value": 2.0, "unit": "Pa"},
        "n": {"value": 2.0},
    }
    warn_of_units(dj.Study.from_table(UNCERTAIN | {"sweep": {}, "parameters": parameters}))
    told = capsys.readouterr().err.splitlines()
    assert len(told) == 2
    assert "parameters.L has the unit uH, which is a label" in told[0]
    assert "1 uH is 1e-06 H" in told[0]
    assert "1 rpm is 0.10472 rad/s" in told[1]


def test_a_lane_takes_parameters_and_no_number_that_follows(study):
    lane = dj.lane(study)
    values, index = lane.example
    with pytest.raises(ConfigError, match=r"plant.denominator.2: follows from parameters.L, parameters.C, "):
        lane(values | {"plant.denominator.2": 1.0}, index)
    with pytest.raises(ConfigError, match=r"parameters.f_s: is fixed before tracing"):
        lane(values | {"parameters.f_s": 1.0}, index)


def test_a_description_keeps_expressions(study):
    content = describe_study(study, None, "")
    assert content["numbers"]["plant.denominator.2"]["value"] == "=w0**2"
    read = Described.of(study.table, "folder", {}, content)
    assert read.laws == study.laws
    assert read.uncertain == study.uncertain
    assert read.numbers["plant.denominator.2"].value == study.numbers["plant.denominator.2"].value
    assert read.followers("parameters.C") == study.followers("parameters.C") == BY_HAND


HOSTILE = (
    "=",
    "=(",
    "=1/0",
    "=L",
    "=C - C",
    "=9**9**9**9",
    "=exp(exp(99))",
    "=w0",
    "=R**-999",
    "=sqrt(-R)",
    "=min(L, C)",
)


@pytest.mark.parametrize("seed", range(4))
def test_an_expression_in_any_place_is_a_number_or_is_refused(seed):
    rng = Random(seed)
    refused = 0
    for _ in range(60):
        table = copy.deepcopy(FILTER) | {"sweep": {"controller.k_d": [0.0, 1e-6]}}
        place = rng.choice(places(table))
        holder: Any = table
        for key in place[:-1]:
            holder = holder[key]
        holder[place[-1]] = rng.choice(HOSTILE)
        try:
            study = dj.Study.from_table(table)
        except ConfigError:
            refused += 1
            continue
        values = study.params({name: law.median for name, law in study.laws.items()})
        assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(values))
    assert 20 < refused < 60


@pytest.mark.parametrize("precision", [32, 64])
def test_the_precision_is_the_study_s(precision):
    study = dj.Study.from_table(with_changes(FILTER, {"loop.precision": precision, "draws": 4}, ""))
    result = dj.run(study)
    assert result.dataset["error_rms"].dtype == f"float{precision}"
    exact = dj.run(study.override({"loop.precision": 64})).dataset["error_rms"]
    np.testing.assert_allclose(result.dataset["error_rms"], exact, rtol=1e-3 if precision == 32 else 0.0)
