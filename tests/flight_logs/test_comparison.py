"""A logged flight beside the draws: an exact p-value, the controller's own commands, logs of several formats."""

import builtins
import struct

import numpy as np
import pytest
import tomli_w
from scipy import stats

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.console.flight import show_log_comparison
from dssc_jax.flight_logs.channel_replay import analysed_command, replayed_channel
from dssc_jax.flight_logs.hints.references import study_references
from dssc_jax.flight_logs.reading.reader import Column, FlightLog, nearest_values, read_log, samples_within
from dssc_jax.flight_logs.replay import curves_of_draws
from dssc_jax.statistics.exchangeable import extremeness, largest_departures, rank_p_value
from tests.cli.conftest import last_json
from tests.flight_code.test_code import table

DT = 0.01


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table({**table({"kind": "pi", "k_p": 1.0, "k_i": 0.5}), "draws": 59})


@pytest.fixture(scope="module")
def curves(study):
    """Measured output, command and measured derivative of many draws, shape (draws, 3, samples)."""
    drawn = curves_of_draws(study.override({"draws": 400}), 300)
    return np.array([[curve.y, curve.u_total, curve.y_dot] for (curve,) in drawn])


def logged(y, u, y_dot, begin=7.0):
    """What a flight computer logs."""
    time = begin + DT * np.arange(len(y))
    columns = {"y": Column(time, y), "u_total": Column(time, u), "y_dot": Column(time, y_dot)}
    return FlightLog("flight", columns, begin)


def flown(study):
    """The log of a study's first draw."""
    ((found,),) = curves_of_draws(study.override({"draws": 1}), study.loop.steps)
    return logged(found.y, found.u_total, found.y_dot)


def p_values(groups):
    """The p-value of each group's last curve among the others."""
    return np.array([rank_p_value(extremeness(largest_departures(group[:-1], group[-1])[0])) for group in groups])


def test_every_curve_of_a_set_has_another_rank(curves):
    """Medians of all curves, the tested one among them: the p-values of n + 1 curves in turn are all the ranks."""
    tested = curves[:25]
    turned = [np.concatenate([np.delete(tested, i, axis=0), tested[i : i + 1]]) for i in range(25)]
    np.testing.assert_allclose(np.sort(p_values(turned)), np.arange(1, 26) / 25, rtol=1e-12)


def test_p_is_uniform_for_flights_of_the_study(curves):
    found = p_values(curves.reshape(40, 10, 3, -1))
    counts = np.bincount(np.round(10 * found).astype(int), minlength=11)[1:]
    assert stats.chisquare(counts).pvalue > 0.01
    assert abs(found.mean() - 0.55) < 0.14  # three standard deviations of the mean of 40


def test_departures_by_hand():
    drawn = np.array([[[0.0, 1.0]], [[1.0, np.nan]], [[2.0, 3.0]]])
    largest, departure = largest_departures(drawn, np.array([[5.0, np.nan]]))
    np.testing.assert_allclose(
        departure, [[3.5, np.nan]]
    )  # median 1.5, deviations 1.5, 0.5, 0.5, 3.5: their median is 1
    np.testing.assert_allclose(largest[:, 0], [1.5, 0.5, 0.5, 3.5])
    np.testing.assert_array_equal(extremeness(largest), [1.0, 0.0, 0.0, 2.0])
    ended = np.array([[[0.0]], [[np.nan]], [[2.0]]])
    assert largest_departures(ended, np.array([[1.0]]))[0][1, 0] == np.inf
    with pytest.raises(ValueError, match="nothing"):
        largest_departures(drawn, np.full((1, 2), np.nan))


def test_a_flight_of_the_study(study, curves):
    """The draw after the last: not among those it is compared with."""
    answer = dj.compare_log(study, logged(*curves[60])).summary()
    assert answer["p_value"] > 0.05
    command = answer["signals"]["u_total"]
    assert command["samples"] == study.loop.steps
    assert command["largest_difference"] < 1e-12
    assert command["rms_difference"] <= command["largest_difference"] < command["rms_logged"]
    assert answer["signals"]["y"]["largest_departure"] <= answer["statistic"]


def test_another_plant_is_found(study):
    weak = study.override({"plant.k_p": 0.3, "disturbance.value": 0.9})
    comparison = dj.compare_log(study, flown(weak))
    answer = comparison.summary()
    assert answer["p_value"] == answer["least_p_value"] == 1 / 60
    assert answer["signals"]["y"]["first_outside"] < 3.0
    assert answer["signals"]["u_total"]["outside_to_the_end_since"] is not None
    assert answer["signals"]["u_total"]["largest_difference"] < 1e-12  # the controller is the same


