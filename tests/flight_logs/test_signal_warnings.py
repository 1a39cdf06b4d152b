"""The warnings of compare-log: one list for comparisons, fits and refusals, which console and JSON share."""

import json

import numpy as np
import pytest
import tomli_w

from dssc_jax.cli.main import guarded
from dssc_jax.flight_logs.signal_warnings import (
    Hint,
    SignalWarning,
    causes_first,
    joined_warnings,
    signal_warnings,
)
from tests.cli.conftest import last_json
from tests.flight_logs.fit.test_fit import DT, linear, output

TIME = DT * np.arange(400)


@pytest.fixture
def late_reference(tmp_path, monkeypatch):
    """Arguments of a comparison with a sound flight whose logged reference is 1 s late."""
    monkeypatch.chdir(tmp_path)
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    y = output(1.1, 0.8, u) + 0.01 * random.normal(size=400)
    reference = (TIME >= 3.0 - 1e-9).astype(float)
    rows = [f"{t},{a},{b},{c}" for t, a, b, c in zip(TIME, y, u, reference, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["t,y,u_total,y_ref", *rows]))
    study = linear(reference={"kind": "step", "size": 1.0, "at": 2.0}, draws=19)
    (tmp_path / "s.toml").write_text(tomli_w.dumps(study.table))
    return ["compare-log", "s.toml", "log.csv"]


def test_a_hint_becomes_a_sentence():
    assert signal_warnings({"y": Hint("delayed-output", "is late")}) == (
        SignalWarning("y", "delayed-output", "y is late"),
    )


@pytest.mark.parametrize("options", [[], ["--fit"]])
def test_comparison_and_fit_warn_in_one_list(late_reference, capsys, options):
    """The exit code is 0, and one entry of the JSON tells whether there are warnings."""
    assert guarded([*late_reference, *options, "--json"]) == 0
    found = last_json(capsys)
    assert "hints" not in found
    assert found["warned"] is True
    (warning,) = [entry for entry in found["warnings"] if entry["signal"] == "y_ref"]
    assert warning.keys() == {"signal", "code", "text"}
    assert warning["code"] == "shifted-reference"
    assert warning["text"].startswith("y_ref is the study's, 1 s later")
    assert guarded([*late_reference, *options, "--out", "again"]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for entry in found["warnings"]:
        assert printed.count("warning: " + " ".join(entry["text"].split())) == 1


def test_a_refused_fit_keeps_its_warnings(late_reference, capsys):
    """Two numbers of the same gain are not identified."""
    table = linear().table
    plant = table["plant"] | {"k_p": {"uniform": [1.0999, 1.1001]}, "a_p": {"uniform": [0.7999, 0.8001]}}
    changed = linear(plant=plant, reference={"kind": "step", "size": 1.0, "at": 2.0})
    with open("s.toml", "w") as file:
        file.write(tomli_w.dumps(changed.table))
    assert guarded([*late_reference, "--fit", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["identifiable"] is False
    assert found["warned"]
    assert [entry["signal"] for entry in found["warnings"]] == ["y_ref"]


def test_causes_stand_before_effects():
    effect = SignalWarning("u_total", "another-command", "u_total is not ...")
    cause = SignalWarning("y", "wrong-scale", "y is ...")
    assert causes_first([effect, cause]) == (cause, effect)


def test_a_fault_of_the_log_stands_before_a_delay_that_would_explain_it():
    """As in a log of 10 Hz of a loop of 50 Hz."""
    codes = ("rare-command", "command-jump", "delayed-output", "large-residual")
    warnings = tuple(SignalWarning("", code, "...") for code in codes)
    delay_first = (warnings[2], warnings[1], warnings[0], warnings[3])
    assert causes_first(delay_first) == warnings
    parts = tuple(SignalWarning("y", code, "...") for code in ("missing-lag", "delayed-output"))
    assert causes_first(parts) == parts


def test_what_replay_and_fit_tell_is_told_once():
    of_replay = SignalWarning("u_total", "command-dropouts", "by the replay")
    of_fit = SignalWarning("u_total", "command-dropouts", "by the fit")
    residual = SignalWarning("y", "large-residual", "y ...")
    assert joined_warnings([of_replay], [residual, of_fit]) == (of_fit, residual)
    assert joined_warnings([of_replay], []) == (of_replay,)


def test_a_command_without_a_cause_refers_to_those_of_its_output():
    """Of the same channel only."""
    command = SignalWarning(
        "x_u_total", "another-command", "x_u_total is not ... by 1 m/s. The cause is open: other ..."
    )
    filtered = SignalWarning("x_y", "filtered-output", "a low pass of x_y")
    elsewhere = SignalWarning("z_y", "outliers", "z_y has ...")
    (told,) = [
        warning for warning in joined_warnings([command], [filtered, elsewhere]) if warning.signal == "x_u_total"
    ]
    assert told.text == "x_u_total is not ... by 1 m/s. Another warning names what may cause it (filtered-output)"
    assert command in joined_warnings([command], [elsewhere])


def test_parts_and_delays_of_a_log_with_another_fault_say_so():
    part = SignalWarning("y", "missing-lag", "a lag would explain part of the residual of y")
    effect = SignalWarning("y", "large-residual", "the residual of y is large")
    spikes = SignalWarning("u_total", "command-spikes", "u_total has single values")
    rounded = SignalWarning("t", "repeated-times", "times are rounded")
    scale = SignalWarning("y_ref", "wrong-scale", "y_ref is 2 times the study's")
    told = joined_warnings([spikes, rounded], [part, effect])
    assert [warning.code for warning in told] == ["command-spikes", "repeated-times", "missing-lag", "large-residual"]
    assert told[2].text == (
        "a lag would explain part of the residual of y. The log has another fault (command-spikes of u_total, "
        "repeated-times of t), which this may only resemble: mend that first"
    )
    assert told[3] == effect
    assert joined_warnings([scale], [part])[1] == part  # a fit of logged commands uses no reference
