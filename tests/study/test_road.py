"""The road of the page of signals: the file from its formula, and a quarter car on it, written out in NumPy."""

import re
import shutil

import numpy as np
import pytest
from scipy.linalg import expm

import dssc_jax as dj
from benchmarks.road import ROAD, ROUGHNESS, SPEED, content
from tests.page_examples import BLOCK

PAGE = ROAD.parents[1] / "signals.md"
ROADS = [{"kind": "record", "input": "road", "file": "road.csv", "column": "speed"}]


@pytest.fixture
def car(tmp_path):
    text = next(text for _, text in BLOCK.findall(PAGE.read_text()) if text.startswith("# car.toml"))
    (tmp_path / "car.toml").write_text(text)
    shutil.copy(ROAD, tmp_path / "road.csv")
    return dj.Study.load(tmp_path / "car.toml")


def test_the_file_is_that_of_its_formula():
    assert ROAD.read_text() == content()


def test_its_spectrum_is_that_of_class_c():
    """The vertical speed is white: (2 pi n_0)^2 G_0 v per Hz, of which the octave around 8 Hz is measured."""
    speed = np.loadtxt(ROAD, delimiter=",", skiprows=2)[:-1, 1]
    lines = np.abs(np.fft.rfft(speed) / speed.size) ** 2 * 2.0
    frequencies = np.fft.rfftfreq(speed.size, 0.005)
    octave = (frequencies > 5.6) & (frequencies < 11.3)
    density = lines[octave].sum() / (octave.sum() / 3.0)
    assert density == pytest.approx((2.0 * np.pi * 0.1) ** 2 * ROUGHNESS * SPEED, rel=1e-4)


@pytest.mark.parametrize("form", ["hold", "linear"])
def test_a_car_on_it_is_that_of_numpy(car, form):
    """A damper to the sky, u = -1000 times the body's speed, held for a sample; the road is held or joined by lines."""
    study = car.override(
        {
            "controller": {"kind": "state_feedback", "k_1": 1000.0, "k_2": 0.0},
            "actuator": [],
            "parameters.m_s": 250.0,
            "parameters.k_t": 160e3,
            "disturbance": [ROADS[0] | {"interpolation": form}],
        }
    )
    run = dj.simulate(study)
    a = np.array([[0, 1, 0, -1], [-64.0, -4.0, 0, 4.0], [0, 0, 0, 1], [400.0, 25.0, -4000.0, -25.0]])
    inputs = np.array([[0.0, 0.004, 0.0, -0.025], [0.0, 0.0, -1.0, 0.0]]).T
    fine = 1 if form == "hold" else 200
    step = 0.005 / fine
    held = expm(np.block([[a, inputs], [np.zeros((2, 6))]]) * step)
    record = np.loadtxt(ROAD, delimiter=",", skiprows=2)
    x = np.zeros(4)
    travel = []
    for k in range(run.sizes["t"]):
        travel.append(x[0])
        command = -1000.0 * x[1]
        for part in range(fine):
            road = record[k, 1] if form == "hold" else np.interp(0.005 * k + step * (part + 0.5), *record.T)
            x = held[:4, :4] @ x + held[:4, 4:] @ np.array([command, road])
    largest = np.abs(travel).max()
    deviation = np.abs(np.array(travel) - run["travel"].values).max() / largest
    assert largest > 0.005
    assert deviation < (1e-9 if form == "hold" else 0.05)


def test_its_path_is_relative_to_the_study(car, tmp_path, monkeypatch):
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert dj.simulate(car.override({"disturbance": ROADS, "draws": 1}))["travel"].std() > 1e-4
    with pytest.raises(dj.ConfigError, match=re.escape("has no column 'sped'; did you mean 'speed'")):
        car.override({"disturbance": [ROADS[0] | {"column": "sped"}]})
