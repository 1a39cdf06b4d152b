"""Certificates' files with one thing changed: none is valid, and none ends in a traceback."""

import copy
import json
from typing import Any

import numpy as np
import pytest
from flint import arb

from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.proofs.prove import VERSION, check_certificate, prove
from dssc_jax.proofs.verifier import small_gain
from dssc_jax.proofs.verifier.balls import StageLimits
from dssc_jax.proofs.verifier.impulse_responses import ResponseBounds
from dssc_jax.proofs.verifier.verdict import verify_certificate
from dssc_jax.proofs.words import loop_in_words
from tests.proofs.cases import CONSTANT, LOOP

QUICK = {"loop.sample_time": 0.005, "controller.functions": CONSTANT, "controller.rho": 2.0}
NO_NUMBERS = {
    "text": lambda value: str(value),
    "true": lambda value: True,
    "null": lambda value: None,
    "a list": lambda value: [value],
    "a table": lambda value: {"value": value},
    "NaN": lambda value: float("nan"),
    "infinity": lambda value: float("inf"),
    "minus infinity": lambda value: -float("inf"),
    "10^400": lambda value: 10**400,
    "an integer beyond float64's": lambda value: 2**60 + 1,
}
"""What may stand in place of a number, and is none."""
NUMBERS = (
    ("problem", "sample_time"),
    ("problem", "rho"),
    ("problem", "k_p", 0),
    ("problem", "functions", "tau_m"),
    ("problem", "initial", 0, 1),
    ("problem", "by_state", 2),
    ("proofs", 0, "box", "rate", 1),
    ("proofs", 0, "stages", 0, "sigma"),
    ("proofs", 0, "stages", 0, "change"),
    ("proofs", 0, "stages", 0, "slope"),
    ("proofs", 0, "stages", 0, "bounds", 1),
    ("proofs", 0, "stages", 0, "gains", 0),
    ("proofs", 0, "stages", 0, "p", 2, 1),
)
TABLES = (
    (),
    ("problem",),
    ("problem", "functions"),
    ("proofs", 0),
    ("proofs", 0, "box"),
    ("proofs", 0, "stages", 0),
)
LISTS = (
    ("problem", "k_p"),
    ("problem", "mu"),
    ("problem", "reference"),
    ("problem", "by_state"),
    ("problem", "initial"),
    ("problem", "initial", 0),
    ("proofs", 0, "box", "a_p"),
    ("proofs", 0, "stages", 0, "bounds"),
    ("proofs", 0, "stages", 0, "gains"),
    ("proofs", 0, "stages", 0, "p"),
    ("proofs", 0, "stages", 0, "p", 0),
)
HUGE = "1" + "0" * 400


@pytest.fixture(scope="module")
def certificate():
    """A valid one, with an interval of k_p."""
    outcome = prove(LOOP.override({**QUICK, "plant.k_p": {"uniform": [0.98, 1.02]}}))
    content = json.loads(json.dumps(outcome.certificate()))
    assert check_certificate(content).proved
    return content


def at(content, path):
    """What is at a path."""
    for key in path:
        content = content[key]
    return content


def changed(certificate, path, value) -> Any:
    """The certificate with another value at a path."""
    if not path:
        return value
    content = copy.deepcopy(certificate)
    at(content, path[:-1])[path[-1]] = value
    return content


def removed(table, name):
    """A table without one entry."""
    return {key: value for key, value in table.items() if key != name}


