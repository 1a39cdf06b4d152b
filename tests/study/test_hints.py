"""Mistakes of section and of separator get a hint of their own, which is right."""

from typing import NamedTuple

import pytest

from dssc_jax.cli.main import guarded
from dssc_jax.cli.parsing import parse_sweep_axis, parse_walk
from dssc_jax.core.errors import ConfigError
from dssc_jax.study import Study
from dssc_jax.types import Measurement, Plant
from tests.conftest import UNCERTAIN
from tests.mutations import document

HOVER = {
    "name": "hover",
    "loop": {"duration": 1.0, "sample_time": 0.01},
    "plant": {"kind": "uav", "vehicle": {"kind": "m600_quadrotor"}},
    "controller": {"kind": "pid", "k_p": 1.0},
}


@pytest.mark.parametrize(
    ("changes", "where", "hint"),
    [
        ({"duration": 3.0}, "duration", "'duration' belongs in [loop]"),
        ({"loop.draws": 3}, "loop.draws", "'draws' belongs at the top of the file"),
        ({"controller.mu": 0.1}, "controller.mu", "'mu' belongs in [unmodelled]"),
        ({"plant.tau_av": 0.1}, "plant.tau_av", "'tau_av' belongs in [controller.functions]"),
        ({"controller.tau_av": 0.1}, "controller.tau_av", "'tau_av' belongs in [controller.functions]"),
        ({"plant.rate": 1.0}, "plant.rate", "'rate' belongs in [unmodelled] of kind \"rate_limit\""),
        ({"controller.tau_aw": 0.1}, "controller.tau_aw", "unknown name; "),
    ],
)
def test_a_name_in_the_wrong_section(changes, where, hint):
    study = Study.from_table(UNCERTAIN)
    with pytest.raises(ConfigError) as caught:
        study.override(changes)
    assert f"study: {where}: unknown name" in str(caught.value)
    assert hint in str(caught.value)


def test_a_misspelt_section_that_is_required():
    """The name is missing only because it is misspelt."""
    table = {("controler" if name == "controller" else name): value for name, value in UNCERTAIN.items()}
    with pytest.raises(ConfigError, match=r"controler: unknown name; did you mean 'controller'\?"):
        Study.from_table(table)


def test_a_name_that_belongs_into_a_part_of_the_vehicle():
    with pytest.raises(ConfigError, match=r"'mass' belongs in \[plant.vehicle\] or in \[plant.believed\]"):
        Study.from_table({**HOVER, "plant": {**HOVER["plant"], "mass": 1.0}})


@pytest.mark.parametrize(
    ("typed", "wanted"),
    [
        ("plant.k_p=0.5,2,9", "plant.k_p=0.5:2:9"),
        ("plant.k_p:0.5:2:9", "plant.k_p=0.5:2:9"),
        ("plant.k_p=0.5..2;9:log", "plant.k_p=0.5:2:9:log"),
        ("plant/k_p=0.5 2 9", "plant.k_p=0.5:2:9"),
    ],
)
def test_separators_of_an_axis(typed, wanted):
    with pytest.raises(ConfigError) as caught:
        parse_sweep_axis(typed)
    assert str(caught.value).endswith(f"; did you mean '{wanted}'?")
    assert parse_sweep_axis(wanted)[0] == "plant.k_p"


def test_separators_of_bounds():
    with pytest.raises(ConfigError, match=r"did you mean 'plant\.k_p=1e-3:2'"):
        parse_walk("plant.k_p=1e-3 to 2")
    with pytest.raises(ConfigError) as caught:
        parse_walk("plant.k_p=high:low")
    assert "did you mean" not in str(caught.value)


@pytest.mark.parametrize(
    ("options", "hint"),
    [
        (
            ["compare", "--controllers", "dssc;sta"],
            "takes names separated by commas; did you mean 'dssc,sta'?",
        ),
        (["compare", "--controllers", "dssc sta"], "did you mean 'dssc,sta'?"),
        (["run", "--set", "plant.k_p:2"], "--set: must be NAME=VALUE, got 'plant.k_p:2'; did you mean 'plant.k_p=2'?"),
    ],
)
def test_separators_of_options(options, hint, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "some.toml").write_bytes(document({**UNCERTAIN, "sweep": {}}))
    assert guarded([options[0], "some.toml", *options[1:]]) == 2
    assert hint in capsys.readouterr().err


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("draws: 30", "the line is: draws: 30; '=' separates a name from its value"),
        ("values = [1.0; 2.0]", "',' separates the items of a list"),
        ("duration = 0,5", "'.' is the decimal point"),
    ],
)
def test_separators_of_a_file(line, hint, tmp_path):
    file = tmp_path / "study.toml"
    file.write_text(f'name = "separators"\n{line}\n')
    with pytest.raises(ConfigError, match="is not valid TOML") as caught:
        Study.load(file)
    assert hint in str(caught.value)


