"""Recorded references of angles."""

import numpy as np

import dssc_jax as dj


def test_the_record_of_an_angle_goes_by_the_shorter_way():
    """A yaw within (-pi, pi] that passes pi turned by 6.2 rad the other way in a sample."""
    table = {
        "name": "yaw", "draws": 1, "loop": {"duration": 2.0, "sample_time": 0.5}, "plant": {"kind": "uav", "yaw": 3.1},
        "reference": {"kind": "hover", "psi": {"kind": "record", "time": [0.0, 1.0, 2.0], "value": [3.1, -3.1, -3.0]}},
        "controller": {"kind": "pid", "k_p": 0.5},
    }  # fmt: skip
    desired = dj.simulate(dj.Study.from_table(table))["psi_y_ref"].values
    turn = 2.0 * np.pi
    np.testing.assert_allclose(desired, [3.1, 0.5 * turn, turn - 3.1, turn - 3.05], rtol=1e-12)
    shown = {"x": table["reference"]["psi"]} | {"kind": "hover"}
    assert dj.simulate(dj.Study.from_table(table | {"reference": shown}))["x_y_ref"].values[1] == 0.0  # no angle
