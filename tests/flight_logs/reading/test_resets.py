"""Resets of PX4's estimator: a flight with jumps reads as the flight without them; what cannot be read is refused."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.core.errors import ConfigError
from dssc_jax.flight_logs.fit.fit import fit_log
from dssc_jax.flight_logs.reading.contents import log_contents, topic_table
from dssc_jax.flight_logs.reading.ulog import LogWarning
from dssc_jax.flight_logs.replay import replay_log
from tests.cli.conftest import last_json
from tests.flight_logs.fit.test_fit import DT, linear, output
from tests.flight_logs.reading.test_ulog import TAKEOFF, log_head, message

pyulog = pytest.importorskip("pyulog")

TIME = DT * np.arange(400)
FIELDS = ("x", "y", "z", "vx", "vy", "vz", "heading")
FLAGS = ("xy_valid", "z_valid", "v_xy_valid", "v_z_valid")
JUMPS = {
    "xy_reset_counter": ("delta_xy[0]", "delta_xy[1]"),
    "z_reset_counter": ("delta_z",),
    "vxy_reset_counter": ("delta_vxy[0]", "delta_vxy[1]"),
    "heading_reset_counter": ("delta_heading",),
}
COUNTS = (*JUMPS, *FLAGS)
AXES = {"delta_xy[0]": "x", "delta_xy[1]": "y", "delta_z": "z", "delta_vxy[0]": "vx", "delta_vxy[1]": "vy"} | {
    "delta_heading": "heading"
}
SETPOINT = ("x", "y", "z", "yaw")
TABLE = {"signals": {"x_y": "vehicle_local_position.north", "z_y": "vehicle_local_position.up"}}
CHANNELS = ("x", "z")


def smooth():
    """A flight: positions, velocities and the heading, shape (400,) each."""
    return {name: np.sin((0.5 + 0.1 * i) * TIME) for i, name in enumerate(FIELDS)}


def setpoints():
    return {name: np.cos(TIME) * (i + 1) for i, name in enumerate(SETPOINT)}


def ulog(path, jumps=(), stated=True, flags=None, follow=0, estimate=None):
    """A log of a flight whose estimate jumps.

    Args:
        path: The file.
        jumps: Row, counter and sizes of each jump.
        stated: Whether the log has the sizes.
        flags: Values of flags by name; all 1 else.
        follow: Messages by which the setpoint follows the estimate; None: it never does.
        estimate: The flight without jumps.
    """
    estimate = dict(smooth() if estimate is None else estimate)
    wanted = setpoints()
    counts = {name: np.zeros(400, int) for name in JUMPS} | {name: np.ones(400, int) for name in FLAGS}
    counts |= flags or {}
    deltas = {name: np.zeros(400) for names in JUMPS.values() for name in names}
    for row, counter, sizes in jumps:
        counts[counter][row:] += 1
        for name, size in zip(JUMPS[counter], sizes, strict=True):
            deltas[name][row:] = size
            axis = AXES[name]
            estimate[axis] = estimate[axis] + size * (np.arange(400) >= row)
            axis = "yaw" if axis == "heading" else axis
            if follow is not None and axis in wanted:
                wanted[axis] = wanted[axis] + size * (np.arange(400) >= row + follow)
    names = [*FIELDS, *deltas] if stated else list(FIELDS)
    rows = {**estimate, **deltas}
    arrays = {"delta_xy[0]": "float[2] delta_xy", "delta_vxy[0]": "float[2] delta_vxy"}
    texts = [arrays.get(name, f"float {name}") for name in names if name not in ("delta_xy[1]", "delta_vxy[1]")]
    texts += [f"uint8_t {name}" for name in COUNTS]
    formats = [
        f"vehicle_local_position:uint64_t timestamp;{';'.join(texts)};",
        f"vehicle_local_position_setpoint:uint64_t timestamp;{';'.join(f'float {name}' for name in SETPOINT)};",
    ]
    parts = [log_head(formats, [("vehicle_local_position", 0), ("vehicle_local_position_setpoint", 0)], 1_000_000)]
    for row, time in enumerate(TIME):
        stamp = round(1e6 * (time + 1.0))
        numbers = [rows[name][row] for name in names]
        body = struct.pack("<HQ", 0, stamp) + struct.pack(f"<{len(names)}f", *numbers)
        parts.append(message(b"D", body + bytes(int(counts[name][row]) for name in COUNTS)))
        parts.append(message(b"D", struct.pack("<HQ4f", 1, stamp + 500, *(wanted[name][row] for name in SETPOINT))))
    path.write_bytes(b"".join(parts))
    return path


THREE = (
    (100, "xy_reset_counter", (3.0, -2.0)),
    (150, "z_reset_counter", (0.5,)),
    (250, "xy_reset_counter", (-1.0, 0.25)),
    (300, "heading_reset_counter", (0.4,)),
)
REFERENCES = {"x_y_ref": "vehicle_local_position_setpoint.north", "z_y_ref": "vehicle_local_position_setpoint.up"}


@pytest.mark.parametrize("follow", [0, 3])
def test_stated_jumps_are_taken_out(tmp_path, follow):
    """Estimate and setpoints are those of the flight without jumps, also where setpoints follow some messages later."""
    table = {"signals": TABLE["signals"] | REFERENCES}
    log = dj.read_log(ulog(tmp_path / "a.ulg", THREE, follow=follow), CHANNELS, table)
    estimate, wanted = smooth(), setpoints()
    for name, expected in (
        ("x_y", estimate["x"]),
        ("z_y", -estimate["z"]),
        ("x_y_ref", wanted["x"]),
        ("z_y_ref", -wanted["z"]),
    ):
        np.testing.assert_allclose(log.columns[name].value, expected, atol=1e-6)
    assert [(reset.time, reset.is_stated) for reset in log.resets] == [(2.0, True), (3.0, True), (5.0, True)]
    heading = dj.read_log(ulog(tmp_path / "b.ulg", THREE), table={"signals": {"y": "vehicle_local_position.psi"}})
    np.testing.assert_allclose(np.cos(heading.columns["y"].value), np.sin(estimate["heading"]), atol=1e-6)


def test_a_setpoint_that_stays_moves_in_the_frame_of_the_flight(tmp_path):
    """A waypoint of a map stays in the new frame: in the old one it jumps the other way."""
    log = dj.read_log(
        ulog(tmp_path / "a.ulg", THREE[:1], follow=None),
        ("x",),
        {"signals": {"x_y": "vehicle_local_position.north", "x_y_ref": REFERENCES["x_y_ref"]}},
    )
    np.testing.assert_allclose(log.columns["x_y_ref"].value, setpoints()["x"] - 3.0 * (TIME >= 2.0 - 1e-9), atol=1e-6)


def test_only_jumps_after_the_start_count(tmp_path):
    """The frame is that at the start, whose position the study has."""
    path = ulog(tmp_path / "a.ulg", THREE)
    log = dj.read_log(path, CHANNELS, TABLE | {"start": 4.0})
    after = TIME >= 4.0
    np.testing.assert_allclose(log.columns["x_y"].value[after], smooth()["x"][after] + 3.0, atol=1e-6)
    assert [reset.time for reset in log.resets] == [5.0]
    with pytest.warns(LogWarning, match=r"x, y, heading: .*jumps at 5 s \(x by -1, y by 0.25 m\), at 6 s .* are taken"):
        table = topic_table(path, "vehicle_local_position", start=4.0)
    np.testing.assert_allclose(table["x"][1:], smooth()["x"][after] + 3.0, atol=1e-6)


def test_attitudes_turn_back():
    """The quaternion of PX4's own log continues over its resets, as SciPy's rotations do without them."""
    raw = {
        name: dj.read_log(TAKEOFF, table={"signals": {"y": f"vehicle_attitude.{name}"}}).columns["y"]
        for name in ("q[0]", "q[1]", "q[2]", "q[3]", "quat_reset_counter")
    }
    assert np.ptp(raw["quat_reset_counter"].value) == 2
    own = next(topic for topic in pyulog.ULog(str(TAKEOFF)).data_list if topic.name == "vehicle_attitude").data

    def rotation(names, rows):
        w, x, y, z = (own[f"{names}[{i}]"][rows].astype(float) for i in range(4))
        return Rotation.from_quat(np.array([x, y, z, w]).T)

    rows = np.flatnonzero(np.diff(own["quat_reset_counter"].astype(int))) + 1
    expected = rotation("q", slice(None))
    for row in rows[::-1]:
        turned = rotation("delta_q_reset", [row])[0].inv() * expected[row:]
        expected = Rotation.concatenate([expected[:row], turned])
    read = np.array([raw[f"q[{i}]"].value for i in (1, 2, 3, 0)])
    angles = (Rotation.from_quat(read.T).inv() * expected).magnitude()
    assert angles.max() < 1e-6
    yaw = np.unwrap(dj.read_log(TAKEOFF, table={"signals": {"y": "vehicle_attitude.psi"}}).columns["y"].value)
    logged = np.unwrap(expected.as_euler("ZYX")[:, 0])
    assert (
        np.abs(np.diff(yaw))[rows - 1].max()
        < 1e-3
        < 0.02
        < np.abs(np.diff(rotation("q", slice(None)).as_euler("ZYX")[:, 0]))[rows - 1].max()
    )
    np.testing.assert_allclose(np.diff(yaw), -np.diff(logged), atol=1e-6)


def test_a_jump_that_the_log_does_not_state_refuses_a_fit(tmp_path):
    random = np.random.default_rng(8)
    u = np.repeat(random.normal(size=40), 10)
    flight = smooth() | {"x": output(1.1, 0.8, u) + 0.01 * random.normal(size=400), "vx": u}
    table = {"signals": {"y": "vehicle_local_position.x", "u_total": "vehicle_local_position.vx"}}
    jump = ((200, "xy_reset_counter", (0.4, 0.0)),)
    plain = fit_log(linear(), dj.read_log(ulog(tmp_path / "a.ulg", estimate=flight), table=table))
    stated = dj.read_log(ulog(tmp_path / "b.ulg", jump, estimate=flight), table=table)
    np.testing.assert_allclose(fit_log(linear(), stated).estimates, plain.estimates, rtol=1e-4)
    hints = replay_log(linear(), stated, commands=False).hints.estimator
    told = "tells a reset of the estimator at 4 s (x by 0.4, y by 0 m): the jump is taken out"
    assert hints["vehicle_local_position.xy_reset_counter"].text.startswith(told)
    silent = dj.read_log(ulog(tmp_path / "c.ulg", jump, stated=False, estimate=flight), table=table)
    told = (
        r"at 4 s \(x by about 0\.\d+, y .*part before with loop.duration = 4 or a part after with a start of 4 s; `all"
    )
    with pytest.raises(ConfigError, match=told):
        fit_log(linear(), silent)
    assert (
        "does not state"
        in replay_log(linear(), silent, commands=False).hints.estimator["vehicle_local_position.xy_reset_counter"].text
    )
    short = linear(loop={"duration": 3.0, "sample_time": DT})
    assert replay_log(short, silent, commands=False).hints.estimator == {}
    fast = ((200, "vxy_reset_counter", (0.5, 0.0)),)
    with pytest.raises(
        ConfigError, match=r"vxy_reset_counter: the estimator was reset at 4 s \(vx by 0.5, vy by 0 m/s"
    ):
        fit_log(linear(), dj.read_log(ulog(tmp_path / "d.ulg", fast, estimate=flight), table=table))


def test_lost_messages_hide_the_size_of_a_jump(tmp_path):
    """Two resets between two messages: the last one's size is not that of both."""
    both = ((100, "xy_reset_counter", (1.0, 0.0)), (100, "xy_reset_counter", (2.0, 0.0)))
    (reset,) = dj.read_log(ulog(tmp_path / "a.ulg", both), CHANNELS, TABLE).resets
    assert not reset.is_stated
    assert reset.jump[0] == pytest.approx(3.0, abs=0.02)


