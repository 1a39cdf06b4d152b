"""Wrong columns and scales of y, as the analysed controller tells them; other faults and gains are none of these."""

from itertools import combinations

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.hints.references import study_references
from dssc_jax.flight_logs.hints.replayed_columns import column_hints
from dssc_jax.flight_logs.reading.reader import Column, FlightLog
from dssc_jax.flight_logs.replay import replay_log

DT = 0.02
SAMPLES = 300
TIME = DT * np.arange(SAMPLES)
PULSES = (np.mod(TIME - 0.5 + 1e-9, 3.0) < 1.5).astype(float) * (TIME >= 0.5 - 1e-9)
GAINS = (6.0, 5.0, 2.0)


@pytest.fixture(scope="module")
def study():
    """A study of x'' = -a_p x' + k_p u with state feedback and an integral."""
    k_1, k_2, k_i = GAINS
    return dj.Study.from_table(
        {
            "name": "columns",
            "seed": 1,
            "loop": {"duration": SAMPLES * DT, "sample_time": DT},
            "plant": {"kind": "normal_form", "k_p": {"uniform": [0.4, 0.6]}, "a_p": 0.3, "initial": [0.0, 0.0]},
            "reference": {"kind": "pulses", "size": 1.0, "period": 3.0, "width": 1.5, "at": 0.5},
            "controller": {"kind": "state_feedback", "k_1": k_1, "k_2": k_2, "k_i": k_i},
        }
    )


def flown(seed=0, noise=0.002, gains=GAINS, force=0.0, step=0.0, reference=PULSES):
    """The columns of a flight, by a simulation of its own.

    Args:
        seed: Seed of the sensor's noise.
        noise: Its standard deviation.
        gains: Gains of the flight's controller.
        force: A constant force on the vehicle, as command.
        step: The step to which the controller rounds its command; 0: it does not.
        reference: What the controller gets; the log has the pulses.
    """
    random = np.random.default_rng(seed)
    k_1, k_2, k_i = gains
    place, speed, integral = 0.0, 0.0, 0.0
    columns = {name: np.zeros(SAMPLES) for name in ("y", "y_dot", "u_total")}
    for sample in range(SAMPLES):
        y = place + noise * random.normal()
        y_dot = speed + 2.0 * noise * random.normal()
        u = integral - k_1 * (y - reference[sample]) - k_2 * y_dot
        if step > 0.0:
            u = step * np.round(u / step)
        integral -= DT * k_i * (y - reference[sample])
        for name, value in (("y", y), ("y_dot", y_dot), ("u_total", u)):
            columns[name][sample] = value
        for _ in range(10):
            speed += 0.1 * DT * (-0.33 * speed + 0.53 * (u + force))
            place += 0.1 * DT * speed
    return {**columns, "y_ref": PULSES}


def log_of(columns):
    """A log of columns by signal, with four decimals."""
    return FlightLog("flight", {name: Column(TIME, np.round(values, 4)) for name, values in columns.items()}, 0.0)


def told(study, columns):
    """The codes of the warnings of a replay, by signal, and their texts in one."""
    warnings = replay_log(study, log_of(columns)).warnings
    return {warning.signal: warning.code for warning in warnings}, " ".join(warning.text for warning in warnings)


@pytest.mark.parametrize(("first", "second"), list(combinations(("y", "y_dot", "y_ref", "u_total"), 2)))
def test_every_two_exchanged_columns_are_named(study, first, second):
    columns = flown()
    codes, text = told(study, {**columns, first: columns[second], second: columns[first]})
    assert list(codes.values()) == ["exchanged-columns"]
    assert text.startswith((f"{first} looks exchanged with {second}", f"{second} looks exchanged with {first}"))


def flown_with_rates(study):
    """The columns of a draw along a reference that moves, with a controller that follows its rate."""
    waves = {"kind": "multisine", "amplitudes": [1.0, 0.4], "frequencies": [0.3, 0.8], "phases": [0.0, 0.0]}
    sta = {"kind": "sta", "l0": 1.5, "kappa1": 2.5, "kappa2": 2.0, "discretisation": "explicit"}
    smooth = study.override({"reference": waves, "controller": sta})
    draw = dj.simulate(smooth, 0)
    columns = {name: np.asarray(draw[name].values) for name in ("y", "y_dot", "y_ref", "u_total")}
    return smooth, columns | {"y_ref_dot": study_references(smooth, SAMPLES)[0, 1]}


