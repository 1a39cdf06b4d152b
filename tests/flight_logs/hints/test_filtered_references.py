"""References that a log has filtered or held, and the controller got as they are in the study."""

import numpy as np
import pytest

from dssc_jax.flight_logs.hints.filtered_references import filtered_text
from tests.flight_logs.hints.test_replayed_columns import DT, flown_with_rates, study, told

assert study  # the fixture


def lagged(values, time):
    """Values behind a first-order lag, by steps of its exact solution."""
    states = [values[0]]
    for value in values[1:]:
        states.append(states[-1] + (1.0 - np.exp(-DT / time)) * (value - states[-1]))
    return np.array(states)


def held(values, samples):
    """Values of a topic that is as rare."""
    return values[np.arange(len(values)) // samples * samples]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (lambda values: lagged(values, 0.1), "it is behind a first-order lag of 0.1 s"),
        (lambda values: held(values, 10), "it is held for 0.2 s at a time"),
        (lambda values: values + 0.05 * np.cos(20.0 * np.arange(len(values))), "it is another topic's, such as"),
    ],
)
def test_a_reference_that_the_log_has_changed_is_told(study, changed, words):
    smooth, columns = flown_with_rates(study)
    codes, text = told(
        smooth, {**columns, "y_ref": changed(columns["y_ref"]), "y_ref_dot": changed(columns["y_ref_dot"])}
    )
    assert codes == {"y_ref": "another-reference"}
    assert text.startswith("y_ref is not what the controller got, which is the study's: with the study's reference the")
    assert words in text


def test_the_same_reference_and_another_flight_tell_nothing(study):
    smooth, columns = flown_with_rates(study)
    assert told(smooth, columns) == ({}, "")
    other = {**columns, "u_total": 1.5 * columns["u_total"] + columns["y"]}
    codes, _ = told(smooth, {**other, "y_ref": lagged(columns["y_ref"], 0.1)})
    assert "y_ref" not in codes


def test_a_reference_of_noise_is_neither_filtered_nor_held():
    random = np.random.default_rng(0)
    assert filtered_text(random.normal(size=300), np.sin(0.02 * np.arange(300)), DT) == ""
