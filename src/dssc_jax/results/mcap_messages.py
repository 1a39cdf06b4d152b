"""The messages of a trajectory in an MCAP file; this module needs the extra ``mcap``.

Messages are Protocol Buffers. Poses, vectors and the log have the schemas of Foxglove. Each topic of signals has a
schema with a field for each signal. Time 0 of the trajectory is time 0 of the file. The frame ``world`` is the
inertial frame of the model, with z up. The frame ``vehicle`` has the axes forward, left and up of the body.

Sources: MCAP format specification; Foxglove schemas (PoseInFrame, PosesInFrame, FrameTransform, Vector3, Log).
"""

import math
from collections.abc import Iterator, Mapping
from typing import IO, Any, NamedTuple

import numpy as np
import xarray as xr
from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PoseInFrame_pb2 import PoseInFrame
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.Vector3_pb2 import Vector3
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory, timestamp_pb2
from google.protobuf.message import Message
from mcap_protobuf.writer import Writer

from dssc_jax.closed_loop.metrics.requirements import VIOLATED_AT

WORLD = "world"
VEHICLE = "vehicle"
NANOSECONDS = 1_000_000_000
POSITION = ("x_y", "y_y", "z_y")
DESIRED_POSITION = ("x_y_ref", "y_y_ref", "z_y_ref")
ATTITUDE = ("attitude_w", "attitude_x", "attitude_y", "attitude_z")
VECTORS = {
    "/body_rates": ("rate_x", "rate_y", "rate_z"),
    "/wind": ("wind_x", "wind_y", "wind_z"),
    "/velocity": ("x_y_dot", "y_y_dot", "z_y_dot"),
}
"""Topics of vectors, and the signals of their components x, y and z."""
SIGNALS = "signals"  # topic of the signals that belong to no channel and no rotor
MOST_PATH_POSES = 2000


class TimedMessage(NamedTuple):
    """A message with its topic and its time.

    Args:
        topic: Topic, such as ``/pose``.
        time: Time of the trajectory [ns].
        content: The message.
    """

    topic: str
    time: int
    content: Message


def write_messages(trajectory: xr.Dataset, file: IO[bytes]) -> None:
    """Write all messages of a trajectory in the order of their times.

    Args:
        trajectory: The trajectory.
        file: A file that is open for writing.
    """
    writer = Writer(file)
    for message in sorted(messages_of(trajectory), key=lambda message: message.time):
        writer.write_message(message.topic, message.content, log_time=message.time, publish_time=message.time)
    writer.finish()


def messages_of(trajectory: xr.Dataset) -> Iterator[TimedMessage]:
    """Make all messages of a trajectory, topic by topic."""
    times = np.round(NANOSECONDS * trajectory["t"].values).astype(np.int64)
    columns = {str(name): trajectory[name].values.astype(float) for name in trajectory.data_vars}
    if set(POSITION) | set(ATTITUDE) <= set(columns):
        yield from pose_messages(columns, times)
    for topic, names in VECTORS.items():
        if set(names) <= set(columns):
            yield from vector_messages(topic, [columns[name] for name in names], times)
    for topic, signal_of_field in signal_topics(list(columns)).items():
        fields = {field: columns[name] for field, name in signal_of_field.items()}
        yield from signal_messages(topic, fields, times)
    yield from log_messages(trajectory)


def pose_messages(columns: Mapping[str, np.ndarray], times: np.ndarray) -> Iterator[TimedMessage]:
    """Make the messages on the flight of a vehicle: pose and transform at each sample, the path, and desired poses.

    Args:
        columns: Signals of the trajectory by name, each of shape (samples,).
        times: Times of the samples [ns], shape (samples,).
    """
    positions = np.stack([columns[name] for name in POSITION], axis=1)
    attitudes = np.stack([columns[name] for name in ATTITUDE], axis=1)
    finite_samples = np.flatnonzero(np.isfinite(positions).all(axis=1))
    for sample in finite_samples:
        time = int(times[sample])
        pose = PoseInFrame(frame_id=WORLD)
        pose.timestamp.FromNanoseconds(time)
        set_vector(pose.pose.position, positions[sample])
        set_quaternion(pose.pose.orientation, attitudes[sample])
        yield TimedMessage("/pose", time, pose)
        transform = FrameTransform(parent_frame_id=WORLD, child_frame_id=VEHICLE)
        transform.timestamp.FromNanoseconds(time)
        set_vector(transform.translation, positions[sample])
        set_quaternion(transform.rotation, attitudes[sample])
        yield TimedMessage("/tf", time, transform)
    path = PosesInFrame(frame_id=WORLD)
    stride = max(1, math.ceil(len(finite_samples) / MOST_PATH_POSES))
    for sample in finite_samples[::stride]:
        point = path.poses.add()
        set_vector(point.position, positions[sample])
        point.orientation.w = 1.0  # no rotation
    yield TimedMessage("/path", int(times[0]), path)
    if set(DESIRED_POSITION) <= set(columns):
        desired_positions = np.stack([columns[name] for name in DESIRED_POSITION], axis=1)
        yield from desired_pose_messages(desired_positions, times)


def desired_pose_messages(positions: np.ndarray, times: np.ndarray) -> Iterator[TimedMessage]:
    """Make a message with the desired pose, without rotation, at each sample with a finite desired position.

    Args:
        positions: Desired positions [m], shape (samples, 3).
        times: Times of the samples [ns], shape (samples,).
    """
    for sample in np.flatnonzero(np.isfinite(positions).all(axis=1)):
        time = int(times[sample])
        pose = PoseInFrame(frame_id=WORLD)
        pose.timestamp.FromNanoseconds(time)
        set_vector(pose.pose.position, positions[sample])
        pose.pose.orientation.w = 1.0  # no rotation
        yield TimedMessage("/desired_pose", time, pose)


