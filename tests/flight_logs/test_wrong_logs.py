"""Logs in another sign, unit, column or start, with times in milliseconds, or with hardly a sample: what is said."""

import re
from dataclasses import asdict

import numpy as np
import pytest
import tomli_w

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.least_squares import FitProblem, NormalEquations, Readings
from dssc_jax.flight_logs.fit.log_sampling import sampled_log
from dssc_jax.flight_logs.fit.minima import Minimum, MinimumSearch
from dssc_jax.flight_logs.fit.refusals import NotIdentifiable, Unexplained, require_unique_minimum
from dssc_jax.flight_logs.hints.conversions import (
    conversion_text,
    factor_text,
    followed_conversion,
    likeness_text,
    multiple_of,
    reference_conversion,
    reference_shift,
)
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.replay import replay_log
from dssc_jax.flight_logs.signal_warnings import Hint
from tests.cli.conftest import last_json
from tests.flight_logs.fit.test_fit import DT, linear, log_of, output

TIME = DT * np.arange(400)
SINE = 0.5 * np.sin(np.pi * TIME)  # the reference of the study


@pytest.fixture(scope="module")
def flight():
    """A command and a noisy output of known numbers."""
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    return u, output(1.1, 0.8, u) + 0.01 * random.normal(size=400)


def with_reference(log, reference):
    return log._replace(columns=log.columns | {"y_ref": Column(TIME[: len(reference)], reference)})


@pytest.mark.parametrize(
    ("factor", "unit", "words"),
    [
        (-1.0, "m", "with the opposite sign"),
        (100.0, "m/s", "times 100 (centimetres in place of metres)"),
        (100.0, "mol", "times 100"),
        (57.29577951, "rad", "times 57.3 (degrees in place of radians)"),
        (57.29577951, "m", ""),
        (1.0, "m", ""),
        (1.7, "m", ""),
    ],
)
def test_multiples_are_named(factor, unit, words):
    logged = factor * SINE
    logged[10:40] = np.nan
    assert conversion_text(logged, SINE, 0.01, unit) == words


@pytest.mark.parametrize(("factor", "told"), [(2.0, 2.0), (1.08, 1.08), (-0.5, -0.5), (1.01, 1.0), (1e200, 1e200)])
def test_a_multiple_of_the_replayed_command_is_told(factor, told):
    logged = factor * SINE
    logged[10:40] = np.nan
    assert multiple_of(logged, SINE) == pytest.approx(told, rel=1e-9)
    disturbed = logged + 0.1 * factor * np.cos(np.pi * TIME)
    assert multiple_of(disturbed, SINE) == multiple_of(0.0 * logged, SINE) == multiple_of(logged, 0.0 * SINE) == 1.0
    assert multiple_of(np.full(400, np.nan), SINE) == 1.0


def test_a_fit_of_doubled_commands_is_warned(flight):
    """The gain would be half: nothing but the analysed controller knows better."""
    log = with_reference(log_of(flight[1]), SINE)
    slopes = {"y_dot": np.gradient(flight[1], DT), "y_ref_dot": np.gradient(SINE, DT)}
    log = log._replace(columns=log.columns | {name: Column(TIME, values) for name, values in slopes.items()})
    study = linear()
    command = replay_log(study, log).commands["u_total"]
    for factor in (1.0, 2.0):
        doubled = log._replace(columns=log.columns | {"u_total": Column(TIME, factor * command)})
        told = [hint.text for hint in replay_log(study, doubled).hints.all().values()]
        assert any(text.startswith("is 2 times what the analysed controller gives") for text in told) == (factor == 2.0)


@pytest.mark.parametrize(
    ("factor", "words"),
    [
        (1.0, ""),
        (100.0, "follows its reference times 100 (centimetres in place of metres)"),
        (3.28084, "follows its reference times 3.281 (feet in place of metres)"),
        (-1.0, ""),
        (2.4, ""),  # a resonance
    ],
)
def test_an_output_in_another_unit_than_its_reference_is_told(factor, words):
    """A fit would call it a gain: it follows with a lag and an overshoot, in centimetres. A sign may be a lag."""
    lagging = factor * 0.6 * np.sin(np.pi * TIME - 0.5)
    assert followed_conversion(lagging, SINE, "m") == words


