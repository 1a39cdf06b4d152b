"""Logs of PX4: axes against SciPy's rotations, segments, stamps, and the memory of a large file."""

import json
import struct
import subprocess
import sys
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import dssc_jax as dj
from dssc_jax.cli.main import guarded
from dssc_jax.flight_logs.reading.contents import log_contents
from dssc_jax.flight_logs.reading.frames import field_values
from dssc_jax.flight_logs.reading.parameters import logged_parameters
from dssc_jax.flight_logs.reading.reader import nearest_values
from dssc_jax.flight_logs.reading.ulog import (
    LogWarning,
    Segment,
    list_topics,
    named_segment,
    read_topics,
    segments_of,
    stamps,
)
from tests.cli.conftest import last_json

pyulog = pytest.importorskip("pyulog")

LOGS = Path(__file__).parents[3] / "docs" / "logs"
TAKEOFF = LOGS / "sitl_takeoff.ulg"
VEHICLE = ("x", "y", "z", "psi")


def message(kind, body):
    return struct.pack("<Hc", len(body), kind) + body


def log_head(formats, topics, begin=0):
    """The beginning of a ULog: formats, and the topics of numbers 0, 1 and so on."""
    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", begin), message(b"B", bytes(40))]
    parts += [message(b"F", text.encode()) for text in formats]
    for number, (name, instance) in enumerate(topics):
        parts.append(message(b"A", struct.pack("<BH", instance, number) + name.encode()))
    return b"".join(parts)


def test_attitudes_in_the_models_axes():
    """Of random attitudes, against SciPy: R_ENU_FLU = T R_NED_FRD diag(1, -1, -1), and R_z R_y R_x."""
    rotations = Rotation.random(200, np.random.default_rng(1))
    x, y, z, w = rotations.as_quat().T
    own = {f"q[{i}]": values for i, values in enumerate((w, x, y, z))}
    axes = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    ours = Rotation.from_matrix(axes @ rotations.as_matrix() @ np.diag([1.0, -1.0, -1.0]))
    psi, theta, phi = ours.as_euler("ZYX").T
    for name, expected in (("phi", phi), ("theta", theta), ("psi", psi)):
        np.testing.assert_allclose(field_values("vehicle_attitude", own, name), expected, atol=1e-7)
    assert field_values("vehicle_attitude", own, "p") is None


def test_flying_north_and_nose_up():
    """A vehicle at rest heads north: psi = 90 degrees in ENU. PX4's nose up is a negative pitch here."""
    half = np.deg2rad(10.0) / 2
    own = {"q[0]": np.array([np.cos(half)]), "q[1]": np.zeros(1), "q[2]": np.array([np.sin(half)]), "q[3]": np.zeros(1)}
    assert field_values("vehicle_attitude", own, "psi")[0] == pytest.approx(np.pi / 2)
    assert field_values("vehicle_attitude", own, "theta")[0] == pytest.approx(-np.deg2rad(10.0))
    rates = {"xyz[0]": np.array([1.0]), "xyz[1]": np.array([2.0]), "xyz[2]": np.array([3.0])}
    turned = [field_values("vehicle_angular_velocity", rates, name)[0] for name in "pqr"]
    assert turned == [1.0, -2.0, -3.0]
    assert field_values("vehicle_local_position", {"heading": np.array([3.0])}, "psi")[0] == pytest.approx(
        np.pi / 2 - 3
    )


def test_the_rate_of_yaw():
    """Of a vehicle that turns at -0.7 rad/s by PX4's axes, through the angle pi."""
    time = np.linspace(0.0, 8.0, 400)
    half = 0.5 * (-0.7 * time)
    zero = np.zeros(400)
    own = {"q[0]": np.cos(half), "q[1]": zero, "q[2]": zero, "q[3]": np.sin(half), "timestamp": 1e6 * time}
    np.testing.assert_allclose(field_values("vehicle_attitude", own, "psi_dot"), 0.7, rtol=1e-9)
    single = {name: values[:1] for name, values in own.items()}
    assert np.isnan(field_values("vehicle_attitude", single, "psi_dot")).all()


