"""The clock of a log without a reference: told where the analysed controller shows it, and nowhere else."""

import re

import pytest

from dssc_jax.flight_logs.replay import replay_log
from tests.flight_logs.closed_loop import Axis, Pid, fly, study_of


def hints_of(log):
    """The hints about a log without its reference and its rate."""
    columns = {name: log.columns[name] for name in ("y", "u_total")}
    return replay_log(study_of(), log._replace(columns=columns)).hints.all()


@pytest.mark.parametrize(("rate", "words"), [(1.015, "1.015 times too slow"), (1.0 / 1.015, "1.015 times too fast")])
def test_a_clock_is_told_by_the_controller(rate, words):
    hints = hints_of(fly(axis=Axis(rate=rate)))
    assert list(hints) == ["y_ref"]
    assert hints["y_ref"].code == "clock-rate"
    assert f"the log's clock is {words}" in hints["y_ref"].text
    stretch = re.search(r"with the study's at times x (\S+) the", hints["y_ref"].text)[1]
    assert float(stretch) == pytest.approx(1.0 / rate, abs=1e-4)


def test_a_sound_log_and_other_gains_have_no_clock():
    assert hints_of(fly()) == {}
    assert list(hints_of(fly(gains=Pid(k_p=9.0, k_d=4.5)))) == ["u_total"]
