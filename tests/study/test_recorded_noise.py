"""A sensor whose noise is recorded: held, repeated, begun anywhere, and read from a file."""

import numpy as np
import pandas as pd
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.design.noise import noise_drift
from dssc_jax.study.tables import to_toml

TIMES = 2.0 + 0.01 * np.arange(150)
NOISE = np.random.default_rng(5).normal(size=(2, len(TIMES))) * [[1e-3], [0.02]]
L0 = 2.0
SIGMA = NOISE[1] + L0 * NOISE[0]
TABLE = {
    "name": "noise",
    "draws": 40,
    "loop": {"duration": 4.0, "sample_time": 0.01},
    "plant": {"kind": "normal_form"},
    "controller": {"kind": "pi", "l0": L0, "k_p": 3.0, "k_i": 0.0},
    "sensor": {"kind": "record", "file": "noise.csv", "columns": ["ny", "nv"]},
}


@pytest.fixture
def folder(tmp_path):
    pd.DataFrame({"t": TIMES, "ny": NOISE[0], "nv": NOISE[1]}).to_csv(tmp_path / "noise.csv", index=False)
    (tmp_path / "study.toml").write_text(to_toml(TABLE))
    return tmp_path


def noise_of(run):
    """What the sensor has added to sigma, shape (samples,)."""
    return (run["sigma_measured"] - run["sigma"]).values


def test_a_record_is_played_from_its_first_time_and_repeated(folder):
    study = dj.Study.load(folder / "study.toml").override({"sensor.start": "first"})
    np.testing.assert_allclose(noise_of(dj.simulate(study)), np.resize(SIGMA, 400), atol=1e-12)


def test_each_draw_begins_anywhere_in_the_record(folder):
    study = dj.Study.load(folder / "study.toml")
    begins = []
    for draw in range(40):
        seen = noise_of(dj.simulate(study, draw=draw))
        gaps = [np.abs(seen - np.resize(np.roll(SIGMA, -k), 400)).max() for k in range(150)]
        begins.append(int(np.argmin(gaps)))
        assert min(gaps) < 1e-9
    assert len(set(begins)) > 25  # 35 are expected of 40 in 150
    assert min(begins) < 40
    assert max(begins) > 110


def test_the_draws_differ_and_are_those_of_a_run(folder):
    study = dj.Study.load(folder / "study.toml")
    result = dj.run(study)
    errors = result.dataset["error_rms"].values
    assert len(np.unique(errors)) > 25
    assert dj.simulate(study, draw=7).attrs["error_rms"] == pytest.approx(errors[7], rel=1e-9)
    assert dj.run(study.override({"sensor": {"kind": "ideal"}})).dataset["error_rms"].values.std() == 0.0


def test_the_prediction_of_drift_takes_records(folder, monkeypatch, capsys):
    """The commands warn of noise: with a recorded disturbance, too, and in DSSC's implicit form."""
    monkeypatch.chdir(folder)
    disturbance = "disturbance={ kind = 'record', file = 'noise.csv', column = 'nv' }"
    assert guarded(["run", "study.toml", "--set", disturbance, "--draws", "2"]) == 0
    functions = {"kind": "square_root", "kappa_o": 20.0, "kappa_m": 4.0, "delta_o": 1.0, "delta_m": 1.0, "tau_av": 0.03}
    dssc = {"kind": "dssc", "discretisation": "implicit", "l0": L0, "rho": 2.0, "functions": functions}
    study = dj.Study.load(folder / "study.toml").override({"controller": dssc, "disturbance.kind": "none"})
    (drift,) = noise_drift(study).values()
    assert drift.noise == pytest.approx(SIGMA.std(), rel=0.2)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"sensor.columns": ["ny"]}, "sensor.columns: must be the file's columns with position, velocity"),
        ({"sensor.columns": ["ny", "nw"]}, "no column 'nw'"),
        ({"sensor.position": [0.0, 1.0]}, "sensor.position: is given by the file"),
        ({"sensor.start": "last"}, "sensor.start"),
    ],
)
def test_bad_input_is_reported_in_one_line(folder, changes, message):
    with pytest.raises(ConfigError, match=message):
        dj.Study.from_table(TABLE | {"sensor": {"kind": "ideal"}}, str(folder / "study.toml")).override(
            {"sensor": TABLE["sensor"], **changes}
        )


def test_the_precision_does_not_change_where_a_draw_begins(folder):
    study = dj.Study.load(folder / "study.toml")
    double, single = (dj.run(study.override({"loop.precision": bits})).dataset["error_rms"].values for bits in (64, 32))
    np.testing.assert_allclose(single, double, rtol=1e-3)
