"""Metrics of a yaw that turns beyond half a turn."""

import numpy as np

import dssc_jax as dj

TURNING = {
    "name": "turning",
    "draws": 1,
    "loop": {"duration": 6.0, "sample_time": 0.02},
    "plant": {"kind": "uav", "vehicle": {"kind": "m600_hexacopter", "max_thrust": 60.0}, "position": [0.0, 0.0, 1.0]},
    "sensor": {"measures": ["psi", "psi_y"]},
    "controller": {"kind": "pid", "k_p": 1.0},
    "reference": {"kind": "hover", "position": [0.0, 0.0, 1.0], "psi": {"kind": "ramp", "slope": 1.0, "at": 0.5}},
    "metrics": {
        "names": [
            "variation_psi_y",
            "variation_psi",
            "variation_psi_e",
            "variation_measured_psi",
            "variation_measured_psi_y",
        ]
    },
}


def test_the_travel_of_a_yaw_has_no_jumps_of_a_turn():
    """It begins again at pi; NumPy unwraps it."""
    run = dj.simulate(dj.Study.from_table(TURNING), 0)
    assert np.abs(np.diff(run["psi"].values)).max() > 6.0
    travel = np.abs(np.diff(np.unwrap(run["psi"].values))).sum()
    assert travel > np.pi
    for name in ("variation_psi_y", "variation_psi"):
        np.testing.assert_allclose(run.attrs[name], travel, rtol=1e-9)
    for name in ("measured_psi", "measured_psi_y"):
        reading_travel = np.abs(np.diff(np.unwrap(run[name].values))).sum()
        np.testing.assert_allclose(run.attrs[f"variation_{name}"], reading_travel, rtol=1e-9)
    error_travel = np.abs(np.diff(np.unwrap(run["psi_e"].values))).sum()
    np.testing.assert_allclose(run.attrs["variation_psi_e"], error_travel, rtol=1e-9)
