"""The three studies of the comparison: one axis, a vehicle in a gust, and the vehicle in turbulent wind."""

from pathlib import Path

import dssc_jax as dj

STUDIES = Path(__file__).parents[2] / "studies"
COMMON, RARE, RARER = "common", "1e-5", "1e-6"
"""Bounds of the requirement: a failure of some percent, of about 1e-5, and of about 1e-6."""

BOUNDS = {
    "axis": {COMMON: 22.5, RARE: 88.0, RARER: 104.0},
    "gust": {COMMON: 4.0, RARE: 9.3, RARER: 10.9},
    "turbulence": {COMMON: 5.5},
}
GUST = {
    "kind": "gust",
    "x": {"truncated_normal": [8.0, 4.0, -12.0, 28.0]},
    "y": 0.0,
    "z": {"truncated_normal": [0.0, 1.0, -5.0, 5.0]},
    "mean_x": {"truncated_normal": [2.0, 1.0, -3.0, 7.0]},
    "duration": 4.0,
    "at": 10.0,
}


def study_of(model: str, bound: str) -> dj.Study:
    """The study of a model with a bound.

    ``axis`` is ``mu_robustness``, 60 s with 4 uncertain numbers. The others are ``uav_robustness``, which hovers for
    20 s with 14 uncertain numbers: ``turbulence`` with its turbulent wind and noisy sensors, ``gust`` with neither, but
    with one gust along x on a mean wind, both of uncertain strength.
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
    if model == "gust":
        hover |= {"sensor": {"kind": "ideal"}, "wind": GUST}
    return dj.Study.load(STUDIES / "uav_robustness.toml").without_sweep().override(hover)
