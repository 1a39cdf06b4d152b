"""A y' with a scale or an offset that the controller did not get, told by y and by the controller's command."""

import numpy as np
import pytest

from tests.flight_logs.hints.test_replayed_columns import flown, flown_with_rates, study, told

assert study  # the fixture


@pytest.mark.parametrize(
    ("scale", "offset", "words"),
    [
        (1.25, 0.0, "with a scale of 0.8 for"),
        (1.0, 0.5, "with an offset of -0.5 m/s for"),
        (1.25, 0.5, "with a scale of 0.8 and an offset of -0.4 m/s for"),
    ],
)
def test_a_scale_and_an_offset_are_told_with_what_mends_them(study, scale, offset, words):
    smooth, columns = flown_with_rates(study)
    codes, text = told(smooth, {**columns, "y_dot": scale * columns["y_dot"] + offset})
    assert codes == {"y_dot": "wrong-scale"}
    assert words in text


@pytest.mark.parametrize("gains", [(6.0, 5.0, 2.0), (9.0, 4.0, 2.0), (6.0, 8.0, 2.0)])
def test_a_sound_rate_and_other_gains_tell_none(study, gains):
    codes, _ = told(study, flown(gains=gains))
    assert "y_dot" not in codes


def test_a_noisy_flight_tells_none(study):
    noisy = flown(noise=0.02)
    noisy["u_total"] = noisy["u_total"] + 0.5 * np.sin(np.arange(len(noisy["y"])))
    codes, _ = told(study, noisy)
    assert "y_dot" not in codes
