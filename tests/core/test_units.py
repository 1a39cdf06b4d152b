"""Units of signals: the algebra, and what a plant's or a study's own units reach."""

import pytest

import dssc_jax as dj
from dssc_jax.console.kinds import registries, rows_of
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.units import ANGLE, POSITION, UNNAMED_UNITS, ChannelUnits, parse_unit
from dssc_jax.study.available_metrics import PACKAGE_METRICS

MOTOR = ChannelUnits("rad/s", "V", "shaft speed", "armature voltage")
PLANT = """
from typing import Annotated, NamedTuple
from dssc_jax.types import ChannelUnits, Measurement, Plant, Quantity

class Shaft(NamedTuple):
    gain: Annotated[float, Quantity("y/(s^2 u)", "gain", above=0.0)] = 50.0

class Spinning(NamedTuple):
    speed: float
    rate: float

def derivative(params, state, drive, t):
    return Spinning(state.rate, -10.0 * state.rate + params.gain * (drive.command + drive.disturbance))

def plant(**about):
    return Plant(
        Shaft,
        init=lambda params: Spinning(1.0, 0.0),
        derivative=derivative,
        measure=lambda params, state, drive: Measurement(state.speed, state.rate),
        input_gain=lambda params: params.gain,
        **about,
    )

NAMED = plant(units=(ChannelUnits("rad/s", "V", "shaft speed", "armature voltage"),))
UNNAMED_UNITS = plant()
"""
STUDY = {
    "name": "shaft",
    "draws": 4,
    "loop": {"duration": 1.0, "sample_time": 0.01},
    "plant": {"kind": "shaft_units:NAMED", "gain": {"uniform": [40.0, 60.0]}},
    "controller": {"kind": "pi", "l0": 5.0, "k_p": 0.5, "k_i": 0.1},
    "requirement": [{"metric": "error_max", "after": 0.9, "max": 0.5}],
    "metrics": {"names": ["error_rms", "command_energy", "itae"]},
}


@pytest.fixture
def shaft(tmp_path, monkeypatch):
    (tmp_path / "shaft_units.py").write_text(PLANT)
    monkeypatch.syspath_prepend(str(tmp_path))
    return dj.Study.from_table(STUDY)


@pytest.mark.parametrize(
    ("unit", "units", "expected"),
    [
        ("y", MOTOR, "rad/s"),
        ("y s^2", MOTOR, "rad s"),
        ("y/(s^2 u)", MOTOR, "rad/(s^3 V)"),
        ("y/(s^2 u)", POSITION, "1/s"),
        ("u^2 s", POSITION, "m^2/s"),
        ("u^2 s", ANGLE, "rad^2/s"),
        ("u s/y", POSITION, "1"),
        ("u (y/s)^(-1/2)", POSITION, "(m/s)^(1/2)"),
        ("u (y/s)^(-1/2)", ChannelUnits("rad", "V"), "V (rad/s)^(-1/2)"),
        ("y/(s^2 u) (y/s)^(-1/2)", POSITION, "(m/s)^(-1/2)/s"),
        ("s (y/s)^(-1/2)", POSITION, "s (m/s)^(-1/2)"),
        ("y, y/s", POSITION, "m, m/s"),
        ("y, y/s", ChannelUnits("N m", "A"), "N m, N m/s"),
        ("1/s^(m-i)", MOTOR, "1/s^(m-i)"),
        ("kg m^2", MOTOR, "kg m^2"),
        ("y/s", UNNAMED_UNITS, "y/s"),
    ],
)
def test_units_follow_from_those_of_output_and_command(unit, units, expected):
    assert units.of(unit) == expected


@pytest.mark.parametrize("text", ["", "rad/", "m//s", "(m", "m)", "m^", "5", "m^(1/0)"])
def test_what_is_no_product_of_powers_is_refused(text):
    with pytest.raises(ValueError, match="must be a product of powers"):
        parse_unit(text)


def test_exponents_without_their_sign_are_told():
    with pytest.raises(ValueError, match=r"got 'kg m2/s2'; exponents are written as in 'kg m\^2/s\^2'"):
        parse_unit("kg m2/s2")


def test_every_unit_of_the_package_is_one():
    """Each field and metric that names y or u keeps a unit without them, for every plant."""
    units = {metric.unit for metric in PACKAGE_METRICS.values()}
    for registry in registries().values():
        units |= {row[1] for entry in registry.values() for row in rows_of(entry)}
    named = {unit for unit in units if UNNAMED_UNITS.of(unit) != POSITION.of(unit)}
    assert len(named) >= 19
    for unit in named:
        for part in MOTOR.of(unit).split(", "):
            assert not {"y", "u"} & set(parse_unit(part))


def test_everything_follows_the_plants_units(shaft, tmp_path):
    result = dj.run(shaft)
    units = {name: result.dataset[name].attrs["units"] for name in ("error_rms", "command_energy", "itae")}
    assert units == {"error_rms": "rad/s", "command_energy": "V^2 s", "itae": "rad s"}
    assert result.dataset["error_rms"].attrs["long_name"] == "rms of the shaft speed error e"
    assert result.dataset["plant.gain"].attrs["units"] == "rad/(s^3 V)"
    assert result.dataset["slack_error_max_after_0.9"].attrs["units"] == "rad/s"
    assert shaft.requirements[0].text == "error_max after 0.9 s <= 0.5 rad/s"
    assert shaft.quantities["controller.k_p"].unit == "V s^2/rad"
    run = dj.simulate(shaft)
    assert {run[name].attrs["units"] for name in ("y", "y_ref", "e")} == {"rad/s"}
    assert run["u"].attrs == {"units": "V", "long_name": "robust armature voltage u"}
    labels = [ax.get_ylabel() for ax in dj.plot.trajectory(run).axes]
    assert labels[0] == "shaft speed [rad/s]"
    assert "armature voltage [V]" in labels
    result.save(tmp_path / "out")
    dj.export(dj.load(tmp_path / "out"), "csv", tmp_path / "draws.csv")
    (about,) = (file for file in tmp_path.glob("draws*") if file.suffix == ".json")
    assert '"rad/s"' in about.read_text()
    assert dj.load(tmp_path / "out").study.units == (MOTOR,)  # described, its code not imported


def test_a_study_sets_units(shaft):
    study = shaft.override({"units": {"output": "deg/s", "command_meaning": "duty"}})
    assert study.units == (MOTOR._replace(output="deg/s", command_meaning="duty"),)


def test_a_plant_without_units_shows_symbols(shaft):
    study = shaft.override({"plant.kind": "shaft_units:UNNAMED_UNITS"})
    assert study.requirements[0].text == "error_max after 0.9 s <= 0.5 y"
    assert {dj.simulate(study)[name].attrs["units"] for name in ("y", "e")} == {"y"}


def test_units_by_channel():
    study = dj.Study.load("studies/uav_robustness.toml").override({"units.x.output_meaning": "east"})
    assert [units.output for units in study.units] == ["m", "m", "m", "rad"]
    assert [units.output_meaning for units in study.units][:2] == ["east", "output"]


@pytest.mark.parametrize(
    ("units", "complaint"),
    [
        ({"output": "rad per s^"}, r"units.output: must be a product of powers"),
        ({"outpt": "rad"}, r"units.outpt: unknown name; did you mean 'output'"),
        ({"output": 3}, r"units.output: must be a unit"),
        ({"output_meaning": "two\nlines"}, r"units.output_meaning"),
    ],
)
def test_bad_units_are_refused(shaft, units, complaint):
    with pytest.raises(ConfigError, match=complaint):
        shaft.override({"units": units})