def test_an_output_in_degrees_that_follows_late_is_told():
    """A slow loop: a third of a period late, and a fifth too small; honest ones and noise are none of these."""
    slow = 0.8 * np.sin(np.pi * TIME - 2.0)
    told = "follows its reference times 57.3 (degrees in place of radians), with a lag"
    assert followed_conversion(np.degrees(slow), np.sin(np.pi * TIME), "rad") == told
    random = np.random.default_rng(0)
    for other in (slow, 2.9 * slow, 57.3 * random.normal(size=len(TIME)), 20.0 * slow, 0.0 * slow):
        assert followed_conversion(other, np.sin(np.pi * TIME), "rad") == ""


def test_the_opposite_sign_is_told_where_the_mean_has_it():
    """A step that a loop follows slowly; of a sine without a mean, a sign may be a lag."""
    step = (TIME > 1.0).astype(float)
    slow = step * (1.0 - np.exp(-5.0 * np.maximum(TIME - 1.0, 0.0)))
    assert followed_conversion(-slow, step, "m") == "follows its reference with the opposite sign"
    assert followed_conversion(slow, step, "m") == ""
    assert followed_conversion(-SINE, SINE, "m") == ""


def test_references_of_other_channels_and_times():
    cosine = np.cos(np.pi * TIME)
    references = np.array([SINE, cosine])
    assert reference_conversion(0, cosine, references, ("x", "y"), "m") == "is the study's of y"
    assert reference_conversion(0, SINE, references, ("x", "y"), "m") == ""
    step = (TIME > 3.0).astype(float)
    assert reference_shift((TIME > 4.0).astype(float), step) == 50
    assert reference_shift((TIME > 2.5).astype(float), step) == -25
    assert reference_shift(step, step) == reference_shift(SINE**3 + 1.0, step) == 0
    assert reference_shift(np.ones(400), np.zeros(400)) == 0
    pulses = (np.floor(0.5 * TIME) % 2).astype(float)
    edge = pulses.copy()
    edge[100] = 1.0 - edge[100]
    assert reference_shift(edge, pulses) == 0  # and not a period
    lost = np.concatenate([pulses[:150], pulses[155:], pulses[:5]])
    assert reference_shift(lost, pulses) == 0  # rows are lost, and the beginning agrees with one period later, too
    assert reference_shift((TIME > 2.0).astype(float), (TIME > 2.0 - 2.0 * DT).astype(float)) == 2  # of a single edge


def flying_references(x, y):
    """A vehicle whose x and y follow steps after 1 s and 3.5 s, and a log of references of x and y."""
    steps = {axis: {"kind": "step", "size": 1.0, "at": at} for axis, at in (("x", 1.0), ("y", 3.5))}
    study = dj.Study.load("studies/uav_robustness.toml").without_sweep()
    changes = {"loop.duration": 8.0, "loop.sample_time": DT, "requirement": [], "metrics": {"names": ["error_rms"]}}
    study = study.override({**changes, "reference": {"kind": "hover", **steps}})
    time = DT * np.arange(len(x))
    return study, FlightLog("flight", {"x_y_ref": Column(time, x), "y_y_ref": Column(time, y)}, 0.0)


def test_a_start_is_offered_only_if_all_references_agree():
    time = DT * np.arange(400)
    jumps = (time > 1.0 - 1e-9).astype(float), (time > 5.5 - 1e-9).astype(float)
    study, log = flying_references(*jumps)  # the clock jumps by 2 s between the steps
    assert replay_log(study, log, commands=False).hints.shifts == {}
    study, log = flying_references((time > 3.0 - 1e-9).astype(float), jumps[1])
    late = (
        "is the study's, 2 s later: if y and the command are as late, set start to 2 s; if not, only its topic is "
        "late, and a fit of logged commands does not use it"
    )
    assert replay_log(study, log, commands=False).hints.shifts == dict.fromkeys(
        ("x_y_ref", "y_y_ref"), Hint("shifted-reference", late)
    )


