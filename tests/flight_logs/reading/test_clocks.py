"""Times of a log that fall, jump, or count milliseconds; files that are empty, cut or asked beyond their end."""

import itertools
import struct

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.reading.clocks import falls_of, gaps_of, repeated_times_text, rising_rows, row_numbers_text
from dssc_jax.flight_logs.reading.contents import log_contents, topic_table
from dssc_jax.flight_logs.reading.coverage import few_samples_remedy, time_unit_text, times_text
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.reading.ulog import list_topics
from tests.cli.conftest import last_json
from tests.flight_logs.fit.test_fit import linear
from tests.flight_logs.reading.test_ulog import TAKEOFF, log_head, message

pytest.importorskip("pyulog")

RATE = np.arange(100) * 0.02  # s


def ulog(path, stamps, other=RATE):
    """A log of a topic ``rate`` with these stamps [s], and of a topic ``other``, from the time 1 s on."""
    formats = ["rate:uint64_t timestamp;float value;", "other:uint64_t timestamp;float value;"]
    parts = [log_head(formats, [("rate", 0), ("other", 0)], 1_000_000)]
    for number, times in enumerate((stamps, other)):
        for index, stamp in enumerate(times):
            parts.append(message(b"D", struct.pack("<HQf", number, round(1e6 * (stamp + 1.0)), index)))
    path.write_bytes(b"".join(parts))
    return path


def topic(contents, name):
    return next(topic for topic in contents.topics if topic.name == name)


@pytest.mark.parametrize("seed", range(20))
def test_the_fewest_rows_are_left_out(seed):
    """Of all subsets that rise, none is larger."""
    time = np.random.default_rng(seed).integers(0, 6, 9).astype(float)
    kept = rising_rows(time)
    assert (np.diff(kept) > 0).all()
    assert (np.diff(time[kept]) >= 0.0).all()
    larger = itertools.combinations(range(9), len(kept) + 1)
    assert not any((np.diff(time[list(rows)]) >= 0.0).all() for rows in larger)


def test_a_stray_time_is_named_and_left_out_on_request(tmp_path):
    """Row 41 jumps ahead; the 60 rows after it are not to blame."""
    time = RATE.copy()
    time[40] = 50.0
    log = ulog(tmp_path / "a.ulg", time)
    table = {"signals": {"y": "rate.value"}}
    told = r"a.ulg: y: .*: 0.82 s comes after 50 s in row 42; 1 of 100 rows would .* `allow_damaged` leaves"
    with pytest.raises(ConfigError, match=told):
        dj.read_log(log, table=table)
    read = dj.read_log(log, table=table, allow_damaged=True)
    assert read.dropped == {"y": 1}
    np.testing.assert_allclose(read.columns["y"].time, np.delete(RATE, 40), atol=1e-9)
    np.testing.assert_array_equal(read.columns["y"].value, np.delete(np.arange(100.0), 40))
    contents = log_contents(log)
    assert (topic(contents, "rate").falls, topic(contents, "rate").rate) == (1, pytest.approx(50.0))
    assert contents.gaps == []


def test_a_clock_that_was_set_back_is_no_stray_time(tmp_path, capsys):
    """Where NumPy sees the first fall; the rate is that of the messages."""
    time = np.where(RATE < 1.2, RATE, RATE - 0.6)
    log = ulog(tmp_path / "back.ulg", time)
    for allowed in (False, True):
        with pytest.raises(ConfigError, match=r"0.6 s comes after 1.18 s in row 61, and 29 of 100 .* was set back"):
            dj.read_log(log, table={"signals": {"y": "rate.value"}}, allow_damaged=allowed)
    contents = log_contents(log)
    first = int(np.argmax(np.diff(time) < 0))
    (fall,) = contents.falls
    assert fall.topics == ("rate",)
    assert fall.stamps == pytest.approx((time[first], time[first + 1]))
    assert topic(contents, "rate").rate == pytest.approx(50.0)
    assert topic(contents, "other").rate == pytest.approx(50.0)
    assert guarded(["log", str(log)]) == 0
    assert "times fall once, first from 1.180 s to 0.600 s: rate\n" in capsys.readouterr().out