def test_a_log_with_gaps_is_compared_where_it_has_values(study, curves):
    log = logged(*curves[61])
    thin = log._replace(columns={name: Column(c.time[::5], c.value[::5]) for name, c in log.columns.items()})
    answer = dj.compare_log(study.override({"draws": 9}), thin).summary()
    assert answer["signals"]["y"]["samples"] == study.loop.steps / 5
    assert "of the controller's samples; a replay needs 95 %" in answer["not_replayed"][""]


def test_a_reference_logged_more_rarely_is_held_and_told(study, curves, capsys):
    """Of five references one is logged: the replay is that of the held staircase, and tells how many are the log's."""
    y, u, y_dot = curves[61]
    sine = 0.3 * np.sin(0.02 * np.arange(study.loop.steps))
    log = logged(y, u, y_dot)
    time = log.columns["y"].time
    rare = {"y_ref": Column(time[::5], sine[::5]), "y_ref_dot": Column(time, np.zeros(len(time)))}
    log = log._replace(columns=log.columns | rare)
    answer = dj.compare_log(study.override({"draws": 9}), log)
    held = 4 * study.loop.steps // 5
    assert answer.summary()["held_samples"] == {"y_ref": held}
    assert answer.summary()["replayed_samples"] == study.loop.steps
    staircase = np.array([np.repeat(sine[::5], 5), np.zeros(len(y)), np.zeros(len(y))])
    expected = analysed_command(study, 0, np.array([y, y_dot]), staircase)
    np.testing.assert_allclose(answer.dataset["commanded"].sel(signal="u_total"), expected, rtol=0, atol=1e-12)
    show_log_comparison(answer, [])
    said = (
        f"replay: of {study.loop.steps} samples, the log has y_ref at {held // 4}; between them its last value is held"
    )
    assert said in " ".join(capsys.readouterr().out.split())


def test_another_controller_is_found_by_the_replay(study, curves):
    y, u, y_dot = curves[0]
    faster, reference = study.override({"controller.k_i": 0.6}), study_references(study, len(y))[0]
    difference = analysed_command(faster, 0, np.array([y, y_dot]), reference) - u
    assert 0.01 < np.abs(difference).max() < 1.0
    signals = {"y": y, "u_total": u}
    assert "needs y_dot" in replayed_channel(study, 0, signals, reference)
    assert "needs y_dot or y_ref_dot" in replayed_channel(study, 0, signals | {"y_ref": y}, reference)
    assert "no measured output" in replayed_channel(study, 0, {"u_total": u}, reference)
    np.testing.assert_allclose(replayed_channel(study, 0, signals | {"y_dot": y_dot}, reference), u, rtol=0, atol=1e-12)


def test_command_with_a_table_of_columns(study, curves, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "flown.toml").write_text(tomli_w.dumps(study.table))
    lines = ["seconds,millimetres,rate,volts"]
    lines += [
        f"{7.0 + DT * k:.4f},{1000 * y!r},{y_dot!r},{u!r}" for k, (y, u, y_dot) in enumerate(curves[62].T.tolist())
    ]
    (tmp_path / "log.csv").write_text("\n".join(lines))
    columns = 'time = "seconds"\n[signals]\ny = { column = "millimetres", scale = 0.001 }\nu_total = "volts"\n'
    (tmp_path / "columns.toml").write_text(columns)
    command = ["compare-log", "flown.toml", "log.csv", "--columns", "columns.toml", "--column", "y_dot=rate"]
    assert guarded([*command, "--out", "out", "--json"]) == 0
    answer = last_json(capsys)
    assert answer["start"] == 7.0
    assert answer["signals"]["u_total"]["largest_difference"] < 1e-12
    assert (tmp_path / "out" / "figures" / "compare-log.png").exists()
    assert guarded([*command[:3], "--column", "y=rates", "--json"]) == 2
    assert "has no column" in capsys.readouterr().err


def ulog(path, time, values, begin=0.0):
    """A ULog with one topic of two fields, as PX4 writes it: stamps, and the log's beginning, in microseconds."""

    def message(kind, body):
        return struct.pack("<Hc", len(body), kind) + body

    form = b"rate:uint64_t timestamp;float[2] xyz;"
    parts = [
        b"ULog\x01\x12\x35\x01" + struct.pack("<Q", round(1e6 * begin)),
        message(b"B", bytes(40)),
        message(b"F", form),
    ]
    parts.append(message(b"A", struct.pack("<BH", 0, 3) + b"rate"))
    for t, value in zip(time, values, strict=True):
        parts.append(message(b"D", struct.pack("<HQff", 3, round(1e6 * t), 0.0, value)))
    path.write_bytes(b"".join(parts))