def test_the_list_of_topics_is_that_of_pyulog():
    for path in (TAKEOFF, LOGS / "board_by_hand.ulg"):
        listed = list_topics(path)
        log = pyulog.ULog(str(path))
        expected = {}
        for topic in log.data_list:
            name = topic.name if topic.multi_id == 0 else f"{topic.name}:{topic.multi_id}"
            expected[name] = len(topic.data["timestamp"])
        assert {topic.name: topic.messages for topic in listed.topics} == expected
        assert listed.duration == pytest.approx(1e-6 * (log.last_timestamp - log.start_timestamp))
        assert listed.damaged is None
        assert {*log.initial_parameters} <= {*logged_parameters(path)}


def test_a_simulated_take_off():
    """Armed, in the air up to 2.16 m, and down again; by pyulog's arrays."""
    contents = log_contents(TAKEOFF, ["vehicle_local_position"])
    assert [segment.name for segment in contents.segments] == ["armed", "airborne"]
    armed, airborne = contents.segments
    assert armed.begin < airborne.begin < airborne.end < armed.end
    up = next(field for field in contents.fields if field.name == "vehicle_local_position.up")
    assert up.derived
    own = pyulog.ULog(str(TAKEOFF)).get_dataset("vehicle_local_position").data
    assert up.highest == pytest.approx(-own["z"].min())
    log = dj.read_log(TAKEOFF, VEHICLE, {"segment": "airborne"})
    assert airborne.begin <= log.start < airborne.begin + 0.1
    assert log.end <= airborne.end
    assert {"x_y", "x_u_total", "y_y_dot", "z_y_ref", "psi_y"} <= set(log.columns)
    assert log.columns["z_y"].value.max() == pytest.approx(up.highest)
    assert log.columns["psi_y"].value.std() < 0.01


def test_px4s_position_controller_in_the_models_axes():
    """Its velocity setpoint is MPC_XY_P times the error of position plus the trajectory's velocity, axis by axis."""
    gain = logged_parameters(TAKEOFF)["MPC_XY_P"]
    log = dj.read_log(TAKEOFF, VEHICLE, {"segment": "airborne", "start": 19.0})
    for axis in "xy":
        names = ("y", "y_ref", "y_ref_dot", "u_total")
        values = [nearest_values(log.columns[f"{axis}_{name}"], log.start, 0.1, 60) for name in names]
        y, y_ref, y_ref_dot, logged = values
        command = gain * (y_ref - y) + y_ref_dot
        told = np.isfinite(command)  # the trajectory is logged at every second sample
        assert told.sum() >= 29
        np.testing.assert_allclose(command[told], logged[told], atol=1e-6)


def test_a_board_that_was_never_armed(capsys):
    """Its log says so, and has no segment to read."""
    path = str(LOGS / "board_by_hand.ulg")
    assert guarded(["log", path]) == 0
    printed = capsys.readouterr().out
    assert "AUAV_X21" in printed
    assert "never armed" in printed
    with pytest.raises(dj.ConfigError, match="no segment 'armed'"):
        dj.read_log(path, table={"segment": "armed", "signals": {"y": "vehicle_attitude.phi"}})