def test_a_hole_is_told_for_all_topics_that_have_it(tmp_path, capsys):
    jumping = np.where(RATE < 0.5, RATE, RATE + 2.0)
    log = ulog(tmp_path / "jump.ulg", jumping, jumping + 0.001)
    (gap,) = log_contents(log).gaps
    assert sorted(gap.topics) == ["other", "rate"]
    assert gap.stamps == pytest.approx((0.48, 2.5))
    assert guarded(["log", str(log), "--json"]) == 0
    assert last_json(capsys)["logs"][0]["gaps"][0]["rate"] == pytest.approx(50.0)
    assert log_contents(ulog(tmp_path / "even.ulg", RATE)).gaps == []
    flight = list_topics(TAKEOFF).topics
    assert gaps_of(flight) == falls_of(flight) == []


def test_the_clock_of_a_table_is_told(tmp_path, capsys):
    """Where NumPy sees the first fall and the longest gap, also of a column that is not called t."""
    time = np.where(RATE < 1.2, RATE, RATE - 0.6)
    rows = "\n".join(f"{row},{1e6 * value:.0f}" for row, value in enumerate(time))
    (tmp_path / "back.csv").write_text(f"y,Timestamp [us]\n{rows}\n")
    (fall,) = log_contents(tmp_path / "back.csv").falls
    first = int(np.argmax(np.diff(time) < 0))
    assert fall.stamps == pytest.approx((1e6 * time[first], 1e6 * time[first + 1]))
    assert fall.topics == ("Timestamp [us]",)
    jump = np.where(RATE < 0.5, RATE, RATE + 2.0)
    (tmp_path / "jump.csv").write_text("t,y\n" + "\n".join(f"{value},{row}" for row, value in enumerate(jump)))
    assert guarded(["log", str(tmp_path / "jump.csv")]) == 0
    assert "no message from 0.480 s to 2.500 s, where 50 a second are usual" in capsys.readouterr().out
    (tmp_path / "even.csv").write_text("t,y\n" + "\n".join(f"{value},{row}" for row, value in enumerate(RATE)))
    even = log_contents(tmp_path / "even.csv")
    assert even.falls == even.gaps == []
    assert even.duration == pytest.approx(1.98)
    (tmp_path / "none.csv").write_text("name\na\n")
    assert guarded(["log", str(tmp_path / "none.csv")]) == 0
    assert "holds no message, and no column of numbers" in capsys.readouterr().out


def test_a_late_message_is_no_part_of_the_span(tmp_path, capsys):
    """One of a topic with a single message, and the last one of a topic with many."""
    assert log_contents(ulog(tmp_path / "a.ulg", [1174.0])).duration == pytest.approx(1.98)
    assert guarded(["log", str(tmp_path / "a.ulg")]) == 0
    printed = capsys.readouterr().out
    assert "a.ulg: 1.98 s" in printed
    assert "late: the last message of rate is at 1174 s, long after those of all others" in printed
    stray = log_contents(ulog(tmp_path / "b.ulg", [*RATE, 500.0]))
    assert (stray.duration, [message.topic for message in stray.late]) == (pytest.approx(1.98), ["rate"])
    slow = log_contents(ulog(tmp_path / "c.ulg", [0.0, 5.0]))  # sent at a change, a little after the others
    assert (slow.duration, slow.late) == (pytest.approx(5.0), ())


def test_a_log_of_a_header_alone_is_told(tmp_path, capsys):
    (tmp_path / "head.ulg").write_bytes(log_head([], [])[:16])
    assert guarded(["log", str(tmp_path / "head.ulg")]) == 0
    assert "head.ulg: 0 s\nit holds no message" in capsys.readouterr().out
    with pytest.raises(ConfigError, match="the log has no values of trajectory_setpoint, vehicle_local_position"):
        dj.read_log(tmp_path / "head.ulg", ("x",))