def set_vector(vector: Any, values: np.ndarray) -> None:
    """Set the fields x, y and z of a vector in a message to values of shape (3,)."""
    vector.x, vector.y, vector.z = map(float, values)


def set_quaternion(quaternion: Any, values: np.ndarray) -> None:
    """Set the fields w, x, y and z of a quaternion in a message to values in this order, shape (4,)."""
    quaternion.w, quaternion.x, quaternion.y, quaternion.z = map(float, values)


def vector_messages(topic: str, components: list[np.ndarray], times: np.ndarray) -> Iterator[TimedMessage]:
    """Make the messages of a vector, at each sample at which all components are finite.

    Args:
        topic: Topic of the messages.
        components: The components x, y and z, each of shape (samples,).
        times: Times of the samples [ns], shape (samples,).
    """
    vectors = np.stack(components, axis=1)
    for sample in np.flatnonzero(np.isfinite(vectors).all(axis=1)):
        x, y, z = map(float, vectors[sample])
        yield TimedMessage(topic, int(times[sample]), Vector3(x=x, y=y, z=z))


def signal_topics(names: list[str]) -> dict[str, dict[str, str]]:
    """Sort the signals of a trajectory into topics: for each topic, the name of the signal by the name of its field.

    Signals of a channel are on ``/x``, ``/y`` and so on, signals of rotors on ``/rotors``, all others on ``/signals``.
    A prefix x is a channel if ``x_y_ref`` is among the names.

    Example:
        >>> signal_topics(["x_y", "x_y_ref", "rotor_1", "tilt"])
        {'/x': {'y': 'x_y', 'y_ref': 'x_y_ref'}, '/rotors': {'rotor_1': 'rotor_1'}, '/signals': {'tilt': 'tilt'}}
    """
    channels = {name.removesuffix("_y_ref") for name in names if name.endswith("_y_ref")}
    topics: dict[str, dict[str, str]] = {}
    for name in names:
        channel, _, field = name.partition("_")
        if channel in channels and field:
            topics.setdefault(f"/{channel}", {})[field] = name
        elif name.startswith("rotor_"):
            topics.setdefault("/rotors", {})[name] = name
        else:
            topics.setdefault(f"/{SIGNALS}", {})[name] = name
    return topics


def signal_messages(topic: str, columns: Mapping[str, np.ndarray], times: np.ndarray) -> Iterator[TimedMessage]:
    """Make the messages with the signals of a topic, at each sample; values are NaN once the draw has ended.

    Args:
        topic: Topic of the messages.
        columns: Values of each field, each of shape (samples,).
        times: Times of the samples [ns], shape (samples,).
    """
    message_type = signal_type(topic.strip("/"), list(columns))
    for sample, time in enumerate(times):
        values = {field: float(column[sample]) for field, column in columns.items()}
        message = message_type(**values)
        message.timestamp.FromNanoseconds(int(time))
        yield TimedMessage(topic, int(time), message)


def signal_type(name: str, fields: list[str]) -> type[Any]:
    """Define the type of a message with a time stamp and a number for each field, as Protocol Buffers.

    Args:
        name: Name of the type.
        fields: Names of the numbers.
    """
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    file = descriptor_pb2.FileDescriptorProto(name=f"dssc_jax/{name}.proto", package="dssc_jax", syntax="proto3")
    file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    message_type = file.message_type.add(name=name)
    field_kinds = descriptor_pb2.FieldDescriptorProto
    message_type.field.add(
        name="timestamp",
        number=1,
        type=field_kinds.TYPE_MESSAGE,
        type_name=".google.protobuf.Timestamp",
        label=field_kinds.LABEL_OPTIONAL,
    )
    for number, field in enumerate(fields, start=2):
        message_type.field.add(
            name=field, number=number, type=field_kinds.TYPE_DOUBLE, label=field_kinds.LABEL_OPTIONAL
        )
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"dssc_jax.{name}"))


def log_messages(trajectory: xr.Dataset) -> Iterator[TimedMessage]:
    """Make the log: study and draw, the times from which on violations were certain, and how the draw ended."""
    attributes = trajectory.attrs
    end = float(trajectory["t"].values[-1])
    title = f"{attributes.get('study', '')}, draw {attributes.get('draw', '')}"
    lines = [(0.0, Log.INFO, title)]  # (time [s], level, text)
    for name, value in attributes.items():
        if str(name).startswith(VIOLATED_AT) and np.isfinite(value):
            requirement = str(name).removeprefix(VIOLATED_AT)
            lines.append((float(value), Log.ERROR, f"requirement {requirement} is violated"))
    failed_at = float(attributes.get("failed_at", np.nan))
    if np.isfinite(failed_at):
        lines.append((failed_at, Log.FATAL, str(attributes.get("outcome_meaning", "ended early"))))
    elif "verdict" in attributes:
        lines.append((end, Log.INFO, str(attributes["verdict"])))
    for time, level, text in lines:
        message = Log(level=level, message=text, name="dssc_jax")
        stamp = round(NANOSECONDS * time)
        message.timestamp.FromNanoseconds(stamp)
        yield TimedMessage("/log", stamp, message)
