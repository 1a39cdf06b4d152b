"""Limit cycles of the comparison's x axis: what harmonic balance predicts beside what flies."""

from itertools import pairwise

import jax
import numpy as np

import dssc_jax as dj
from benchmarks.paper.balance import Cycle, branch, element, relay_cycle, simulated
from benchmarks.paper.loops import RHO, comparison, sta

KAPPA_M = (1.0, 0.25, 0.06025, 0.006025, 0.002)
LARGEST = Cycle(0.78, 0.068, 0.05)  # at kappa_m = 1, where the branch is entered
BETWEEN = 6  # steps of kappa_m between two values of the table: each cycle is the guess of the next
ON_REFERENCE = {"plant.position": [0.0, 20.0, 5.0], "plant.velocity": [np.pi, 0.0, 0.1 * np.pi]}


def predicted(study: dj.Study) -> dict[float, Cycle]:
    """Limit cycles of DSSC at the values of kappa_m."""
    steps = [np.geomspace(a, b, BETWEEN, endpoint=False) for a, b in pairwise(KAPPA_M)]
    values = np.concatenate([*steps, KAPPA_M[-1:]])
    found = branch(element(study, "kappa_m"), values, LARGEST, study.loop.sample_time)
    return dict(zip(KAPPA_M, found[::BETWEEN], strict=True))


def cycles() -> dict[str, tuple[Cycle, Cycle]]:
    """A name, the prediction, and the flight from the reference."""
    study = comparison(**ON_REFERENCE)
    found = {}
    with jax.enable_x64(True):
        ahead = predicted(study)
    for kappa_m, cycle in ahead.items():
        flown = dj.simulate(study.override({"controller.functions.kappa_m": kappa_m}))
        found[f"DSSC, kappa_m = {kappa_m:g}"] = cycle, simulated(flown)
    clipped = dj.simulate(study.override({"controller": sta(clipped=True)}))
    found["STA clipped"] = relay_cycle(RHO["x"], study.loop.sample_time), simulated(clipped)
    return found