@pytest.mark.parametrize(
    ("line", "hint"),
    [
        ("tune.objective.error_max_after_0.5 = 1.0", 'a name with a dot needs quotes: "error_max_after_0.5" = 1.0'),
        ("tune.parameters.controller.k_p = [1, 2]", 'a name with a dot needs quotes: "controller.k_p" = [1, 2]'),
        ("sweep.controller.k_p = { values = [1.0] }", '"controller.k_p" = { values = [1.0] }'),
        ("tune.objective.error_max = { }", "must be a finite number"),
    ],
)
def test_names_with_dots_need_quotes(line, hint, tmp_path):
    file = tmp_path / "study.toml"
    file.write_text(
        f'name = "dots"\n{line}\nloop = {{ duration = 1.0, sample_time = 0.1 }}\n'
        'plant = { kind = "normal_form" }\ncontroller = { kind = "pid", k_p = 1.0 }\n'
    )
    with pytest.raises(ConfigError) as caught:
        Study.load(file)
    assert hint in str(caught.value)


def test_names_with_dots_need_no_quotes_in_an_override():
    table = {"name": "dots", "loop": {"duration": 1.0, "sample_time": 0.1}, "plant": {"kind": "normal_form"}}
    table |= {"controller": {"kind": "pid", "k_p": 1.0}}
    table |= {"tune": {"parameters": {"controller.k_p": [1.0, 2.0]}, "objective": {"error_max": 1.0}}}
    study = Study.from_table(table)
    for name in ("tune.parameters.controller.k_p", 'tune.parameters."controller.k_p"'):
        assert study.override({name: [3.0, 4.0]}).config.tune.parameters == {"controller.k_p": (3.0, 4.0)}


@pytest.mark.parametrize(
    ("written", "meant"),
    [("Kp", "k_p"), ("KP", "k_p"), ("K-p", "k_p"), ("kp", "k_p"), ("Ki", "k_i"), ("KD", "k_d"), ("L0", "l0")],
)
def test_gains_as_books_write_them(written, meant):
    gains = {"k_p": 4.0, "k_i": 0.5, "k_d": 2.0, "l0": 1.0}
    gains[written] = gains.pop(meant)
    table = {"name": "small", "loop": {"duration": 1.0, "sample_time": 0.1}, "plant": {"kind": "normal_form"}}
    with pytest.raises(ConfigError, match=rf"controller.{written}: unknown name; did you mean '{meant}'\?"):
        Study.from_table({**table, "controller": {"kind": "pid", **gains}})


@pytest.mark.parametrize(
    ("word", "command"),
    [
        ("bode", "loop"),
        ("Nyquist", "loop"),
        ("step", "simulate"),
        ("pole", "theory"),
        ("mc", "run"),
        ("mussv", "worst-loop"),
    ],
)
def test_words_of_other_programs_lead_to_their_command(word, command, capsys):
    assert guarded([word, "motor"]) == 2
    assert capsys.readouterr().err.startswith(f"error: '{word}' is no command; dssc-jax {command} answers that")


class Bare(NamedTuple):
    """Parameters without a quantity."""

    gain: float = 1.0


BARE = Plant(Bare, lambda p: 0.0, lambda p, s, drive, t: -s, lambda p, s, drive: Measurement(s, -s), lambda p: 1.0)


def test_a_number_without_a_quantity_gets_the_type_to_write():
    table = {"name": "bare", "loop": {"duration": 1.0, "sample_time": 0.1}, "controller": {"kind": "pid", "k_p": 1.0}}
    plant = {"kind": "tests.study.test_hints:BARE", "gain": 2.0}
    with pytest.raises(ConfigError, match=r"plant.gain: is not set by a study.*Annotated\[float, Quantity"):
        Study.from_table({**table, "plant": plant})