def malformed(certificate):
    """Pairs of a label and a certificate that is none."""
    for path in NUMBERS:
        for label, change in NO_NUMBERS.items():
            if (path[-1], label) != ("rho", "null"):  # a controller without a bound
                yield f"{path} is {label}", changed(certificate, path, change(at(certificate, path)))
    for path in TABLES:
        table = at(certificate, path)
        yield f"{path} with another entry", changed(certificate, path, {**table, "other": 1.0})
        yield f"{path} as a list", changed(certificate, path, list(table.values()))
        for name in table:
            yield f"{path} without {name}", changed(certificate, path, removed(table, name))
    for path in LISTS:
        values = at(certificate, path)
        yield f"{path} too short", changed(certificate, path, values[:-1])
        yield f"{path} too long", changed(certificate, path, [*values, values[-1]])
        yield f"{path} empty", changed(certificate, path, [])
        yield f"{path} as text", changed(certificate, path, json.dumps(values))
    for path in (("problem", "k_p"), ("problem", "mu"), ("proofs", 0, "box", "rate")):
        yield f"{path} swapped", changed(certificate, path, [0.02, 0.01])
    stage = ("proofs", 0, "stages", 0)
    size = len(at(certificate, (*stage, "p")))
    for i, j in ((i, j) for i in range(size) for j in range(size) if i != j):
        entry = (*stage, "p", i, j)
        yield f"P not symmetric at {i}, {j}", changed(certificate, entry, at(certificate, entry) * 1.0001 + 1e-9)
    replacements = {
        ("version",): [1, 5, 6.0, "6", None, True],
        ("complete",): [False, 1, "true"],
        ("problem", "sample_time"): [-0.005, 0.0],
        ("problem", "form"): ["explicit", ["implicit"], 1],
        ("problem", "start"): ["other", True, ["matched"]],
        ("problem", "functions", "kind"): ["pid", ["constant"], 3],
        ("problem", "mu"): [[0.0, 0.0], [-0.01, 0.01]],
        ("problem", "nominal"): [[], [1.0, 1.0], [1.0, 1.0, 1], [1.0, 0.0, True], False, 0, ""],
        ("problem", "reference_size"): [1.0],
        ("problem", "zero_a"): [[1.0], [1.0] * 1000],
        ("problem", "delay"): [1.0, -1.0],
        ("problem", "numerator"): [[], [2.0]],
        ("proofs",): [{}, None, "", [None], []],
        ("proofs", 0, "stages"): [{}, None, [], [[]]],
        (*stage, "coordinate"): ["q", ["u_av"], None, 1],
        (*stage, "change"): [0.0, -1.0],
        (*stage, "method"): ["trust me", ["small gain"], None, "invariant set"],
    }
    for path, values in replacements.items():
        for value in values:
            yield f"{path} is {value!r:.40}", changed(certificate, path, value)
    yield "null", None
    yield "a number", 5


def test_no_malformed_certificate_is_valid(certificate):
    """Each of several hundred is refused for its form, before anything is computed with it."""
    count = 0
    for label, content in malformed(certificate):
        count += 1
        version = content.get("version") if isinstance(content, dict) else None
        if type(version) is not int or version != VERSION:
            with pytest.raises(ConfigError, match="version"):
                check_certificate(content)
            continue
        verdict = check_certificate(content)
        assert not verdict.proved, label
        assert verdict.reason.startswith(("P0: ", "P1: ")), (label, verdict.reason)
        assert "\n" not in verdict.reason
    print(f"\n{count} malformed certificates")
    assert count > 300


@pytest.mark.parametrize("size", [1e300, 1e-300, -1.0])
def test_numbers_of_any_size_give_a_verdict(certificate, size):
    """Scaled by a power of ten or with another sign; only a bound that is larger, or a claim that is less, may hold."""
    for path in NUMBERS:
        verdict = check_certificate(changed(certificate, path, size * at(certificate, path)))
        assert verdict.largest_error < float("inf") if verdict.proved else verdict.reason, path


FILES = {
    "NaN": ('"sigma": 1', '"sigma": NaN', "NaN is not a finite number"),
    "infinity": ('"sigma": 1', '"sigma": -Infinity', "-Infinity is not a finite number"),
    "1e400": ('"sigma": 1', '"sigma": 1e400', "1e400 is too large a number"),
    "10^400": ('"sigma": 1', f'"sigma": {HUGE}', "is too large a number"),
    "10^5000": ('"sigma": 1', f'"sigma": {HUGE * 12}', "is too large a number"),
    "twice": ('"sigma": 1', '"sigma": 1, "sigma": 1', "the entry 'sigma' occurs more than once"),
    "deep lists": ('"sigma": 1', '"sigma": ' + "[" * 100_000, "too deeply"),
    "deep tables": ('"sigma": 1', '"sigma": ' + '{"a": ' * 100_000, "too deeply"),
    "half": ('"sigma": 1', '"sigma": ', "cannot be read"),
}