def test_exchanged_rates_are_named(study):
    smooth, columns = flown_with_rates(study)
    codes, text = told(smooth, {**columns, "y_dot": columns["y_ref_dot"], "y_ref_dot": columns["y_dot"]})
    assert codes == {"y_dot": "exchanged-columns"}
    assert text.startswith("y_dot looks exchanged with y_ref_dot: with that, the analysed controller gives")


def test_a_multiple_of_the_reference_rate_is_told_with_its_scale(study):
    smooth, columns = flown_with_rates(study)
    codes, text = told(smooth, {**columns, "y_ref_dot": 100.0 * columns["y_ref_dot"]})
    assert codes == {"y_ref_dot": "wrong-scale"}
    assert text == "y_ref_dot is 100 times the study's: a scale of 0.01 for its column mends it, as y_ref is the same"
    assert told(smooth, columns) == ({}, "")


def test_a_fit_refuses_exchanged_columns(study):
    columns = flown()
    log = log_of({**columns, "y": columns["u_total"], "u_total": columns["y"]})
    with pytest.raises(ConfigError, match="looks exchanged with u_total: with that, the analysed controller"):
        fit_log(study, log, replay=replay_log(study, log))


@pytest.mark.parametrize(("sign", "words"), [(1.0, "the error y_ref - y:"), (-1.0, "the error y - y_ref:")])
def test_an_error_in_place_of_the_output_is_named(study, sign, words):
    columns = flown()
    codes, text = told(study, {**columns, "y": sign * (PULSES - columns["y"])})
    assert codes == {"y": "exchanged-columns"}
    assert words in text


def test_an_output_and_its_rate_with_the_opposite_sign_are_named_together(study):
    columns = flown()
    codes, text = told(study, {**columns, "y": -columns["y"], "y_dot": -columns["y_dot"]})
    assert codes == {"y": "another-unit"}
    assert text.startswith("y has the opposite sign, as has y_dot: with that, the analysed controller gives")


@pytest.mark.parametrize("name", ["y", "u_total"])
def test_an_opposite_sign_is_named_without_a_rate(study, name):
    """A controller of the error alone gives the opposite command, too, where y and y_ref are exchanged."""
    by_error = study.override({"controller": {"kind": "pid", "k_p": 0.3, "k_i": 0.02}})
    draw = dj.simulate(by_error, 0)
    columns = {signal: draw[signal].values for signal in ("y", "y_ref", "u_total")}
    columns[name] = -columns[name]
    log = FlightLog("flight", {signal: Column(TIME, values) for signal, values in columns.items()}, 0.0)
    hints = replay_log(by_error, log).hints.all()
    assert list(hints) == [name]
    assert "opposite sign" in hints[name].text


def test_an_origin_elsewhere_is_no_other_unit(study):
    columns = flown()
    columns = {**columns, "y": columns["y"] + 3.0, "y_ref": columns["y_ref"] + 3.0}
    codes, text = told(study, columns)
    assert codes["y_ref"] == "another-reference"
    assert "y_ref is the study's plus 3" in text
    assert "feet" not in text


def flown_by_error(study):
    """A study in which u = y_ref - y along a sine, and columns in which y lags behind the reference."""
    by_error = study.override(
        {
            "reference": {"kind": "sine", "amplitude": 10.0, "period": 20.0},
            "controller": {"kind": "pid", "k_p": 1.0},
        }
    )
    y_ref = study_references(by_error, SAMPLES)[0, 0]
    error = 0.5 * np.sin(2.0 * TIME)
    return by_error, {"y": y_ref - error, "y_ref": y_ref, "u_total": error}


def test_an_output_at_fewer_samples_is_not_exchanged(study):
    """With u = y_ref - y the log with exchanged columns, in which y has no gaps, describes the flight as well."""
    by_error, columns = flown_by_error(study)
    rare = slice(0, None, 5)
    log = FlightLog("flight", {name: Column(TIME, values) for name, values in columns.items()}, 0.0)
    log.columns["y"] = Column(TIME[rare], columns["y"][rare])
    replay = replay_log(by_error, log)
    assert "a replay needs 95 %" in "".join(replay.not_replayed.values())
    assert replay.warnings == ()