def test_a_log_of_px4(tmp_path):
    pytest.importorskip("pyulog")
    time, values = 3.0 + DT * np.arange(50), np.linspace(0.0, 1.0, 50)
    ulog(tmp_path / "a.ulg", time, values)
    log = read_log(tmp_path / "a.ulg", table={"signals": {"y": {"column": "rate.xyz[1]", "scale": 2.0}}})
    assert log.start == pytest.approx(3.0)
    np.testing.assert_allclose(log.columns["y"].time, time)
    np.testing.assert_allclose(log.columns["y"].value, 2.0 * values.astype(np.float32))
    for source, message in (
        ("rates.xyz[1]", "no topic 'rates'"),
        ("rate.xyz[2]", "no field"),
        ("rate:1.a", "no topic"),
    ):
        with pytest.raises(dj.ConfigError, match=message):
            read_log(tmp_path / "a.ulg", table={"signals": {"y": source}})


def test_start_counts_from_the_beginning_of_a_log_of_px4(tmp_path):
    """The vehicle had run for an hour when the log began: `start` is a time of the log, as with CSV."""
    pytest.importorskip("pyulog")
    time, values = DT * np.arange(50), np.linspace(0.0, 1.0, 50)
    ulog(tmp_path / "a.ulg", 3600.0 + time, values, begin=3600.0)
    table = {"signals": {"y": "rate.xyz[1]"}, "start": 0.2}
    log = read_log(tmp_path / "a.ulg", table=table)
    rows = "\n".join(f"{t},{y}" for t, y in zip(time, values.astype(np.float32), strict=True))
    (tmp_path / "a.csv").write_text(f"t,y\n{rows}\n")
    csv = read_log(tmp_path / "a.csv", table={"start": 0.2})
    assert log.start == csv.start == 0.2
    np.testing.assert_allclose(log.columns["y"].time, csv.columns["y"].time, atol=1e-6)
    sampled = (nearest_values(flight.columns["y"], flight.start, DT, 30) for flight in (log, csv))
    np.testing.assert_allclose(*sampled, rtol=1e-6)
    assert read_log(tmp_path / "a.ulg", table={"signals": {"y": "rate.xyz[1]"}}).start == pytest.approx(0.0)


def unspread():
    """A study without laws and without sensors: every draw is the same."""
    spread = table({"kind": "pi", "k_p": 1.0, "k_i": 0.5})
    plain = {"kind": "normal_form", "k_p": 1.0, "a_p": 1.0, "initial": [0.5, 0.0]}
    quiet = {"sensor": {"kind": "ideal"}, "unmodelled": {"kind": "none"}}
    return dj.Study.from_table({**spread, **quiet, "plant": plain, "draws": 19})


@pytest.mark.parametrize("deviation", [4e-7, 1e-3, 1e300])
def test_without_spread_there_is_no_rank(deviation, capsys):
    """Rounding alone would decide the rank among equal draws; a deviation is told in the signal's unit."""
    study = unspread()
    ((found,),) = curves_of_draws(study.override({"draws": 1}), study.loop.steps)
    y = np.asarray(found.y) + deviation * np.linspace(0.0, 1.0, study.loop.steps)
    answer = dj.compare_log(study, logged(y, found.u_total, found.y_dot))
    assert answer.p_value is None
    assert answer.decisive() is None
    summary = answer.summary()
    assert summary["p_value"] is None
    assert set(summary["without_spread"]) == {"y", "u_total", "y_dot"}
    assert summary["without_spread"]["y"] == pytest.approx(deviation, rel=1e-3)
    assert summary["draws_at_least_as_extreme"] is None
    assert all(signal["outside_share"] is None for signal in summary["signals"].values())
    assert answer.headline.startswith("no law of the study spreads what is compared, so every draw is the same")
    assert answer.figure() is not None
    show_log_comparison(answer, [])
    printed = capsys.readouterr().out
    assert printed.splitlines()[1] == answer.headline
    assert [line.split()[0] for line in printed.splitlines()[3:6]] == ["y", "y_dot", "u_total"]
    for rank in ("p = ", "%", "outside", "departure"):
        assert rank not in printed


def test_signals_without_spread_are_left_out_of_the_rank():
    """Two draws differ in the second signal only: the first one has no part in the statistic."""
    curves = np.zeros((9, 2, 4))
    curves[:, 1] = np.arange(9)[:, None]
    tested = np.array([np.full(4, 1e-9), np.full(4, 4.0)])
    largest, departure = largest_departures(curves, tested)
    assert np.isnan(departure[0]).all()
    assert rank_p_value(extremeness(largest)) > 0.5
    alone, _ = largest_departures(curves[:, :1], tested[:1])
    assert np.isnan(extremeness(alone)).all()