def test_the_slope_of_a_record_with_jittered_stamps_is_told():
    """Against the rate that the log has, which the record then takes."""
    random = np.random.default_rng(2)
    stamps = TIME + np.abs(random.normal(0.0, 1e-3, TIME.shape))
    speed = 0.5 * np.pi * np.cos(np.pi * TIME)
    record = {"kind": "record", "time": stamps.tolist(), "value": SINE.tolist()}
    columns = {"y_ref": Column(TIME, SINE), "y_ref_dot": Column(TIME, speed)}
    log = log_of(SINE)._replace(columns=columns)
    slope = np.interp(TIME, stamps, np.append(np.diff(SINE) / np.diff(stamps), 0.0))
    rough = replay_log(linear(reference=record), log, commands=False)
    assert rough.rates[""] > 0.5 * np.abs(slope - speed)[1:-1].max()
    assert "differs from the slope of the study's reference" in rough.hints.slopes["y_ref_dot"].text
    assert "by rate_column and rate_file" in rough.hints.slopes["y_ref_dot"].text
    rated = replay_log(linear(reference={**record, "rate": speed.tolist()}), log, commands=False)
    assert rated.rates[""] < 0.1 * rough.rates[""]
    assert rated.hints.all() == {}


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        (2.0 + SINE, -SINE, ("", "looks like the study's with the opposite sign")),
        (SINE, 2.0 + SINE, ("looks like the study's y_y", "looks like the study's x_y")),
        (200.0 + 100.0 * SINE, SINE, ("looks like the study's times 100 (centimetres in place of metres)", "")),
        (2.0 + 1.1 * SINE, 0.9 * SINE, ("", "")),
        (
            2.0 + SINE,
            -4.0 + 0.9 * SINE,
            ("", "lies -4 m from the study's from the start on: compare the study's initial state"),
        ),
    ],
)
def test_what_an_output_looks_like(x, y, words):
    expected = [2.0 + SINE, SINE]
    found = tuple(likeness_text(index, logged, expected, ("x_y", "y_y"), "m") for index, logged in enumerate((x, y)))
    assert found == words


def hover(height, seed):
    """An output that hovers, with a slow drift of 5 cm."""
    return height + np.cumsum(0.0025 * np.random.default_rng(seed).normal(size=400))


@pytest.mark.parametrize(
    ("logged", "expected"),
    [
        (SINE, [0.5 * np.sin(np.pi * (TIME + 0.3)), SINE]),  # 0.3 s late, and the other channel flies as much later
        (hover(5.3, 1), [hover(5.0, 2), hover(5.25, 3)]),  # beside its height, and near that of the other
        (1.2 * SINE + 0.2, [SINE, 1.1 * SINE + 0.2]),  # a gain and an offset explain more
        (SINE + 0.15 * np.cos(2.3 * np.pi * TIME), [0.0 * SINE, SINE]),  # 30 % of it is something else
        (np.sin(8.0 * TIME - 2.7), [np.sin(8.0 * TIME), 0.0 * SINE]),  # 0.34 s late, and no sign is wrong
    ],
)
def test_a_weak_likeness_is_not_told(logged, expected):
    """Each of these logs has another fault, and no column or sign is wrong."""
    noisy = logged + 0.01 * np.random.default_rng(0).normal(size=400)
    assert "looks like" not in likeness_text(0, noisy, expected, ("x_y", "y_y"), "m")


def test_a_clear_likeness_is_told_beside_noise():
    noise = 0.05 * np.random.default_rng(0).normal(size=400)
    assert likeness_text(0, SINE + noise, [0.0 * SINE, SINE], ("x_y", "y_y"), "m") == "looks like the study's y_y"


@pytest.mark.parametrize(
    ("ends", "value", "words"),
    [
        ((5.0, 9.0), 0.007, "times 1000"),
        ((5.0, 9.0), 2.0, "times 3.281"),
        ((5.0, 9.0), 20.0, ""),
        ((-9.0, 9.0), 90.0, ""),
        ((100.0, 120.0), 2.0, ""),  # 57.3, and nothing is an angle
    ],
)
def test_the_multiple_that_brings_an_estimate_into_its_law(ends, value, words):
    assert factor_text(np.array(ends) / value, ["m", "N"]) == words


