"""What a large residual leads to: the likely cause comes first, and the general advice where there is none."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import Unexplained
from dssc_jax.flight_logs.fit.residual_advice import cause_text
from dssc_jax.flight_logs.signal_warnings import SignalWarning
from tests.flight_logs.fit.test_fit import linear, log_of
from tests.flight_logs.fit.test_missing_parts import K_P, commands_of, flown, no_force


def test_a_doubt_and_a_refusal_name_the_cause_before_anything_else():
    u = commands_of(8)
    wind = 0.1 / K_P * (np.arange(len(u)) >= 130)
    predictions = {}
    fitted = fit_log(linear(), log_of(flown(no_force, 8, u + 0.3 * wind), u), predictions=predictions)
    assert [doubt.code for doubt in fitted.doubts] == ["missing-force", "large-residual"]
    text = fitted.doubts[1].text
    assert text.endswith(
        "another warning names what may cause it (missing-force). Mend that first: estimates may be wrong by more than "
        "their intervals"
    )
    with pytest.raises(Unexplained) as refused:
        fit_log(linear(), log_of(flown(no_force, 8, u + wind), u), predictions=predictions)
    refusal = str(refused.value)
    assert refusal.index("A constant force") < refusal.index("Compare the log's columns")


def test_only_causes_of_the_channel_count():
    delay = SignalWarning("x_u_total", "delayed-command", "")
    assert "(delayed-command)" in cause_text("x", [delay, delay])
    assert "the study lacks something" in cause_text("y", [delay])
    assert "(level-start)" in cause_text("y", [SignalWarning("", "level-start", "")])