def test_times_in_milliseconds(tmp_path):
    rows = "\n".join(f"{1000 * t:.0f},{t}" for t in RATE)
    (tmp_path / "ms.csv").write_text(f"stamp,y\n{rows}\n")
    log = dj.read_log(tmp_path / "ms.csv", table={"time": {"column": "stamp", "scale": 0.001}, "start": 0.1})
    np.testing.assert_allclose(log.columns["y"].time, log.columns["y"].value, atol=1e-12)
    assert log.start == 0.1
    for entry, told in (
        (3, r"time: must be the name of a column, or a table"),
        ({"column": "stamp", "scale": 0.0}, r"time\.scale: .* above 0, got 0"),
        ({"column": 1}, r"time\.column"),
        ({"column": "stamp", "offset": 1.0}, r"time: .* column and scale"),
    ):
        with pytest.raises(ConfigError, match=told):
            dj.read_log(tmp_path / "ms.csv", table={"time": entry})


def test_a_table_of_a_topic_has_the_message_before_its_start(tmp_path, capsys):
    log = ulog(tmp_path / "a.ulg", RATE)
    table = topic_table(log, "rate", start=0.05)
    np.testing.assert_allclose(table["t"], RATE[2:] - 0.05, atol=1e-9)
    np.testing.assert_array_equal(table["value"], np.arange(2.0, 100.0))
    out = tmp_path / "late.csv"
    assert guarded(["log", str(log), "--topic", "rate", "--start", "500", "--csv", str(out)]) == 2
    assert "rate: has no message from 500 s on in the part asked for; its messages are from 0 s to 1.98 s" in (
        capsys.readouterr().err
    )
    assert not out.exists()


def test_an_empty_file_is_told_alike(tmp_path):
    (tmp_path / "empty.ulg").write_bytes(b"")
    for read in (log_contents, lambda path: dj.read_log(path, table={"signals": {"y": "rate.value"}})):
        with pytest.raises(ConfigError, match=r"^\S*/empty\.ulg: is no ULog: the file is empty$"):
            read(tmp_path / "empty.ulg")


