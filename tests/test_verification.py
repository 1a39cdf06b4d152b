"""A stored result against its lanes computed again."""

import json
import shutil

import numpy as np
import pytest
import zarr

import dssc_jax as dj
from dssc_jax.cli import guarded
from dssc_jax.errors import ConfigError
from dssc_jax.verification import ROUNDING, bits, deviations
from tests.test_durability import SMALL


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return dj.run(dj.Study.from_table(SMALL), tmp_path_factory.mktemp("results") / "small")


@pytest.fixture
def copied(whole, tmp_path):
    return shutil.copytree(whole.path, tmp_path / "copied")


def change(folder, name, factor):
    """Falsify a whole variable, checksums and all."""
    array = zarr.open_group(folder / "data.zarr", mode="r+")[name]
    array[...] = (np.asarray(array) * factor).astype(array.dtype)


def test_a_result_is_what_is_computed(whole):
    found = dj.verify(whole, draws=500, seed=1)
    assert (found.lanes, found.identical, found.deviation, found.worst) == (144, 144, 0.0, None)
    assert found.verified
    assert found.otherwise == []


def test_seeds_pick_lanes(whole):
    assert dj.verify(whole, draws=3, seed=1) == dj.verify(whole, draws=3, seed=1)
    assert dj.verify(whole, draws=3).seed != dj.verify(whole, draws=3).seed


@pytest.mark.parametrize(
    ("name", "factor", "code"), [("error_rms", 1 + 1e-12, 0), ("error_rms", 1.001, 1), ("plant.k_p", 1.01, 1)]
)
def test_deviations_are_found(copied, capsys, name, factor, code):
    change(copied, name, factor)
    assert guarded(["verify", str(copied), "--json"]) == code
    found = json.loads(capsys.readouterr().out)
    assert found["identical"] == 0
    assert found["deviation"] == pytest.approx(factor - 1, rel=0.02)
    assert found["worst"]["variable"] == name
    assert found["verified"] is (code == 0)
    assert found["worst"]["stored"] == pytest.approx(found["worst"]["computed"] * factor, rel=1e-12)
    assert guarded(["verify", str(copied), "--seed", "1"]) == code
    assert ("more than rounding" in capsys.readouterr().out) is (code == 1)


def test_an_outcome_is_right_or_wrong(copied):
    change(copied, "outcome", 2)
    found = dj.verify(dj.load(copied), draws=200)
    assert not found.verified
    assert found.deviation == np.inf


def test_sizes_of_deviations():
    nan, inf = np.nan, np.inf
    stored, computed = np.array([1.0, 0.0, nan, inf, -inf, nan]), np.array([1.0, 1e-12, nan, inf, inf, 1.0])
    np.testing.assert_allclose(deviations(stored, computed), [0.0, 2e-12, 0.0, 0.0, inf, inf])
    assert list(bits(np.array([0.0, -0.0, nan])) == bits(np.array([0.0, 0.0, -nan]))) == [True, False, True]
    assert ROUNDING[64] < ROUNDING[32]


def test_bad_requests(whole, tmp_path, capsys):
    for options, message in ({"draws": 0}, "must be in 1"), ({"draws": 10**6}, "must be in 1"), ({"seed": -1}, ">= 0"):
        with pytest.raises(ConfigError, match=message):
            dj.verify(whole, **options)
    assert guarded(["verify", str(tmp_path)]) == 2
    assert "is not a results folder" in capsys.readouterr().err