def test_a_signal_of_rounding_is_left_out_of_the_rank():
    """All draws stand still in one signal up to rounding: the log's motion there has no rank, that in the other has."""
    rng = np.random.default_rng(0)
    still = 1e-15 * rng.standard_normal((40, 1, 30))
    moving = rng.standard_normal((40, 1, 30))
    tested = np.stack([np.full(30, 0.3), rng.standard_normal(30)])
    largest, departures = largest_departures(np.concatenate([still, moving], axis=1), tested)
    assert np.isnan(departures[0]).all()
    assert np.isfinite(departures[1]).all()
    alone, _ = largest_departures(moving, tested[1:])
    np.testing.assert_array_equal(extremeness(largest), extremeness(alone))


def test_few_draws_differ_from_a_median_of_zero():
    """The median absolute deviation is 0 where most draws are 0; departures stay finite."""
    curves = np.zeros((19, 1, 3))
    curves[:3] = 1.0
    largest, _ = largest_departures(curves, np.full((1, 3), 5.0))
    assert np.isfinite(largest).all()
    assert rank_p_value(extremeness(largest)) == 1 / 20


def test_a_signal_with_spikes_hides_no_other():
    """All curves have spikes of any height in the second signal; the first shows that the flight is none of them."""
    rng = np.random.default_rng(1)
    smooth = rng.standard_normal((99, 1, 1)) * np.ones(20)
    spikes = 0.01 * rng.standard_normal((99, 1, 20))
    spikes[np.arange(99), 0, rng.integers(0, 20, 99)] = np.exp(5.0 * rng.random(99))
    tested = np.array([np.full(20, 6.0), 1.1 * spikes[0, 0]])
    largest, _ = largest_departures(np.concatenate([smooth, spikes], axis=1), tested)
    assert largest[:-1].max() > largest[-1].max()
    assert rank_p_value(extremeness(largest)) <= 2 / 100


def test_a_stamp_beyond_all_numbers():
    log = FlightLog("far", {"y": Column(np.array([0.0, 1.0, 1e308]), np.zeros(3))}, 0.0)
    assert samples_within(log, 1e-3, 300) == 300
    assert samples_within(log._replace(start=1e9, columns={"y": Column(np.zeros(1), np.zeros(1))}), 1e-3, 300) == 0


def test_without_pyulog(tmp_path, monkeypatch):
    original = builtins.__import__

    def refusing(name, *arguments, **options):
        if name == "pyulog":
            raise ImportError(name)
        return original(name, *arguments, **options)

    monkeypatch.setattr(builtins, "__import__", refusing)
    with pytest.raises(dj.ConfigError, match=r"needs pyulog: pip install 'dssc_jax\[ulog\]'"):
        read_log(tmp_path / "a.ulg", table={"signals": {"y": "rate.xyz[1]"}})


@pytest.mark.parametrize(
    ("content", "columns", "message"),
    [
        ("t,a\n0,1\n", {}, "map a column to at least one of y, u_total"),
        ("t,y\n0,1\n", {"signals": {"z": "y"}}, "is no signal of the study"),
        ("t,y\n0,1\n", {"signal": {}}, "is no entry"),
        ("t,y\n0,1\n", {"signals": {"y": {"column": "y", "scale": 0}}}, "scale not 0"),
        ("t,y\n0,1\n", {"start": "now"}, "must be a finite number"),
        ("t,y\n1,1\n0,1\n", {}, "must not fall"),
        ("t,y\n0,nan\n", {}, "no finite value"),
        ("t,y\n0,x\n", {}, "must hold numbers"),
        ("s,y\n0,1\n", {}, "has no column 't'"),
        ("t,y\n0,1e308\n1,-1e308\n", {}, "y: its largest value in the log is 1e\\+308; at most 1e\\+100 is taken"),
        ("t,y\n0,1\n1e308,1\n", {}, "y: its largest time in the log is 1e\\+308"),
        ("t,y\n0,1e200\n", {"signals": {"y": {"column": "y", "scale": 1e200}}}, "its largest value in the log is inf"),
    ],
)
def test_bad_logs(tmp_path, content, columns, message):
    (tmp_path / "a.csv").write_text(content)
    with pytest.raises(dj.ConfigError, match=message):
        read_log(tmp_path / "a.csv", table=columns)


def test_a_log_outside_of_the_study(study):
    late = logged(*np.zeros((3, 3)))._replace(start=100.0)
    with pytest.raises(dj.ConfigError, match="no output and no command in the study's 3 s from 100 s on"):
        dj.compare_log(study, late)