def test_the_command_lists_several_files(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("t,y,name\n1.0,2.0,a\n3.5,4.0,b\n")
    assert guarded(["log", str(tmp_path / "a.csv"), str(TAKEOFF), "--json"]) == 0
    table, flight = last_json(capsys)["logs"]
    assert table["duration"] == 2.5
    assert [field["name"] for field in table["fields"]] == ["t", "y"]
    assert flight["segments"][1]["name"] == "airborne"
    assert guarded(["log", str(TAKEOFF), "--topic", "vehicle_atitude"]) == 2
    assert "did you mean 'vehicle_attitude'" in capsys.readouterr().err
    (tmp_path / "b.ulg").write_text("no log")
    assert guarded(["log", str(tmp_path / "b.ulg")]) == 2
    assert "is no ULog" in capsys.readouterr().err
    assert guarded(["log", str(tmp_path / "a.csv"), "--topic", "a"]) == 2


def test_the_time_of_measurement_goes_first():
    """Unless it falls or is absent; a message without a stamp has no time."""
    published = np.array([0, 2_000_000, 3_000_000], np.uint64)
    measured = np.array([1_000_000, 1_500_000, 2_500_000], np.uint64)
    np.testing.assert_allclose(stamps({"timestamp": published, "timestamp_sample": measured}, 5e5), [np.nan, 1.0, 2.0])
    falling = {"timestamp": published, "timestamp_sample": measured[::-1]}
    np.testing.assert_allclose(stamps(falling, 0.0), [np.nan, 2.0, 3.0])
    np.testing.assert_allclose(stamps({"timestamp": published}, 0.0), [np.nan, 2.0, 3.0])


def test_segments():
    """Two flights; a vehicle that is carried is not armed, hence not airborne."""
    time = np.arange(10, dtype=np.uint64) * 1_000_000
    armed = np.array([0, 1, 1, 1, 0, 0, 1, 1, 1, 1])
    landed = np.array([0, 1, 0, 0, 0, 0, 0, 0, 1, 1])
    topics = {
        "actuator_armed:0": {"timestamp": time, "armed": armed},
        "vehicle_land_detected:0": {"timestamp": time, "landed": landed},
    }
    found = segments_of(topics, 0.0)
    assert found[:2] == [Segment("armed", 1.0, 4.0), Segment("armed", 6.0, 9.0)]
    assert found[2:] == [Segment("airborne", 2.0, 4.0), Segment("airborne", 6.0, 8.0)]
    assert named_segment("armed:2", found) == found[1]
    assert named_segment("airborne", found) in found[2:]
    status = {"vehicle_status:0": {"timestamp": time, "arming_state": 2 * armed}}
    assert segments_of(status, 0.0) == found[:2]
    for text in ("flying", "armed:x", "armed:3", "armed:0"):
        with pytest.raises(dj.ConfigError, match="segment"):
            named_segment(text, found)
    with pytest.raises(dj.ConfigError, match="ULog"):
        dj.read_log("a.csv", table={"segment": "armed"})


def changes(name, pairs):
    """A topic that is sent at a change only, with its times [s] and states."""
    times, states = zip(*pairs, strict=True)
    return {"timestamp": np.array([round(1e6 * (time + 10.0)) for time in times]), name: np.array(states)}


@pytest.mark.parametrize(
    ("armed", "landed", "expected"),
    [
        ([(0.0, 1)], [(0.0, 0)], [Segment("armed", 0.0, 20.0), Segment("airborne", 0.0, 20.0)]),
        (
            [(-1.0, 0), (2.0, 1), (18.0, 0)],
            [(-1.0, 1), (5.0, 0)],
            [Segment("armed", 2.0, 18.0), Segment("airborne", 5.0, 18.0)],
        ),
        ([(2.0, 1), (18.0, 0)], [(-1.0, 1)], [Segment("armed", 2.0, 18.0)]),
        (
            [(2.0, 1)],
            [(6.0, 0), (7.0, 1), (9.0, 0)],
            [Segment("armed", 2.0, 20.0), Segment("airborne", 6.0, 7.0), Segment("airborne", 9.0, 20.0)],
        ),
        ([(20.0, 1)], [(0.0, 0)], []),
    ],
)
def test_a_state_holds_after_its_last_message(armed, landed, expected):
    """PX4 sends these topics at a change only; the log ends with the last stamp of any topic."""
    topics = {
        "actuator_armed:0": changes("armed", armed),
        "vehicle_land_detected:0": changes("landed", landed),
        "vehicle_attitude:0": changes("value", [(0.0, 0), (20.0, 0)]),
    }
    assert segments_of(topics, 1e7) == expected
    del topics["vehicle_attitude:0"]
    assert segments_of(topics, 1e7, 20.0) == expected


PEAK = """
import resource, sys
from pathlib import Path
from dssc_jax.flight_logs.reading.contents import log_contents
from dssc_jax.flight_logs.reading.reader import read_log
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
path = Path(sys.argv[1])
read_log(sys.argv[2], ("x",), {"signals": {"x_y": "vehicle_local_position.east"}})
before = peak()
contents = log_contents(path)
listed = peak()
log = read_log(path, table={"signals": {"y": "rate.value"}})
print(before, listed, peak(), len(log.columns["y"].time), contents.topics[0].messages)
"""


def test_memory_does_not_grow_with_topics_that_are_not_read(tmp_path):
    """60 MB of one topic beside 10,000 numbers of another: the peak rises by less than a tenth of the file."""
    count = 10_000
    formats = ["rate:uint64_t timestamp;float value;", "bulk:uint64_t timestamp;float[1500] values;"]
    rate = np.zeros(count, [("size", "<u2"), ("kind", "S1"), ("id", "<u2"), ("stamp", "<u8"), ("value", "<f4")])
    rate["size"], rate["kind"], rate["stamp"], rate["value"] = (
        14,
        b"D",
        np.arange(1, count + 1) * 1000,
        np.arange(count),
    )
    bulk = struct.pack("<HcHQ", 2 + 8 + 6000, b"D", 1, 1) + bytes(6000)
    path = tmp_path / "large.ulg"
    with path.open("wb") as file:
        file.write(log_head(formats, [("rate", 0), ("bulk", 0)]))
        for row in rate:
            file.write(row.tobytes() + bulk)
    size = path.stat().st_size / 2**20
    assert size > 55.0
    done = subprocess.run(
        [sys.executable, "-c", PEAK, str(path), str(TAKEOFF)], capture_output=True, text=True, check=True
    )
    before, listed, read, values, messages = map(float, done.stdout.split())
    assert (values, messages) == (count, count)
    assert listed - before < 0.1 * size
    assert read - before < 0.1 * size
    topics, begin, damaged = read_topics(path, ["rate"])
    assert not damaged
    assert set(topics) == {"rate:0"}
    assert begin == 0.0


def test_a_cut_and_a_damaged_log(tmp_path):
    """What was written before the end counts; the place of damage is told."""
    content = TAKEOFF.read_bytes()
    whole = list_topics(TAKEOFF)
    (tmp_path / "cut.ulg").write_bytes(content[: len(content) * 2 // 3])
    cut = list_topics(tmp_path / "cut.ulg")
    assert cut.damaged is None
    assert cut.cut
    assert not whole.cut
    assert 0 < sum(topic.messages for topic in cut.topics) < sum(topic.messages for topic in whole.topics)
    damaged = content + struct.pack("<Hc", 4, b"?") + bytes(4)
    (tmp_path / "damaged.ulg").write_bytes(damaged)
    assert list_topics(tmp_path / "damaged.ulg").damaged == len(content)
    assert json.dumps(log_contents(tmp_path / "damaged.ulg").summary()["damaged"]) == str(len(content))


def test_a_parameter_that_is_no_number_is_left_out(tmp_path):
    """As a damaged log may hold one; a changed parameter has its last value."""
    head = log_head([], [])
    parts = []
    for name, value in (("int32_t A", 3), ("float B", 0.05), ("float B", 0.1)):
        key = name.encode()
        parts.append(message(b"P", bytes([len(key)]) + key + struct.pack("<i" if "int" in name else "<f", value)))
    text = b"char[2] C"
    parts.append(message(b"P", bytes([len(text)]) + text + b"xy"))
    path = tmp_path / "parameters.ulg"
    path.write_bytes(head + b"".join(parts))
    assert logged_parameters(path) == {"A": 3.0, "B": 0.1}


@pytest.mark.parametrize("kind", [b"A", b"O"])
def test_a_message_that_is_too_short_is_damage(kind, tmp_path):
    content = TAKEOFF.read_bytes()
    (tmp_path / "short.ulg").write_bytes(content + message(kind, b"\0"))
    assert list_topics(tmp_path / "short.ulg").damaged == len(content)


def test_a_log_with_a_hole_warns_and_goes_on_after_it(tmp_path):
    content = TAKEOFF.read_bytes()
    place = int(0.74 * len(content))
    (tmp_path / "hole.ulg").write_bytes(content[:place] + content[place + 9000 :])
    listed = list_topics(tmp_path / "hole.ulg")
    assert listed.damaged is not None
    assert place - 300 < listed.damaged < place + 1000
    assert (listed.damages, listed.duration) == (1, list_topics(TAKEOFF).duration)
    assert 0 < listed.lost < 300
    with pytest.warns(LogWarning, match=r"hole\.ulg is damaged: messages are lost"):
        read_topics(tmp_path / "hole.ulg", ["vehicle_attitude"])


def attitudes(path):
    """Number of messages of the attitude that the package and pyulog read."""
    topics, _, damaged = read_topics(path, ["vehicle_attitude"])
    assert damaged
    return len(topics["vehicle_attitude:0"]["timestamp"]), len(pyulog_attitudes(path))


def pyulog_attitudes(path):
    with redirect_stdout(StringIO()):
        log = pyulog.ULog(str(path), ["vehicle_attitude"])
    return next((topic.data["timestamp"] for topic in log.data_list if topic.name == "vehicle_attitude"), [])


@pytest.mark.filterwarnings("ignore::dssc_jax.flight_logs.reading.ulog.LogWarning")
@pytest.mark.parametrize("seed", range(6))
def test_after_flipped_bytes_nearly_all_messages_are_read(seed, tmp_path):
    """100 bytes, among them sizes and kinds: at most the messages that they are in, and one before each, are lost."""
    random = np.random.default_rng(seed)
    content = bytearray(TAKEOFF.read_bytes())
    for place in random.integers(len(content) // 4, len(content), 100):  # behind all definitions
        content[place] ^= int(random.integers(1, 256))
    path = tmp_path / "flipped.ulg"
    path.write_bytes(content)
    whole = list_topics(TAKEOFF)
    listed = list_topics(path)
    messages = sum(topic.messages for topic in whole.topics)
    assert messages - 200 <= sum(topic.messages for topic in listed.topics) < messages
    assert listed.damages > 5
    assert listed.lost < 30_000
    read, by_pyulog = attitudes(path)
    assert read >= by_pyulog
    assert read == next(topic.messages for topic in listed.topics if topic.name == "vehicle_attitude")
    assert read >= 0.95 * len(pyulog_attitudes(TAKEOFF))


@pytest.mark.filterwarnings("ignore::dssc_jax.flight_logs.reading.ulog.LogWarning")
def test_a_topic_whose_announcement_is_lost_takes_no_other_with_it(tmp_path):
    formats = ["rate:uint64_t timestamp;float value;", "lost:uint64_t timestamp;float value;uint8_t[4] _padding0;"]
    head = log_head(formats, [("rate", 0), ("lost", 0)])
    messages = [message(b"D", struct.pack("<HQf", k % 2, k + 1, 0.0)) for k in range(400)]
    sync = message(b"S", bytes.fromhex("2f731320250cbb12"))
    path = tmp_path / "sound.ulg"
    path.write_bytes(head + b"".join(messages) + sync)
    assert list_topics(path).damaged is None  # messages may lack the padding at their end
    path.write_bytes(head[:-5] + b"\xff" + head[-4:] + b"".join(messages) + sync)
    listed = list_topics(path)
    assert [topic.name for topic in listed.topics] == ["rate"]
    assert listed.topics[0].messages == 200
    assert len(read_topics(path, ["rate"]).topics["rate:0"]["value"]) == 200


def test_nothing_sound_in_the_rest_of_a_log_is_no_message(tmp_path):
    """Random bytes and zeros longer than what is searched at a time."""
    noise = np.random.default_rng(0).bytes(200_000) + bytes(100_000)
    path = tmp_path / "noise.ulg"
    path.write_bytes(TAKEOFF.read_bytes() + noise)
    listed = list_topics(path)
    assert listed.topics == list_topics(TAKEOFF).topics
    assert (listed.damaged, listed.damages, listed.lost) == (TAKEOFF.stat().st_size, 1, len(noise))