def test_a_start_after_the_end_is_refused(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t,y\n0,1\n0.5,2\n1,3\n")
    with pytest.raises(ConfigError, match=r"log.csv: start: is 1.5 s, and the log ends at 1 s"):
        dj.read_log(path, table={"time": "t", "start": 1.5, "signals": {"y": "y"}})


def test_a_cut_file_is_known(tmp_path):
    content = ulog(tmp_path / "a.ulg", RATE).read_bytes()
    (tmp_path / "cut.ulg").write_bytes(content[:-5])
    cut, whole = (FlightLog("a", {}, 0.0, file=path).is_cut() for path in (tmp_path / "cut.ulg", tmp_path / "a.ulg"))
    assert cut
    assert not whole
    assert not FlightLog("a", {}, 0.0).is_cut()


def test_gaps_and_rare_values_have_their_own_remedies():
    known = np.ones(100, bool)
    known[30:55] = False
    assert "at most 25 in a row (between 0.58 s and 1.1 s of the study)" in few_samples_remedy(known, 0.02)
    assert few_samples_remedy(np.arange(100) % 2 == 0, 0.02).startswith("log it as often as the controller runs")
    assert few_samples_remedy(np.zeros(100, bool), 0.02).startswith("log it as often")
    assert few_samples_remedy(np.arange(100) < 7, 0.02).startswith("it has values from 0 s to 0.12 s of the study only")


def test_a_clock_that_is_set_back_for_a_while_is_refused(tmp_path):
    """Nineteen of 400 rows in a row are few enough, and yet no stray ones; four alone are left out on request."""
    table = tmp_path / "a.csv"
    for count in (4, 19):
        time = 0.02 * np.arange(400)
        time[200 : 200 + count] -= 1.0
        table.write_text("t,y\n" + "".join(f"{t:.6g},{k}\n" for k, t in enumerate(time)))
        if count == 4:
            assert len(dj.read_log(table, allow_damaged=True).columns["y"].time) == 396
            continue
        with pytest.raises(ConfigError, match="19 of 400 rows would have to go: the clock of the log was set back"):
            dj.read_log(table, allow_damaged=True)


def test_a_column_with_text_is_named(tmp_path):
    table = tmp_path / "a.csv"
    table.write_text("t,y,z,armed\n0,1,1,False\n0.1,ERR,2,True\n0.2,3,3,True\n")
    contents = log_contents(table)
    assert contents.text_columns == ("y",)  # truth values are no text
    assert contents.text_cells == ("y: line 3 has 'ERR'",)
    assert [field.name for field in contents.fields] == ["t", "z"]


def test_times_that_repeat_are_told():
    rounded = repeated_times_text(np.round(RATE, 1))
    assert rounded.startswith("repeats from one row to the next in 79 of 100 rows, and rises by 0.1 s else")
    doubled = repeated_times_text(np.repeat(RATE, 2))
    assert doubled.startswith("repeats from one row to the next in 100 of 200 rows, and rises by 0.02 s else")
    assert repeated_times_text(RATE) == repeated_times_text(np.sort([*RATE, *RATE[:5]])) == ""


@pytest.mark.parametrize(("unit", "name"), [(1e-6, "microseconds"), (1e-9, "nanoseconds")])
def test_times_since_1970_in_another_unit_are_refused(unit, name):
    """Rounded to a number of 64 bits, one row would stand for many samples."""
    study = dj.Study.load("motor")
    time = (1.79e9 + study.loop.sample_time * np.arange(400)) / unit
    log = dj.FlightLog("log", {"y": Column(time, np.ones(400))}, float(time[0]))
    with pytest.raises(ConfigError, match=f"are so large that they are rounded to .*; its times are {name} since 1970"):
        dj.compare_log(study, log)


def test_a_topic_that_is_sent_in_bursts_has_no_gap(tmp_path):
    """Five bursts of five messages a second apart, and then nothing for five seconds; a steady topic has that gap."""
    bursts = np.concatenate([second + 0.01 * np.arange(5) for second in (0.0, 1.0, 2.0, 3.0, 4.0, 9.0)])
    steady = np.concatenate([0.02 * np.arange(200), 9.0 + 0.02 * np.arange(50)])
    gaps = log_contents(ulog(tmp_path / "bursts.ulg", bursts, steady)).gaps
    assert [gap.topics for gap in gaps] == [("other",)]


def test_times_that_count_rows_are_told():
    """Of a log far longer than the study; one that has a value a second is a rare one."""
    rows = np.arange(601.0)
    assert row_numbers_text(rows).startswith("counts 0, 1, 2 and so on: are these the numbers of rows?")
    assert row_numbers_text(0.02 * rows) == row_numbers_text(rows[:5]) == row_numbers_text(rows + 0.5) == ""
    log = FlightLog("log", {"y": Column(rows, np.sin(rows))}, 0.0)
    assert times_text(log, 12.0) == row_numbers_text(rows)
    assert times_text(log, 600.0) == ""
    assert time_unit_text(log, 0.02) == f"; its column of times {row_numbers_text(rows)}"
    rounded = log._replace(columns={"y": Column(np.floor(0.02 * rows), rows)})
    assert "repeats from one row to the next in 588 of 601 rows" in time_unit_text(rounded, 0.02)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("y,u\n0,1\n1,2\n", "a.csv: no column of times with numbers (t, or a name that begins with time"),
        ("t,y\n2024-06-01T12:00:00,1\n2024-06-01T12:00:01,2\n", "not shown: t (t: line 2 has '2024-06-01T12:00:00')"),
        ("t,y\ns,m\n0,1\n", "not shown: t, y (t: line 2 has 's'; y: line 2 has 'm')"),
    ],
)
def test_a_table_without_times_has_no_span(tmp_path, capsys, content, told):
    (tmp_path / "a.csv").write_text(content)
    assert guarded(["log", str(tmp_path / "a.csv")]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert told in printed
    assert "a.csv: no column of times" in printed
    assert "0 s" not in printed


def test_a_fit_of_a_log_without_an_output_names_the_column():
    """Before it counts values."""
    log = FlightLog("log", {name: Column(RATE, np.sin(RATE)) for name in ("y_dot", "u_total")}, 0.0)
    with pytest.raises(ConfigError, match=r"has no column of the measured output \(y, .*\) among y_dot, u_total"):
        fit_log(linear(), log)
