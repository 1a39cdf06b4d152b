"""The two studies of the comparison: one axis, and a vehicle in turbulent wind."""

from pathlib import Path

import dssc_jax as dj

STUDIES = Path(__file__).parents[2] / "studies"
COMMON, RARE, RARER = "common", "1e-5", "1e-6"
"""Bounds of the requirement: a failure of some percent, of about 1e-5, and of about 1e-6."""

BOUNDS = {"axis": {COMMON: 22.5, RARE: 88.0, RARER: 104.0}, "vehicle": {COMMON: 5.5}}


def study_of(model: str, bound: str) -> dj.Study:
    """The study of a model with a bound.

    The axis is ``mu_robustness``, 60 s with 4 uncertain numbers. The vehicle is ``uav_robustness`` with 14 of them; it
    hovers for 20 s in turbulent wind.
    """
    limit = BOUNDS[model][bound]
    if model == "axis":
        study = dj.Study.load(STUDIES / "mu_robustness.toml").without_sweep()
        return study.override({"requirement.0.max": limit})
    hover = {
        "loop.duration": 20.0,
        "plant.position": [0.0, 0.0, 0.0],
        "reference": {"kind": "zero"},
        "requirement": [{"metric": "position_error_max", "after": 10.0, "max": limit}],
    }
    return dj.Study.load(STUDIES / "uav_robustness.toml").without_sweep().override(hover)
