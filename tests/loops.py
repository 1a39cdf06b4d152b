"""A loop that tests of margins and of comparisons share, as a study's tables."""

from typing import Any

LAGGED: dict[str, Any] = {
    "loop": {"duration": 6.0, "sample_time": 0.02},
    "plant": {"kind": "normal_form", "k_p": {"uniform": [0.7, 1.3]}, "initial": [0.5, 0.0]},
    "controller": {
        "kind": "dssc",
        "l0": 1.0,
        "rho": 6.0,
        "functions": {"kind": "approx_sta_2", "kappa1": 4.0, "kappa2": 4.0, "delta": 0.5, "tau_av": 0.05},
        "discretisation": "implicit",
        "predictor_start": "zero",
    },
    "unmodelled": {"kind": "lag", "order": 2, "mu": 0.02},
    "disturbance": {"kind": "step", "value": 0.3, "at": 3.0},
}
"""DSSC with state-dependent functions on an uncertain input gain, behind a lag of order 2."""
