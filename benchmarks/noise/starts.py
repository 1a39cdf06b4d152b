"""What the predictor's start changes: Case 2 with both starts, and a rho that the start can exceed."""

from typing import NamedTuple

import numpy as np

import dssc_jax as dj
from benchmarks.noise.forms import CASE_2, FORMS


class Start(NamedTuple):
    """One run: rms of e, and after 40 s [m], |u_av| after 1 s [m/s], share of samples outside sliding."""

    form: str
    rho: float
    start: str
    error: float
    settled: float
    jump: float
    outside: float


def starts() -> list[Start]:
    """Case 2 at 5 ms: both forms, two bounds, both starts."""
    found = []
    for rho in (1.5, 0.3):
        for start in ("zero", "matched", "midpoint"):
            for form in FORMS:
                changes = {
                    "controller.rho": rho,
                    "controller.predictor_start": start,
                    "controller.discretisation": form,
                    "disturbance.value": -0.2,
                }
                run = dj.simulate(CASE_2.override(changes))
                u_av = float(run["u_av"].values[np.searchsorted(run["t"].values, 1.0)])
                errors = run.attrs["error_rms"], run.attrs["error_rms_after_40"]
                found.append(Start(form, rho, start, *errors, abs(u_av), run.attrs["outside_sliding"]))
    return found
