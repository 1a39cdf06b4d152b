"""An answer does not depend on how many lanes its simulations share a batch with."""

from importlib import import_module

import numpy as np
import pytest

import dssc_jax as dj
from tests.analyses.test_one_shape import PAIR, TABLE, WALK

FEW = 100  # lanes
STUDY = dj.Study.from_table(TABLE)
GAINS = {"controller.l0": (0.3, 4.0)}
ANSWERS = {
    "probability": ("slacks", "LANES", lambda: dj.probability(STUDY, 0.2)),
    "importance sampling": (
        "slacks",
        "LANES",
        lambda: dj.rare(STUDY, dj.ImportanceSampling(0.5, plain=64), None),
    ),
    "splitting": (
        "slacks",
        "LANES",
        lambda: dj.rare(STUDY, None, dj.Splitting(particles=20, killed=10, moves=1, repeats=10, plain=150)),
    ),
    "margin": ("margins.simulated", "BLOCK", lambda: dj.margin(STUDY.override({"draws": 150}), **WALK)),
    "region": ("region.lattice", "BLOCK", lambda: dj.region(STUDY.override({"draws": 200}), over=PAIR, halvings=0)),
    "select": ("selection.selection", "BLOCK", lambda: dj.select(STUDY, over=GAINS, candidates=16, keep=3, within=0.2)),
    "sensitivity": ("sensitivity.analysis", "BLOCK", lambda: dj.sensitivity(STUDY.override({"draws": 256}))),
}
"""The module with the number of lanes, its name there, and the analysis."""


@pytest.mark.parametrize("name", ANSWERS)
def test_batches_of_any_size_give_the_same_answer(name, monkeypatch):
    path, lanes, answer = ANSWERS[name]
    module = import_module(f"dssc_jax.analyses.{path}")
    assert getattr(module, lanes) > FEW
    whole = answer()
    monkeypatch.setattr(module, lanes, FEW)
    parted = answer()
    assert set(whole.dataset) == set(parted.dataset)
    for column in whole.dataset:
        np.testing.assert_array_equal(whole.dataset[column].values, parted.dataset[column].values, err_msg=str(column))
