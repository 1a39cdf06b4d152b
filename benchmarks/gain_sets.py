"""Loops whose local margin is known from eigenvalues, as docs/margins.md and the tests measure it."""

from typing import Any

import dssc_jax as dj

DELTA = 0.5  # of the square-root functions [(m/s)^(1/2)]; sigma counts as small below 1e-4 delta^2
CONSTANT = {
    "kind": "constant",
    "k_o": {"loguniform": [2.0, 10.0]},
    "tau_av": 0.05,
    "tau_m": {"loguniform": [0.15, 0.6]},
}
SQUARE_ROOT = {
    "kind": "square_root",
    "kappa_o": {"loguniform": [4.0, 20.0]},
    "kappa_m": {"loguniform": [0.3, 1.2]},
    "delta_o": DELTA,
    "delta_m": DELTA,
    "tau_av": 0.05,
}


def random_gains(
    order: int, functions: dict[str, Any], *, draws: int = 200, sample_time: float = 0.01, duration: float = 100.0
) -> dj.Study:
    """Random plants and gain sets under a lag; a deviation so small that its growth does not make it large.

    Args:
        order: Of the lag.
        functions: DSSC's; rho is never reached.
        draws: Plants with their gains.
        sample_time: T_s [s].
        duration: Of a run [s]; growth is measured over its last three quarters.
    """
    return dj.Study.from_table(
        {
            "name": "random-gains",
            "seed": 5,
            "draws": draws,
            "loop": {"duration": duration, "sample_time": sample_time},
            "plant": {
                "kind": "normal_form",
                "k_p": {"uniform": [0.7, 1.4]},
                "a_p": {"uniform": [0.2, 2.0]},
                "initial": [1e-200, 0.0],
            },
            "controller": {
                "kind": "dssc",
                "l0": {"uniform": [1.0, 3.0]},
                "rho": 1e30,
                "predictor_start": "matched",
                "functions": functions,
            },
            "unmodelled": {"kind": "lag", "order": order, "mu": 0.1},
            "metrics": {"names": []},
            "requirement": [
                {"metric": "growth_rate", "after": duration / 4, "max": 0.0},
                {"metric": "sigma_max", "max": 1e-4 * DELTA**2},
            ],
        }
    )
