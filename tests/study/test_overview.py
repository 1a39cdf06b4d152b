"""``print(study)`` is one page; functions of a study take its file."""

import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from dssc_jax.study.library import available_studies

SMALL = """
name = "small"
description = "a mass under PID"
draws = 3
loop = { duration = 0.5, sample_time = 0.01 }
plant = { kind = "normal_form", k_p = "=1/m", initial = [1.0, 0.0] }
controller = { kind = "pid", k_p = 4.0, k_i = 0.5, k_d = 2.0 }
parameters = { m = { uniform = [0.8, 1.25], unit = "kg", meaning = "mass" } }
requirement = [{ metric = "error_max", max = 2.0 }]
sweep = { "controller.k_p" = [3.0, 4.0] }
"""
PAGE = """small: a mass under PID
3 draws (random, seed 0) of 0.5 s, sampled every 0.01 s

loop
  plant       normal_form  k_p = 1/m, a_p = 1, initial.0 = 1, initial.1 = 0
  reference   zero
  controller  pid          k_p = 4, k_i = 0.5, k_d = 2, filter = 0, proportional_weight = 1, derivative_weight = 0 ...

uncertain
  parameters.m  uniform(0.8, 1.25)  kg  mass

follows from parameters
  plant.k_p  = 1/m  0.8 to 1.25 1/s

swept
  controller.k_p  3 to 4, 2 values  1/s  proportional gain

required
  error_max <= 2 m"""


@pytest.fixture
def path(tmp_path):
    file = tmp_path / "small.toml"
    file.write_text(SMALL)
    return file


def test_the_page_of_a_small_study(path):
    study = dj.Study.load(path)
    assert str(study) == PAGE
    assert repr(study) == "<Study 'small': 3 draws, 1 uncertain, 1 swept>"


@pytest.mark.parametrize("name", available_studies())
def test_each_study_fits_on_a_page(name):
    lines = str(dj.Study.load(name)).splitlines()
    assert len(lines) <= 55
    assert max(map(len, lines)) <= 120


def test_functions_of_a_study_take_its_file(path):
    by_file = dj.run(str(path)).dataset
    assert by_file.equals(dj.run(path).dataset)
    assert by_file.equals(dj.run(dj.Study.load(path)).dataset)
    assert dj.simulate(path, draw=1).sizes["t"] == 50
    assert dj.run("motor", check=False).study.name == dj.Study.load("motor").name
    with pytest.raises(ConfigError, match=r"no-such-study: is neither a file nor the name of a study"):
        dj.run("no-such-study")