def test_a_difference_that_stays_is_no_exchange(study):
    """Exchanged, the commands differ as much as before, which is less of what the output varies."""
    by_error, columns = flown_by_error(study)
    codes, _ = told(by_error, {**columns, "y": columns["y"] + 0.3 * np.sin(5.0 * TIME)})
    assert codes == {"u_total": "another-command"}


class FeedforwardReplay:
    """A replay of the controller u = y_ref' + 2 (y_ref - y), as that of a position by commands of a velocity."""

    index = 0

    def __init__(self, study):
        self.study = study
        self.reference = np.array([0.5 * np.sin(TIME), 0.5 * np.cos(TIME), -0.5 * np.sin(TIME)])

    def command(self, signals):
        return self.reference[1] + 2.0 * (signals["y_ref"] - signals["y"])


@pytest.mark.parametrize("has_rate", [False, True])
def test_an_output_of_another_channel_is_not_said_to_be_the_error(study, has_rate):
    """A small drift hardly matters as the error of a loop with feedforward; a measured error gives the command."""
    replay = FeedforwardReplay(study)
    y = replay.reference[0] - 0.02 * np.sin(5.0 * TIME)
    rates = {"y_dot": replay.reference[1] - 0.1 * np.cos(5.0 * TIME)} if has_rate else {}
    logged = {"y": y, "y_ref": replay.reference[0], **rates}
    logged["u_total"] = replay.command(logged)
    drifting = {**logged, "y": 0.003 * TIME}
    hint = column_hints(replay, drifting, replay.command(drifting))["y"]
    assert hint.code == "exchanged-columns"
    assert hint.text.startswith("does not change as y_dot tells: " if has_rate else "is not what the controller")
    assert "it is another channel's, or holds the error y" in hint.text
    error_logged = {**logged, "y": replay.reference[0] - y}
    error = column_hints(replay, error_logged, replay.command(error_logged))["y"]
    assert error.text.startswith("seems to hold the error y_ref - y: with that")


@pytest.mark.parametrize("factor", [0.25, 0.97, 1.03, 1.08, 2.0, 57.3])
@pytest.mark.parametrize("flight", [{}, {"noise": 0.01}, {"force": 0.5}, {"step": 0.2}])
def test_a_scale_of_the_output_is_told_with_the_factor(study, factor, flight):
    columns = flown(**flight)
    codes, text = told(study, {**columns, "y": factor * columns["y"]})
    assert codes["y"] == "wrong-scale"
    assert float(text.split()[2]) == pytest.approx(factor, rel=0.004)
    assert f"a scale of {1.0 / float(text.split()[2]):.3g}"[:14] in text


@pytest.mark.parametrize(
    "columns",
    [
        flown(),
        flown(seed=1, noise=0.02),
        flown(seed=2, force=0.8),
        flown(seed=3, step=0.2),
        flown(seed=4, gains=(6.2, 5.0, 2.0)),
        flown(seed=5, gains=(6.0, 5.5, 2.0)),
        flown(seed=6, gains=(6.0, 5.0, 2.1)),
        flown() | {"y": flown()["y"] + 0.03},
        flown() | {"u_total": flown()["u_total"] + 0.3},
        flown() | {"u_total": 1.03 * flown()["u_total"]},
        flown() | {"y": flown()["y"] + 0.01 * np.random.default_rng(7).normal(size=SAMPLES)},
    ],
)
def test_noise_forces_gains_and_offsets_are_no_wrong_columns(study, columns):
    """As are a command to 0.2 N, a command times 1.03, and noise that only the log has."""
    codes, _ = told(study, columns)
    assert not {"wrong-scale", "exchanged-columns"} & set(codes.values())


def test_an_offset_of_the_command_is_told_beside_a_scale(study):
    """By the command that the controller gives for the right scale."""
    columns = flown()
    codes, text = told(study, {**columns, "y": 1.03 * columns["y"], "u_total": columns["u_total"] + 0.4})
    assert codes == {"y": "wrong-scale", "u_total": "command-offset"}
    assert "u_total lies 0.4 m/s beside" in text


def test_an_output_in_another_unit_says_nothing_of_the_command(study):
    codes, _ = told(study, {**flown(), "y": 100.0 * flown()["y"]})
    assert codes == {"y": "another-unit"}


def test_a_reference_that_is_a_multiple_has_its_factor(study):
    codes, text = told(study, {**flown(), "y_ref": 1.03 * PULSES})
    assert codes == {"y_ref": "wrong-scale"}
    assert "y_ref is 1.03 times the study's: a scale of 0.9709" in text
