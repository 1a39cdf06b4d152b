"""The messages of a trajectory in an MCAP file; imported only where the extra ``mcap`` is installed.

Messages are Protocol Buffers. Poses, vectors and the log have the schemas of Foxglove; signals have schemas of their
own, with one field for each. Time 0 of the trajectory is time 0 of the file. The frame ``world`` is the model's
inertial one, z up; ``vehicle`` has the body's axes forward, left, up.

Sources: MCAP format specification; Foxglove schemas (PoseInFrame, PosesInFrame, FrameTransform, Vector3, Log).
"""

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

from dssc_jax.closed_loop.requirements import VIOLATED_AT

WORLD = "world"
VEHICLE = "vehicle"
NANOSECONDS = 1_000_000_000
PLACE = ("x_y", "y_y", "z_y")
DESIRED = ("x_y_ref", "y_y_ref", "z_y_ref")
ATTITUDE = ("attitude_w", "attitude_x", "attitude_y", "attitude_z")
VECTORS = {
    "/body_rates": ("rate_x", "rate_y", "rate_z"),
    "/wind": ("wind_x", "wind_y", "wind_z"),
    "/velocity": ("x_y_dot", "y_y_dot", "z_y_dot"),
}
"""Topics of vectors, and the signals of their components."""
SIGNALS = "signals"
MOST_PATH_POSES = 2000


class Written(NamedTuple):
    """A message with its topic and its time.

    Args:
        topic: Such as ``/pose``.
        time: Time of the trajectory [ns].
        content: The message.
    """

    topic: str
    time: int
    content: Message


def write_messages(trajectory: xr.Dataset, file: IO[bytes]) -> None:
    """Write all messages of a trajectory to an opened file, in the order of their times."""
    writer = Writer(file)
    for message in sorted(messages_of(trajectory), key=lambda message: message.time):
        writer.write_message(message.topic, message.content, message.time, message.time)
    writer.finish()


def messages_of(trajectory: xr.Dataset) -> Iterator[Written]:
    """All messages of a trajectory."""
    times = np.round(NANOSECONDS * trajectory["t"].values).astype(np.int64)
    columns = {str(name): trajectory[name].values.astype(float) for name in trajectory.data_vars}
    if set(PLACE) | set(ATTITUDE) <= set(columns):
        yield from poses(columns, times)
    for topic, names in VECTORS.items():
        if set(names) <= set(columns):
            yield from vectors(topic, [columns[name] for name in names], times)
    for topic, names in signal_topics(list(columns)).items():
        yield from signals(topic, {field: columns[name] for field, name in names.items()}, times)
    yield from verdicts(trajectory)


def poses(columns: Mapping[str, np.ndarray], times: np.ndarray) -> Iterator[Written]:
    """The pose and the transform at each sample, the desired place, and the whole path at time 0."""
    place = np.stack([columns[name] for name in PLACE], axis=1)
    attitude = np.stack([columns[name] for name in ATTITUDE], axis=1)
    path = PosesInFrame(frame_id=WORLD)
    finite_samples = np.flatnonzero(np.isfinite(place).all(axis=1))
    for row in finite_samples:
        time = int(times[row])
        pose = PoseInFrame(frame_id=WORLD)
        transform = FrameTransform(parent_frame_id=WORLD, child_frame_id=VEHICLE)
        for stamp in (pose.timestamp, transform.timestamp):
            stamp.FromNanoseconds(time)
        for vector in (pose.pose.position, transform.translation):
            vector.x, vector.y, vector.z = map(float, place[row])
        for quaternion in (pose.pose.orientation, transform.rotation):
            quaternion.w, quaternion.x, quaternion.y, quaternion.z = map(float, attitude[row])
        yield Written("/pose", time, pose)
        yield Written("/tf", time, transform)
    for row in finite_samples[:: max(1, -(-len(finite_samples) // MOST_PATH_POSES))]:
        point = path.poses.add()
        point.position.x, point.position.y, point.position.z = map(float, place[row])
        point.orientation.w = 1.0
    yield Written("/path", int(times[0]), path)
    if set(DESIRED) <= set(columns):
        desired_places = np.stack([columns[name] for name in DESIRED], axis=1)
        for row in np.flatnonzero(np.isfinite(desired_places).all(axis=1)):
            desired_pose = PoseInFrame(frame_id=WORLD)
            desired_pose.timestamp.FromNanoseconds(int(times[row]))
            desired_pose.pose.position.x, desired_pose.pose.position.y, desired_pose.pose.position.z = map(
                float, desired_places[row]
            )
            desired_pose.pose.orientation.w = 1.0
            yield Written("/desired_pose", int(times[row]), desired_pose)


def vectors(topic: str, components: list[np.ndarray], times: np.ndarray) -> Iterator[Written]:
    """A vector at each sample at which it is known."""
    rows = np.stack(components, axis=1)
    for row in np.flatnonzero(np.isfinite(rows).all(axis=1)):
        x, y, z = map(float, rows[row])
        yield Written(topic, int(times[row]), Vector3(x=x, y=y, z=z))


def signal_topics(names: list[str]) -> dict[str, dict[str, str]]:
    """Topics of signals: for each, its fields with the trajectory's columns.

    ``/x``, ``/y`` and so on have those of a channel, ``/rotors`` those of rotors, ``/signals`` all others.

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


def signals(topic: str, columns: Mapping[str, np.ndarray], times: np.ndarray) -> Iterator[Written]:
    """The signals of a topic at each sample; NaN once the draw has ended."""
    of = signal_type(topic.strip("/"), list(columns))
    for time, *values in zip(times, *columns.values(), strict=True):
        message = of(**dict(zip(columns, map(float, values), strict=True)))
        message.timestamp.FromNanoseconds(int(time))
        yield Written(topic, int(time), message)


def signal_type(name: str, fields: list[str]) -> type[Any]:
    """The type of a message with a stamp and one number for each field."""
    pool = descriptor_pool.DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    file = descriptor_pb2.FileDescriptorProto(name=f"dssc_jax/{name}.proto", package="dssc_jax", syntax="proto3")
    file.dependency.append(timestamp_pb2.DESCRIPTOR.name)
    kind = file.message_type.add(name=name)
    kinds = descriptor_pb2.FieldDescriptorProto
    kind.field.add(
        name="timestamp",
        number=1,
        type=kinds.TYPE_MESSAGE,
        type_name=".google.protobuf.Timestamp",
        label=kinds.LABEL_OPTIONAL,
    )
    for number, field in enumerate(fields, 2):
        kind.field.add(name=field, number=number, type=kinds.TYPE_DOUBLE, label=kinds.LABEL_OPTIONAL)
    pool.Add(file)
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(f"dssc_jax.{name}"))


def verdicts(trajectory: xr.Dataset) -> Iterator[Written]:
    """The log: what the trajectory is, when a requirement was violated for certain, and how the draw ended."""
    attributes = trajectory.attrs
    end = float(trajectory["t"].values[-1])
    lines = [(0.0, Log.INFO, f"{attributes.get('study', '')}, draw {attributes.get('draw', '')}")]
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
        yield Written("/log", stamp, message)
