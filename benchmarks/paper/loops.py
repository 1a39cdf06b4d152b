"""The article's loops: studies and what is changed of them."""

from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

import dssc_jax as dj

ROOT = Path(__file__).parents[2]
STUDIES = ROOT / "studies"
AXES = ("x", "y", "z", "psi")
KAPPA_1, KAPPA_2 = 0.6025, 100.0  # of the comparison, Table 2's normalisation
CASE_1 = 4.0166  # s (m/s)^(-1/2): kappa_m of Case 1, which the comparison's list of changes does not touch
TAU_AV = {"x": 0.03, "y": 0.03, "z": 0.06, "psi": 0.06}  # s
RHO = {"x": 0.375, "y": 0.375, "z": 0.125, "psi": 0.0375}  # m/s, rad/s
WIDE = 100.0  # m/s, rad/s: a rho that is never reached
FIELD_STA = {
    "kind": "sta",
    "l0": 2.0,
    "kappa1": 0.075,
    "kappa2": 0.07,
    "nominal": {"a": 2.0, "k": 2.0, "predictor_term": False},
}
Runs = dict[str, xr.Dataset]
KNOWN: Runs = {}


def load(name: str, **changes: Any) -> dj.Study:
    """A shipped study."""
    return dj.Study.load(STUDIES / f"{name}.toml").override(changes)


def case_2(axis: str) -> dj.Study:
    """Case 2 on one axis."""
    start, value = {"x": (40.0, -0.8), "y": (10.0, 0.8), "z": (10.0, 0.2), "psi": (np.pi / 4, 0.1)}[axis]
    changes: dict[str, Any] = {"reference.axis": axis, "plant.initial": [start, 0.0], "disturbance.value": value}
    if axis in ("z", "psi"):
        slow = {"controller.functions.kappa_o": 55.3255, "controller.functions.tau_av": 0.06}
        changes |= {"controller.rho": 0.5 if axis == "z" else 0.15} | slow
    return load("paper_case2").override(changes)


def simplified(duration: float) -> xr.Dataset:
    """Case 2 on all axes, named as the full UAV's signals are."""
    runs = []
    for axis in AXES:
        one = dj.simulate(case_2(axis).override({"requirement": [], "loop.duration": duration}))
        runs.append(one.rename({name: f"{axis}_{name}" for name in one.data_vars}).drop_attrs())
    return xr.merge(runs)


def comparison(kappa2: float = KAPPA_2, **changes: Any) -> dj.Study:
    """The comparison's loop with kappa_m = kappa1/kappa2, unless ``changes`` has another."""
    gains = {"controller.functions.kappa_m": KAPPA_1 / kappa2}
    return load("paper_sta_comparison").override({**gains, "requirement": [], **changes})


def wide(study: dj.Study) -> dj.Study:
    """DSSC with a rho that is never reached."""
    return study.override({f"controller.{axis}rho": WIDE for axis in ("", "z.", "psi.")})


def sta(kappa2: float = KAPPA_2, form: str = "implicit", clipped: bool = False) -> dict[str, Any]:
    """The comparison's STA; clipped: to the rho of DSSC, axis by axis."""
    nominal = {"a": 1.0, "k": 1.0, "predictor_term": False}
    table: dict[str, Any] = {"kind": "sta", "l0": 0.2, "kappa1": KAPPA_1, "kappa2": kappa2, "nominal": nominal}
    table["discretisation"] = form
    return {**table, **({axis: {"limit": RHO[axis]} for axis in AXES} if clipped else {})}


def two(kappa2: float = KAPPA_2, duration: float = 80.0, **changes: Any) -> Runs:
    """DSSC and STA in one set-up."""
    study = comparison(kappa2=kappa2, **{"loop.duration": duration, **changes})
    return {"DSSC": once(study), "STA": once(study.override({"controller": sta(kappa2=kappa2)}))}


def four(duration: float = 80.0, **changes: Any) -> Runs:
    """Both at kappa2 = 100, the STA clipped to the rho of DSSC, and DSSC with a rho that is never reached."""
    study = comparison(**{"loop.duration": duration, **changes})
    clipped = study.override({"controller": sta(clipped=True)})
    return {**two(duration=duration, **changes), "STA clipped": once(clipped), "DSSC wide": once(wide(study))}


def once(study: dj.Study) -> xr.Dataset:
    """The first draw, simulated once: several set-ups share a run."""
    if study.hash not in KNOWN:
        KNOWN[study.hash] = dj.simulate(study)
    return KNOWN[study.hash]


def field(draw: int, predictor_term: bool = False, duration: float = 80.0, height: float = 5.0) -> Runs:
    """DSSC and STA in the field test's set-up, in the same wind, from a hover at the height [m]."""
    changes = {"requirement": [], "loop.duration": duration, "plant.position": [0.0, 0.0, height]}
    study = load("paper_field_test").override(changes)
    return {
        "DSSC": dj.simulate(study.override({"controller.nominal.predictor_term": predictor_term}), draw=draw),
        "STA": dj.simulate(study.override({"controller": FIELD_STA}), draw=draw),
    }
