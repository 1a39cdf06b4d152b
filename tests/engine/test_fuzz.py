"""Random programs of jax.lax: machine code agrees with an independent referee, and a planted fault is found."""

import sys
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from benchmarks.fuzz import crew, worker
from benchmarks.fuzz.arithmetic import stepped
from benchmarks.fuzz.checking import differences
from benchmarks.fuzz.crew import Crew
from benchmarks.fuzz.generate import NAMES, SINGLES, VARIANTS, generate
from benchmarks.fuzz.program import text
from benchmarks.fuzz.referee import Referee
from benchmarks.fuzz.values import TYPES
from benchmarks.fuzz.worker import Unit
from dssc_jax.engine import kernels
from dssc_jax.lanes.functions import elementary
from dssc_jax.lanes.tracing import primitives

pytestmark = pytest.mark.filterwarnings("ignore")  # JAX's, when it is asked whether it takes some operands

KINDS = ("float64", "int32", "float32", "uint8", "int64", "bool", "uint32", "int16", "float64", "uint64")
SETS = {
    "alone": [(name, KINDS[i % 10], i % VARIANTS) for i, name in enumerate(NAMES)],
    "alone, other types": [(name, KINDS[(3 * i + 1) % 9], (i + 4) % VARIANTS) for i, name in enumerate(NAMES)],
    "together": [],
}


def alone(operation, dtype, variants=range(4)):
    """Seeds of an operation in a type."""
    start = (NAMES.index(operation) * len(TYPES) + TYPES.index(dtype)) * VARIANTS
    return [start + variant for variant in variants]


def ran(seeds, with_xla=False):
    """A unit after its run."""
    unit = Unit(seeds, with_xla)
    unit.run()
    return unit


@pytest.mark.parametrize("name", SETS)
def test_no_program_is_wrong_or_ends_unexpectedly(name, monkeypatch):
    monkeypatch.setattr(worker, "MOST_FALL_BACKS", 3)  # XLA takes long to compile them
    monkeypatch.setattr(worker, "REFUSALS", set())
    alone_ones = [seed for name, dtype, variant in SETS[name] for seed in alone(name, dtype, [variant])]
    unit = ran(alone_ones or list(range(SINGLES, SINGLES + 24)))
    assert [(found["kind"], found["seed"], found["said"]) for found in unit.findings] == []
    assert unit.counts["programs"] == unit.counts["compiled"] + unit.counts["fell back"]
    assert unit.counts["compiled"] > 20
    assert unit.counts["unclear results"] < 0.1 * unit.counts["results"]


def test_a_seed_is_a_program():
    assert text(generate(SINGLES + 7)) == text(generate(SINGLES + 7))
    assert text(generate(SINGLES + 7)) != text(generate(SINGLES + 8))


def test_the_referee_agrees_with_plain_xla():
    unit = ran(list(range(SINGLES + 30, SINGLES + 36)), with_xla=True)
    assert unit.counts["with xla"] >= 4
    assert unit.counts["xla differs"] == 0


def test_a_wrong_rule_is_found(monkeypatch):
    rules = primitives.ELEMENT_RULES
    monkeypatch.setitem(rules, "min", replace(rules["min"], translate=rules["max"].translate))
    unit = ran(alone("min", "int16"))
    assert {found["kind"] for found in unit.findings} == {"wrong"}
    assert {found["mode"] for found in unit.findings} == {"fast", "strict"}
    assert "min(" in unit.findings[0]["program"]


def test_a_function_that_is_off_by_a_few_units_is_found(monkeypatch):
    rule = elementary.ELEMENTARY["exp"]
    off = replace(rule, translate=lambda x: rule.translate(x) * (1.0 + 6.0 * jnp.finfo(x.dtype).eps))
    monkeypatch.setitem(elementary.ELEMENTARY, "exp", off)
    assert {found["kind"] for found in ran(alone("exp", "float64")).findings} == {"wrong"}


def test_a_rule_that_raises_is_found(monkeypatch):
    def broken(*operands):
        raise KeyError("planted")

    rules = primitives.ELEMENT_RULES
    monkeypatch.setitem(rules, "min", replace(rules["min"], translate=broken))
    unit = ran(alone("min", "int16"))
    assert {found["kind"] for found in unit.findings} == {"exception"}
    assert unit.counts["crashed"] == len(unit.findings)


def test_a_fall_back_without_a_warning_is_found(monkeypatch):
    monkeypatch.setattr(worker, "REFUSALS", set())
    assert ran(alone("sort", "float64")).findings == []
    monkeypatch.setattr(worker, "REFUSALS", set())
    monkeypatch.setattr(kernels, "warn_of_plain_xla", lambda reason: None)
    assert {found["said"] for found in ran(alone("sort", "float64")).findings} == {"no warning"}


FRAGILE = """
import json, os, sys
for line in sys.stdin:
    seeds = json.loads(line)["seeds"]
    if SINGLES + 5 in seeds:
        os.abort()
    print(json.dumps({"stage": "fast"}))
    print(json.dumps({"counts": {"programs": len(seeds)}, "operations": {}, "refused": {}, "findings": []}), flush=True)
"""


def test_a_program_that_ends_its_process_is_found(monkeypatch):
    script = FRAGILE.replace("SINGLES", str(SINGLES))
    monkeypatch.setattr(crew, "COMMAND", [sys.executable, "-c", script])
    hands = Crew([(list(range(SINGLES, SINGLES + 8)), False), ([SINGLES + 9], False)], workers=2)
    hands.run()
    assert hands.counts["programs"] == 9
    assert hands.counts["crashed"] == 1
    (found,) = hands.findings
    assert (found["kind"], found["seed"]) == ("end of the process", SINGLES + 5)
    assert found["program"] == text(generate(SINGLES + 5))


def test_strict_arithmetic_must_agree_in_every_bit():
    exact = np.tile(np.array([1.0, 0.0, np.nan, np.inf]), (8, 1))
    close = np.array([np.nextafter(1.0, 2.0), -0.0, np.nan, np.inf])
    assert differences(close, exact, False, 1.0)[0].tolist() == [True, True, False, False]
    assert differences(close, exact, True, 1.0)[0].tolist() == [True, False, False, False]


def test_a_spread_bounds_the_error_and_a_contradiction_says_nothing():
    spread = np.array([[1.0, 3.0], [1.0 + 4e-16, np.nan]])
    wrong, unclear = differences(np.array([1.0 + 2e-16, 7.0]), spread, False, 1.0)
    assert (wrong.tolist(), unclear.tolist()) == ([False, False], [False, True])
    assert differences(np.array([1.0 + 1e-15, 7.0]), spread, False, 1.0)[0].tolist() == [True, False]


def test_steps_are_units_in_the_last_place():
    x = np.array([1.0, -1.0, 0.0, np.finfo(float).max, np.nan])
    np.testing.assert_array_equal(stepped(x, 1), np.nextafter(x, np.inf))
    np.testing.assert_array_equal(stepped(x, -1), np.nextafter(x, -np.inf))


def test_every_type_of_arithmetic_has_replicas_that_begin_undisturbed():
    program = generate(alone("exp", "float64")[0])
    columns = [np.linspace(-1.0, 1.0, 5) for _ in program.inputs]
    (results,) = Referee(fast=False).results(program, columns)
    assert np.ptp(results, axis=0).max() > 0.0
    assert results.shape[:2] == (8, 5)