def test_invalid_values_are_left_out_and_told(tmp_path, capsys):
    valid = np.ones(400, int)
    valid[:50] = valid[120:140] = 0
    path = ulog(tmp_path / "a.ulg", ((50, "xy_reset_counter", (7.0, 7.0)),), flags={"xy_valid": valid})
    log = dj.read_log(path, CHANNELS, TABLE)
    np.testing.assert_allclose(log.columns["x_y"].time, TIME[valid == 1], atol=1e-9)
    np.testing.assert_allclose(log.columns["x_y"].value, smooth()["x"][valid == 1] + 7.0, atol=1e-6)
    assert len(log.columns["z_y"].time) == 400
    assert log.resets == ()  # the first valid estimate
    assert [(span.flag, span.begin, span.end) for span in log.invalid] == [
        ("xy_valid", 0.0, 1.0),
        ("xy_valid", 2.4, 2.8),
    ]
    assert guarded(["log", str(path)]) == 0
    assert "invalid: x, y, as vehicle_local_position.xy_valid is 0 from 2.4 s to 2.8 s\n" in capsys.readouterr().out
    never = ulog(tmp_path / "never.ulg", flags={"xy_valid": np.zeros(400, int)})
    with pytest.raises(
        ConfigError, match=r"x_y: has no finite value in the log; vehicle_local_position.xy_valid is 0 from 0"
    ):
        dj.read_log(never, CHANNELS, TABLE)


def test_a_log_lists_its_resets(tmp_path, capsys):
    path = ulog(tmp_path / "a.ulg", THREE)
    assert guarded(["log", str(path)]) == 0
    told = "reset of the estimator at 2 s (x by 3, y by -2 m), at 5 s (x by -1, y by 0.25 m): vehicle_local_position.xy"
    assert told in capsys.readouterr().out
    assert guarded(["log", str(path), "--json"]) == 0
    resets = last_json(capsys)["logs"][0]["resets"]
    assert [reset["size"] for reset in resets] == pytest.approx([13.0**0.5, 0.5, 1.0625**0.5, 0.4])
    assert log_contents(ulog(tmp_path / "b.ulg")).resets == ()