def test_a_comparison_names_a_mirrored_output_and_an_early_end(tmp_path, capsys):
    study = linear(draws=19)
    run = dj.simulate(study, 3)
    rows = "\n".join(f"{t},{-y}" for t, y in zip(run["t"].values[:120], run["y"].values[:120], strict=True))
    (tmp_path / "log.csv").write_text(f"t,y\n{rows}\n")
    (tmp_path / "s.toml").write_text(tomli_w.dumps(study.table))
    assert (
        guarded(["compare-log", str(tmp_path / "s.toml"), str(tmp_path / "log.csv"), "--out", str(tmp_path / "o")]) == 0
    )
    printed = " ".join(capsys.readouterr().out.split())
    assert "warning: y looks like the study's with the opposite sign" in printed
    assert "log.csv over 19 draws, 120 of the study's 400 samples: the log ends before the study" in printed


def test_a_simulation_that_diverges_warns_of_nothing(flight):
    """Infinity times a weight of 0 between the samples is no number, and no warning."""
    readings = Readings.of(sampled_log(linear(), log_of(*flight[::-1])), 0, DT)
    assert np.isnan(readings.interpolate(np.full(400, np.inf))).any()


def test_a_fit_refuses_a_mirrored_reference_and_tells_a_late_start(flight):
    u, y = flight
    with pytest.raises(ConfigError, match=r"y_ref is the study's with the opposite sign\. Compare the log's columns"):
        fit_log(linear(), with_reference(log_of(-y, -u), -SINE))
    step = linear(reference={"kind": "step", "size": 1.0, "at": 2.0})
    late = replay_log(step, with_reference(log_of(y, u), (TIME >= 3.0 - 1e-9).astype(float)), commands=False)
    assert late.hints.shifts["y_ref"].text.startswith(
        "is the study's, 1 s later: if y and the command are as late, set start to"
    )
    assert late.references == {"": 1.0}


def test_a_replayed_command_in_another_unit_is_refused():
    """The command of the study's PI controller for the logged output, times 100."""
    study = linear(draws=1)
    run = dj.simulate(study, 0)
    columns = {name: Column(run["t"].values, run[name].values) for name in ("y", "y_dot", "y_ref", "u_total")}
    log = FlightLog("flight", columns, 0.0)
    assert not replay_log(study, log).hints.all()
    columns["u_total"] = columns["u_total"]._replace(value=100.0 * columns["u_total"].value)
    log = FlightLog("flight", columns, 0.0)
    with pytest.raises(ConfigError, match="u_total is the analysed controller's times 100"):
        fit_log(study, log, replay=replay_log(study, log))


def test_a_residual_of_many_times_the_noise_is_doubted(flight):
    """A slow wave of 3 cm, 0.5 % of the output's variance, beside 1 cm of noise."""
    u, y = flight
    wave = 0.045 * np.sin(2.0 * np.pi * TIME / 3.0)
    fitted = fit_log(linear(), log_of(y + wave, u))
    (doubt,) = fitted.doubts
    assert doubt.signal == "y"
    assert "times the 0.01" in doubt.text
    (time,) = re.findall(r"largest at (\d\.?\d*) s of the study", doubt.text)
    assert abs(np.sin(2.0 * np.pi * float(time) / 3.0)) > 0.5  # near a crest
    assert "Compare the log's columns, units, signs and start" in doubt.text
    summary = fitted.summary()
    assert summary["warned"]
    assert summary["warnings"] == [asdict(doubt)]
    sound = fit_log(linear(), log_of(y, u))
    assert sound.doubts == sound.warnings == ()
    assert not sound.summary()["warned"]
    noise = {"kind": "noisy", "position_std": 0.04, "velocity_std": 0.0}
    (doubt,) = fit_log(linear(sensor=noise), log_of(y + wave, u)).doubts
    assert doubt.code == "correlated-residual"  # the study's sensor explains its size alone


@pytest.mark.parametrize(("factor", "words"), [(-1.0, "with the opposite sign"), (100.0, "times 100")])
def test_what_identifies_nothing_because_it_is_wrong_is_not_described(flight, factor, words):
    """Laws so narrow that no number is identified: the residual is refused before."""
    u, y = flight
    plant = {"k_p": {"uniform": [1.0999, 1.1001]}, "a_p": {"uniform": [0.7999, 0.8001]}}
    study = linear(plant={**linear().table["plant"], **plant})
    with pytest.raises(Unexplained, match=rf"is accepted. y looks like the study's {words}.*Compare the log's columns"):
        fit_log(study, log_of(factor * y, u))


