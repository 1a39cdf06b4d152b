"""What a fit or a comparison says of a study that begins in the air, and of a log that begins tilted."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.fit.refusals import Unexplained
from dssc_jax.flight_logs.fit.start_doubts import wind_doubts
from dssc_jax.flight_logs.hints.attitudes import attitude_hints
from dssc_jax.flight_logs.hints.starts import begins_in_air, fixed_integrals, start_remedy
from dssc_jax.flight_logs.reading.reader import Column, FlightLog, read_log
from tests.flight_logs.fit.test_fit import linear, log_of, output

WIND = [{"kind": "constant", "x": 3.0, "y": 0.0, "z": 0.0}]
RISING = {"velocity_integral": [0.0, 0.0, 1.5]}
UNCERTAIN = {"velocity_integral": [0.0, 0.0, {"normal": [0.0, 1.0]}]}


def study(inner_loop, wind, **plant):
    """An X500 on PX4's cascade."""
    return dj.Study.from_table(
        {
            "name": "start",
            "draws": 4,
            "loop": {"duration": 1.0, "sample_time": 0.02, "substeps": 16},
            "controller": {"kind": "pid", "k_p": 1.0},
            "plant": {"kind": "uav", "inner_loop": {"kind": "px4", **inner_loop}, "vehicle": {"kind": "x500"}, **plant},
            **({"wind": wind} if wind else {}),
        }
    )


@pytest.mark.parametrize(
    ("inner_loop", "in_air", "level"),
    [
        ({}, False, True),
        ({"start": "settled"}, True, False),
        (RISING, True, True),
        (UNCERTAIN, True, True),
    ],
)
@pytest.mark.parametrize("wind", [[], WIND])
def test_a_level_start_in_the_air_in_wind_is_doubted(inner_loop, in_air, level, wind):
    """A settled start is the equilibrium in the wind: it is not doubted."""
    chosen = study(inner_loop, wind)
    assert begins_in_air(chosen) == in_air
    told = "".join(doubt.text for doubt in wind_doubts(chosen))
    assert ("a vehicle in wind is tilted" in told) == (in_air and level and bool(wind))


def test_a_settled_start_is_not_advised_again():
    for inner_loop, words in (({}, "set plant.inner_loop.start = 'settled'"), ({"start": "settled"}, "begin the log")):
        flying = study(inner_loop, [])
        remedy = start_remedy(flying, list(fixed_integrals(flying))[-1])
        assert words in remedy
        assert "velocity_integral = [0.0, 0.0, { normal = [0.0, 1.0] }] in [plant.inner_loop]" in remedy
        assert ("= 'settled'" in remedy) is (inner_loop == {})


@pytest.mark.parametrize("given", [{"roll": 0.1}, {"pitch": {"normal": [0.0, 0.1]}}])
def test_a_start_with_a_tilt_is_not_doubted(given):
    assert not wind_doubts(study(RISING, WIND, **given))


def flight(roll, pitch, rate, start=2.0):
    """A log with roll, pitch and body rate beside a position, which begins 2 s before the study."""
    time = np.arange(0.0, 4.0, 0.02)
    signals = {"x_y": 0.0 * time, "phi": roll + 0.5 * (time - start), "theta": pitch + 0.0 * time}
    signals |= {f"rate_{axis}": value + 0.0 * time for axis, value in zip("xyz", rate, strict=True)}
    return signals, time, start


def hints_of(chosen, signals, time, start):
    columns = {name: Column(time, values) for name, values in signals.items()}
    return attitude_hints(chosen, FlightLog("flight", columns, start))


def test_a_log_that_begins_tilted_and_turning_is_told():
    """The tilt is the angle of two rotations after each other: cos = cos(roll) cos(pitch)."""
    hints = hints_of(study({}, []), *flight(0.12, -0.05, (0.3, 0.0, -0.4)))
    tilt = np.degrees(np.arccos(np.cos(0.12) * np.cos(0.05)))
    assert f"with a tilt of 0 degrees, the log with one of {tilt:.3g}" in hints["plant.roll"].text
    assert "Set plant.roll = 0.12 and plant.pitch = -0.05" in hints["plant.roll"].text
    assert "the log begins with 0.5. Set plant.body_rate = [0.3, 0, -0.4]" in hints["plant.body_rate"].text


@pytest.mark.parametrize(
    ("inner_loop", "wind", "plant"),
    [
        ({}, [], {"roll": 0.12, "pitch": -0.05}),
        ({}, [], {"roll": {"normal": [0.0, 0.1]}}),
        ({"start": "settled"}, [{"kind": "constant", "x": {"normal": [0.0, 3.0]}, "y": 0.0, "z": 0.0}], {}),
    ],
)
def test_a_tilt_that_the_study_has_or_estimates_is_not_told(inner_loop, wind, plant):
    assert not hints_of(study(inner_loop, wind, **plant), *flight(0.12, -0.05, (0.0, 0.0, 0.0)))


def test_a_table_has_the_attitude_under_its_own_names(tmp_path):
    """Times in milliseconds, as the table of columns says."""
    signals, time, start = flight(0.12, -0.05, (0.0, 0.0, 0.0))
    rows = np.column_stack([1000.0 * time, *signals.values()])
    file = tmp_path / "flight.csv"
    np.savetxt(file, rows, delimiter=",", header=",".join(["ms", *signals]), comments="")
    table = {"time": {"column": "ms", "scale": 0.001}, "start": start, "signals": {"x_y": "x_y"}}
    chosen = study({}, [])
    hints = attitude_hints(chosen, read_log(file, chosen.loop.channels, table))
    assert "Set plant.roll = 0.12 and plant.pitch = -0.05" in hints["plant.roll"].text


def test_a_log_without_an_attitude_says_nothing():
    signals, time, start = flight(0.12, -0.05, (0.3, 0.0, -0.4))
    assert not hints_of(study({}, []), {"x_y": signals["x_y"]}, time, start)


@pytest.mark.parametrize("beside", [0.0, 0.3, -0.3])
def test_an_output_that_begins_beside_the_study_is_told(beside):
    """The command excites the plant enough that the residual is a small share of the output."""
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    y = output(1.1, 0.8, u, (0.5 + beside, 0.0)) + 0.01 * random.normal(size=400)
    try:
        texts = [doubt.text for doubt in fit_log(linear(), log_of(y, u)).doubts]
    except Unexplained as refusal:
        texts = str(refusal).split(". ")
    told = [text for text in texts if text.startswith("y begins at ")]
    if not beside:
        assert told == []
        return
    (text,) = told
    logged, initial = (float(text.split(" m, ")[i].split()[-1]) for i in range(2))
    assert logged == pytest.approx(0.5 + beside, abs=0.03)
    assert initial == pytest.approx(0.5, abs=0.03)
    table = linear().table["plant"] | {"initial": [{"normal": [0.5, 0.3]}, 0.0]}
    fitted = fit_log(linear(plant=table), log_of(y, u))
    assert not any("begins at" in doubt.text for doubt in fitted.doubts)
    assert dict(zip(fitted.names, fitted.estimates, strict=True))["plant.initial.0"] == pytest.approx(
        0.5 + beside, abs=0.02
    )
