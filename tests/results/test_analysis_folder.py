"""The folder of an analysis."""

import numpy as np
import xarray as xr

import dssc_jax as dj
from dssc_jax.results.analysis_folder import read_analysis, save
from tests.conftest import CASE_2


def test_variables_keep_their_order(tmp_path):
    """Exported tables have the same columns on every machine, in whatever order its file system lists the arrays."""
    names = [f"metric_{number}" for number in (7, 2, 9, 4, 1, 8, 3, 6, 5)]
    coordinates = {"draw": np.arange(3), "controller": ["pi", "dssc"], "axis": [0.1, 0.2]}
    values = {name: (("controller", "draw"), np.full((2, 3), 1.0)) for name in names}
    dataset = xr.Dataset(values, coordinates, {"title": "order"})
    study = dj.Study.from_table(CASE_2)
    save(tmp_path / "folder", "margin", study, dataset, {}, {})
    loaded = read_analysis(tmp_path / "folder", "margin", trust_code=False).dataset
    assert list(loaded.data_vars) == names
    xr.testing.assert_identical(loaded, dataset)
