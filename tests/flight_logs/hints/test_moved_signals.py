"""References and outputs that reached the controller at another time; other faults and gains are none of these."""

import numpy as np
import pytest

from dssc_jax.flight_logs.hints.moved_signals import moved
from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.hints.test_replayed_columns import GAINS, PULSES, TIME, flown, flown_by_error, log_of, study

assert study  # the fixture


def told_of(study, columns):
    """The warnings of a replay: code and text, by signal."""
    return {warning.signal: (warning.code, warning.text) for warning in replay_log(study, log_of(columns)).warnings}


@pytest.mark.parametrize(("shift", "words"), [(15, "0.3 s later"), (-10, "0.2 s earlier"), (2, "0.04 s later")])
@pytest.mark.parametrize("is_logged", [True, False])
def test_the_time_of_the_reference_is_found(study, shift, words, is_logged):
    columns = flown(reference=moved(PULSES, shift))
    if not is_logged:
        del columns["y_ref"]
    warnings = told_of(study, columns)
    assert list(warnings) == ["y_ref"]
    code, text = warnings["y_ref"]
    assert code == "shifted-reference"
    begin = (
        "y_ref is not what the controller got: " if is_logged else "y_ref is not in the log, and the study's was used: "
    )
    assert text.startswith(f"{begin}with one {words} the analysed controller gives the logged u_total to ")


@pytest.mark.parametrize(("shift", "words"), [(15, "0.3 s earlier"), (4, "0.08 s earlier"), (-6, "0.12 s later")])
def test_the_time_of_the_output_is_found(study, shift, words):
    """A clock of the measurements beside that of the commands."""
    columns = flown()
    warnings = told_of(study, {**columns, **{name: moved(columns[name], shift) for name in ("y", "y_dot")}})
    code, text = warnings["y"]
    assert code == "shifted-output"
    assert text.startswith(f"y is not what the controller got at that time: with one {words} the analysed controller")
    assert "u_total" not in warnings


def test_the_time_of_the_output_is_found_beside_another_reference(study):
    """The replay takes the logged reference, which is not the study's."""
    by_error, columns = flown_by_error(study)
    columns["y_ref"] = 3.0 * np.sin(0.7 * TIME)
    columns["y"] = columns["y_ref"] - columns["u_total"]
    assert "y" not in told_of(by_error, columns)
    assert told_of(by_error, {**columns, "y": moved(columns["y"], 10)})["y"][0] == "shifted-output"


def test_other_faults_are_no_moved_references(study):
    """Other gains, a late command and another reference; of the last two, what is known of the reference is told."""
    other = {**flown(reference=np.sin(3.0 * np.arange(len(PULSES)) * 0.02)), "y_ref": PULSES}
    late = flown()
    late["u_total"] = moved(late["u_total"], 5)
    for columns, code in (
        (flown(), None),
        (flown(gains=(9.0, 4.0, 2.0)), "another-command"),
        (late, "shifted-command"),
        (other, "another-command"),
    ):
        assert [pair[0] for pair in told_of(study, columns).values()] == [code] * (code is not None)
    assert "or a measurement or the reference is not what" in told_of(study, other)["u_total"][1]
    del other["y_ref"]
    assert "the reference (the log has no y_ref: the study's was used)" in told_of(study, other)["u_total"][1]
    assert "y_ref" not in told_of(study, flown(gains=GAINS, force=0.3))