def test_a_command_that_is_missing_at_its_step_is_told(flight):
    """The duplicate of a time stamp takes one command of 400, at a change of 3.4 or within a hold of ten samples.

    At the change the residual grows, and the fit estimates that command.
    """
    u, y = flight
    log = log_of(y, u)
    place = 10 * int(np.argmax(np.abs(np.diff(u[::10])))) + 10
    for index, told in ((place, [("u_total", "command-dropouts")]), (place + 5, [])):
        time = TIME.copy()
        time[index] = time[index - 1]
        doubled = log._replace(columns=log.columns | {"u_total": Column(time, u)})
        fitted = fit_log(linear(), doubled)
        assert fitted.held_samples == {"u_total": 1}
        assert [(doubt.signal, doubt.code) for doubt in fitted.doubts] == told


def test_a_rival_within_the_confidence_region_is_no_other_minimum(flight):
    """With an information of 100 the region of one number has a radius of 0.196."""
    study = linear()
    names = ["plant.k_p"]
    problem = FitProblem(
        study, names, lambda values, commands, forces=None: (values, values), sampled_log(study, log_of(*flight[::-1]))
    )
    information = np.array([[100.0]])
    best = Minimum(np.zeros(1), NormalEquations(10.0, np.zeros(1), information), 4)
    near, far = (Minimum(np.array([x]), best.equations._replace(cost=11.0), 4) for x in (0.19, 0.21))
    require_unique_minimum(problem, MinimumSearch(best, [near], 8), information)
    with pytest.raises(NotIdentifiable, match="two minima describe it equally well"):
        require_unique_minimum(problem, MinimumSearch(best, [far], 8), information)
    require_unique_minimum(problem, MinimumSearch(best, [far], 8), information / 2.0)  # of a wider region


def test_a_log_in_milliseconds_is_no_comparison(flight):
    u, y = flight
    log = FlightLog("flight", {"y": Column(1000.0 * TIME, y), "u_total": Column(1000.0 * TIME, u)}, 0.0)
    study = linear(draws=19, plant=linear().table["plant"])
    text = r"has values at 1 of the study's 400 samples.*needs 5; its values are 20 s apart.*times in milliseconds\?"
    with pytest.raises(ConfigError, match=text):
        dj.compare_log(study, log)
    with pytest.raises(ConfigError, match=r"fewer than 20 values .* times in milliseconds"):
        fit_log(study, log)
    with pytest.raises(ConfigError, match=text):
        dj.next_flight(study.override({"draws": 200}), [log])


def test_a_rare_log_is_compared_and_the_samples_are_told(tmp_path, capsys):
    """One value a second of a study at 50 Hz: eight samples, in the headline and the verdict."""
    study = linear(draws=39)
    run = dj.simulate(study.override({"draws": 60}), 50)
    rows = [f"{t},{y},{u}" for t, y, u in zip(*(run[name].values[::50] for name in ("t", "y", "u_total")), strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["t,y,u_total", *rows]))
    (tmp_path / "s.toml").write_text(tomli_w.dumps(study.table))
    arguments = ["compare-log", str(tmp_path / "s.toml"), str(tmp_path / "log.csv"), "--out", str(tmp_path / "out")]
    assert guarded(arguments) == 0
    printed = capsys.readouterr().out
    assert "which has a value at 8 of " in printed
    assert "by the 8 samples that it has" in printed


def test_the_command_tells_of_replay_and_reference(tmp_path, capsys, flight):
    u, y = flight
    lines = [f"{t},{a},{b},{r}" for t, a, b, r in zip(TIME, y, u, SINE + 0.1, strict=True)]
    (tmp_path / "log.csv").write_text("\n".join(["t,y,u_total,y_ref", *lines]))
    (tmp_path / "s.toml").write_text(tomli_w.dumps(linear().table))
    arguments = ["compare-log", str(tmp_path / "s.toml"), str(tmp_path / "log.csv"), "--fit"]
    assert guarded([*arguments, "--json"]) == 0
    found = last_json(capsys)
    assert found["reference_differences"][""] == pytest.approx(0.1)
    assert found["not_replayed"] == {"": "the controller needs y_dot or y_ref_dot or y_ref_ddot, which the log lacks"}
    assert guarded(arguments) == 0
    assert "the logged reference differs from the study's by at most 0.1" in capsys.readouterr().out
