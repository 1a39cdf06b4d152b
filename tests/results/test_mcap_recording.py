"""An MCAP file is read by the reader of mcap: its poses are those of the trajectory; body rates fit the attitude."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.cli.main import guarded

STUDY = """
name = "fly"
draws = 2
loop = { duration = 1.0, sample_time = 0.01 }
reference = { kind = "hover", position = [1.0, -0.5, 10.5] }
wind = { kind = "constant", x = 3.0, y = 1.0, z = 0.5 }
controller = { kind = "pi", l0 = 0.5, k_p = 0.8, k_i = 0.2 }
[plant]
kind = "uav"
position = [0.0, 0.0, 10.0]
vehicle = { kind = "m600_quadrotor", motor_lag = 0.05 }
[[requirement]]
metric = "position_error_max"
max = 0.5
"""


@pytest.fixture(scope="module")
def flight(tmp_path_factory):
    """A flight, and the folder of its files."""
    folder = tmp_path_factory.mktemp("flight")
    (folder / "fly.toml").write_text(STUDY)
    files = [str(folder / name) for name in ("flight.mcap", "flight.parquet")]
    assert guarded(["simulate", str(folder / "fly.toml"), "--mcap", files[0], "--parquet", files[1], "--json"]) == 0
    return dj.simulate(folder / "fly.toml"), folder


def messages(path):
    """All messages of a file by topic, as (time [s], message)."""
    pytest.importorskip("mcap")
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    found = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message, content in reader.iter_decoded_messages():
            assert schema.encoding == "protobuf"
            found.setdefault(channel.topic, []).append((1e-9 * message.log_time, content))
    return found


def test_poses_are_those_of_the_trajectory(flight):
    trajectory, folder = flight
    found = messages(folder / "flight.mcap")
    poses = [(t, content.pose.position, content.pose.orientation) for t, content in found["/pose"]]
    np.testing.assert_allclose([t for t, *_ in poses], trajectory["t"], atol=1e-9)
    for axis in "xyz":
        np.testing.assert_array_equal([getattr(p, axis) for _, p, _ in poses], trajectory[f"{axis}_y"])
    for part in "wxyz":
        np.testing.assert_array_equal([getattr(q, part) for *_, q in poses], trajectory[f"attitude_{part}"])
        turned = [getattr(content.rotation, part) for _, content in found["/tf"]]
        np.testing.assert_array_equal(turned, trajectory[f"attitude_{part}"])
    np.testing.assert_array_equal([wind.x for _, wind in found["/wind"]], 3.0)
    for i in range(1, 5):
        speeds = [getattr(rotors, f"rotor_speed_{i}") for _, rotors in found["/rotors"]]
        np.testing.assert_array_equal(speeds, trajectory[f"rotor_speed_{i}"])
    np.testing.assert_array_equal([x.u_total for _, x in found["/x"]], trajectory["x_u_total"])
    path = found["/path"][0][1].poses
    assert len(path) == trajectory.sizes["t"]
    assert path[-1].position.z == trajectory["z_y"].values[-1]


def test_the_log_tells_the_violation(flight):
    trajectory, folder = flight
    lines = messages(folder / "flight.mcap")["/log"]
    violated = [t for t, line in lines if line.message == "requirement position_error_max is violated"]
    assert violated == pytest.approx([trajectory.attrs["violated_at_position_error_max"]])


def test_rates_speeds_and_attitude_agree(flight):
    """q' = q (0, Omega)/2 by central differences; w' = (w_c - w)/lag behind the commanded thrust k_T w_c^2."""
    trajectory, _ = flight
    t = trajectory["t"].values
    w, x, y, z = (trajectory[f"attitude_{part}"].values for part in "wxyz")
    np.testing.assert_allclose(w * w + x * x + y * y + z * z, 1.0, atol=1e-12)
    dw, dx, dy, dz = (np.gradient(part, t) for part in (w, x, y, z))
    expected = 2.0 * np.stack([w * dx - x * dw - y * dz + z * dy, w * dy - y * dw - z * dx + x * dz])
    for name, rate in zip("xy", expected, strict=True):
        found = trajectory[f"rate_{name}"].values
        assert np.abs(found).max() > 0.01
        np.testing.assert_allclose(found[2:-2], rate[2:-2], atol=0.02 * np.abs(found).max())
    theta = np.arcsin(2.0 * (w * y - x * z))
    np.testing.assert_allclose(theta, trajectory["theta"], atol=1e-6)
    vehicle = dj.Study.load(flight[1] / "fly.toml").template.plant.vehicle
    commanded = np.sqrt(trajectory["rotor_1"].values / vehicle.thrust_coefficient)
    speed = trajectory["rotor_speed_1"].values
    slope = (commanded - speed) / 0.05
    middle = 0.5 * (slope[1:] + slope[:-1])
    np.testing.assert_allclose(np.diff(speed) / 0.01, middle, atol=0.05 * np.abs(middle).max())


def test_parquet_has_units(flight):
    parquet = pytest.importorskip("pyarrow.parquet")
    trajectory, folder = flight
    table = parquet.read_table(folder / "flight.parquet")
    assert table.column_names == ["t", *trajectory.data_vars]
    np.testing.assert_array_equal(table["attitude_w"].to_numpy(), trajectory["attitude_w"])
    units = {"rate_x": b"rad/s", "phi": b"rad", "psi": b"rad", "psi_y": b"rad", "x_y_dot": b"m/s"}
    assert {name: table.schema.field(name).metadata[b"units"] for name in units} == units
    assert table.schema.field("psi").metadata[b"long_name"] == b"yaw"
    assert table.schema.metadata[b"study"] == trajectory.attrs["study"].encode()
    assert float(table.schema.metadata[b"draw"]) == trajectory.attrs["draw"]
    assert b"east, north, up" in table.schema.metadata[b"axes"]


def test_a_loop_of_one_axis_has_signals_only(tmp_path):
    study = dj.Study.load("motor").override({"draws": 1})
    trajectory = dj.simulate(study, every=20)
    dj.write_mcap(trajectory, tmp_path / "motor.mcap")
    found = messages(tmp_path / "motor.mcap")
    assert set(found) == {"/signals", "/log"}
    np.testing.assert_array_equal([content.y for _, content in found["/signals"]], trajectory["y"])