@pytest.mark.parametrize("label", FILES)
def test_no_file_that_is_none_ends_in_a_traceback(certificate, label, tmp_path, capsys):
    """One line, and exit code 2."""
    old, new, message = FILES[label]
    content = json.dumps(changed(certificate, ("proofs", 0, "stages", 0, "sigma"), 1))
    assert old in content
    (tmp_path / "forged.json").write_text(content.replace(old, new, 1))
    assert guarded(["prove", str(tmp_path / "forged.json")]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert message in lines[0]


def test_a_sweep_of_other_things_is_refused(tmp_path, capsys):
    """In place of certificates, numbers; in place of a point's answer, nothing."""
    for content in ({"points": [{"proved": True}], "certificates": [3]}, {"points": 3, "certificates": 3}):
        (tmp_path / "proofs.json").write_text(json.dumps(content))
        assert guarded(["prove", str(tmp_path / "proofs.json")]) == 2
        assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_infinite_bounds_prove_nothing(certificate, monkeypatch):
    """Even where every inequality holds, as it may among numbers near the end of float64's range."""
    limits = [StageLimits(arb(1), arb(1), arb(1), arb("1e400"), arb(0), arb(0), arb(0))]
    monkeypatch.setattr("dssc_jax.proofs.verifier.verdict.verified_stages", lambda problem, proof: limits)
    verdict = verify_certificate(certificate)
    assert not verdict.proved
    assert verdict.reason == "P0: a bound of |e| is not finite, and proves nothing"


def test_a_verified_file_names_its_loop(certificate, tmp_path, capsys):
    """Every number of the problem that makes the statement, to its last digit, in words and as JSON."""
    content = changed(certificate, ("problem", "slope"), certificate["problem"]["slope"] * (1.0 - 1e-15))
    path = tmp_path / "proof.json"
    path.write_text(json.dumps(content))
    assert guarded(["prove", str(path)]) == 0
    shown = capsys.readouterr().out
    problem = content["problem"]
    words = (
        "implicit form, T_s = 0.005 s, l_0 = 0.5 1/s, rho = 2.0, predictor's start matched",
        "constant with k_o = 5.0, tau_av = 0.05, tau_m = 0.5",
        f"k_p in [{problem['k_p'][0]}, {problem['k_p'][1]}], a_p = 0.3 1/s, order 2",
        "e = 0.2, e' = 0.0",
        "G(mu s) = [1.0]/[1.0, 2.0, 1.0] in rising powers of mu s, mu = 0.01 s",
        f"any (wind, load) with |d| <= {problem['level']} and slope |d'| <= {problem['slope']} 1/s",
        "at rest",
    )
    for part in words:
        assert part in shown
    assert guarded(["prove", str(path), "--json"]) == 0
    loop = json.loads(capsys.readouterr().out)["loop"]
    assert set(words) <= set(loop.values())


def test_words_of_other_loops(certificate):
    """References, sensors, delays, zero dynamics and disturbances that depend on the state."""
    changes = {
        "reference": [1.0, 2.0, 3.0],
        "numerator": [],
        "denominator": [],
        "mu": [0.0, 0.0],
        "delay": 1.5,
        "sensor_lag": 0.25,
        "zero_a": [2.0],
        "zero_c": [0.5],
        "initial": [[0.0, 1.0], [0.0, 0.0], [-1.0, 1.0]],
        "by_state": [0.0, 0.0, 0.7, 0.0, 0.0],
        "nominal": [0.5, 1.1, False],
        "rho": None,
    }
    loop = loop_in_words(certificate["problem"] | changes)
    assert loop["reference"] == "any with |y_m'| <= 1.0, |y_m''| <= 2.0, |y_m'''| <= 3.0"
    assert loop["unmodelled"] == "delay of 1.5 samples"
    assert loop["sensor"] == "lag of 0.25 s"
    assert loop["plant"].endswith("order 3, zero dynamics a = [2.0], c = [0.5]")
    assert loop["start"] == "e in [0.0, 1.0], e' = 0.0, eta_1 in [-1.0, 1.0]"
    assert "k_d3 = 0.7" in loop["disturbance"]
    assert loop["nominal"] == "a_n = 0.5 1/s, k_n = 1.1, without its term 1/tau_m"
    assert "without a bound of the command" in loop["controller"]


def test_a_bound_that_only_equals_what_it_implies_is_refused(certificate, monkeypatch):
    """With M Y = Y the upper limits may be anything: P7 asks for less."""
    stage = certificate["proofs"][0]["stages"][0]
    bounds = np.array(stage["bounds"])
    content = changed(certificate, ("proofs", 0, "stages"), [stage])
    for share, proved in ((1.0 - 1e-9, True), (1.0, False)):
        answer = ResponseBounds(np.zeros((bounds.size, 100)), share * bounds)
        monkeypatch.setattr(small_gain, "response_bounds", lambda *_, answer=answer: answer)
        verdict = verify_certificate(content)
        assert verdict.proved is proved, verdict.reason
    assert verdict.reason.startswith("P7: the bound of signal 0")
