"""Resets of PX4's estimator: jumps of position, velocity and heading that no vehicle has flown, and their removal.

A counter of a topic rises at each reset, and a field ``delta_..`` has the jump: the estimate after the reset less that
before it. Where the log has both, the jump is taken out of the estimate and of its setpoints, which are in the same
frame: they then continue in the frame from before the reset. A velocity keeps its jump: the estimate was wrong before
the reset and is right after it, and the vehicle's controllers have seen the jump.

The topic of the position also tells when position and velocity are valid; invalid values are left out.

Sources: PX4 user guide, messages ``VehicleLocalPosition`` and ``VehicleAttitude``; PX4's EKF2, where the change of the
quaternion is q_after q_before^-1.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from dssc_jax.core.flag_runs import flag_runs
from dssc_jax.flight_logs.reading.frames import MICROSECOND, derived_fields
from dssc_jax.flight_logs.reading.ulog import TopicData, log_end, stamps

POSITION = "vehicle_local_position"
ATTITUDE = "vehicle_attitude"
QUATERNION = tuple(f"q[{i}]" for i in range(4))
AXES = ("x", "y", "z")
SETPOINTS = {
    "vehicle_local_position_setpoint": {
        **{axis: axis for axis in AXES},
        **{f"v{axis}": f"v{axis}" for axis in AXES},
        "yaw": "heading",
    },
    "trajectory_setpoint": {
        **{f"position[{i}]": axis for i, axis in enumerate(AXES)},
        **{f"velocity[{i}]": f"v{axis}" for i, axis in enumerate(AXES)},
        "yaw": "heading",
    },
}
"""Topics in the frame of the position, with the field of the position for each of theirs."""
NAMED = 3  # resets that a message names
SETPOINT_DELAY = 0.1  # s after the estimate's first message, within which setpoints follow it
SAME_JUMP = 0.5  # share of the estimate's jump: a step of a setpoint that is closer to it follows it


class Counter(NamedTuple):
    """A counter of resets.

    Args:
        topic: Name of the counter's topic.
        name: Name of the counter's field.
        deltas: The fields that state the jump.
        fields: The fields that jump.
        unit: Unit of the jump.
    """

    topic: str
    name: str
    deltas: tuple[str, ...]
    fields: tuple[str, ...]
    unit: str


COUNTERS = (
    Counter(POSITION, "xy_reset_counter", ("delta_xy[0]", "delta_xy[1]"), ("x", "y"), "m"),
    Counter(POSITION, "z_reset_counter", ("delta_z",), ("z",), "m"),
    Counter(POSITION, "vxy_reset_counter", ("delta_vxy[0]", "delta_vxy[1]"), ("vx", "vy"), "m/s"),
    Counter(POSITION, "vz_reset_counter", ("delta_vz",), ("vz",), "m/s"),
    Counter(POSITION, "heading_reset_counter", ("delta_heading",), ("heading",), "rad"),
    Counter(ATTITUDE, "quat_reset_counter", tuple(f"delta_q_reset[{i}]" for i in range(4)), QUATERNION, "rad"),
)
VALIDITY = {"xy_valid": ("x", "y"), "z_valid": ("z",), "v_xy_valid": ("vx", "vy"), "v_z_valid": ("vz",)}
"""The flags of the position's topic, with the fields that they are of."""
SAME_AXIS = {axis: f"v{axis}" for axis in AXES}


class Reset(NamedTuple):
    """A reset of the estimator.

    Args:
        counter: The counter that has risen.
        row: Position in the topic of the first message after the reset.
        time: Time of that message, from the beginning of the log [s].
        jump: The change of each field of the counter; of an attitude, the quaternion q_after q_before^-1.
        is_stated: Whether the log states the jump; else it is the difference from the message before.
    """

    counter: Counter
    row: int
    time: float
    jump: tuple[float, ...]
    is_stated: bool

    @property
    def label(self) -> str:
        """The counter as a column of the log."""
        return f"{self.counter.topic}.{self.counter.name}"

    @property
    def is_speed(self) -> bool:
        """Whether a velocity jumps."""
        return self.counter.unit == "m/s"

    @property
    def is_removed(self) -> bool:
        """Whether the jump is removed from the signals."""
        return self.is_stated and not self.is_speed

    @property
    def size(self) -> float:
        """The length of the jump, or the angle of a rotation, in its unit."""
        if self.counter.fields == QUATERNION:
            return 2.0 * float(np.arctan2(np.linalg.norm(self.jump[1:]), abs(self.jump[0])))
        return float(np.linalg.norm(self.jump))

    def text(self) -> str:
        """The fields that jump, and by how much, in words."""
        qualifier = "" if self.is_stated else "about "
        if self.counter.fields == QUATERNION:
            return f"attitude by {qualifier}{self.size:.3g} rad"
        parts = [
            f"{field} by {qualifier}{value:.3g}" for field, value in zip(self.counter.fields, self.jump, strict=True)
        ]
        return f"{', '.join(parts)} {self.counter.unit}"


class InvalidSpan(NamedTuple):
    """A span in which the estimator calls a quantity invalid.

    Args:
        flag: Name of the flag, a field of the position's topic.
        fields: The invalid fields of that topic.
        begin: Time of the first invalid message [s].
        end: Time at which the quantity is valid again, or the log ends [s].
    """

    flag: str
    fields: tuple[str, ...]
    begin: float
    end: float

    def text(self) -> str:
        """The flag and the span, in words."""
        return f"{POSITION}.{self.flag} is 0 from {self.begin:.4g} s to {self.end:.4g} s"


def reset_list(resets: Sequence[Reset]) -> str:
    """Times and jumps of the first resets, and the number of the others, in words."""
    texts = [f"at {reset.time:.4g} s ({reset.text()})" for reset in resets[:NAMED]]
    remainder = f" and {len(resets) - NAMED} more" if len(resets) > NAMED else ""
    return f"{', '.join(texts)}{remainder}"


def estimate_topics(names: Iterable[str]) -> set[str]:
    """The topics with the counters of resets that concern some topics, given by name."""
    topics = set()
    for name in names:
        if name == POSITION or name in SETPOINTS:
            topics.add(POSITION)
        if name == ATTITUDE or name in SETPOINTS:
            topics.add(ATTITUDE)
    return topics


def resets_of(topics: TopicData, begin: float) -> list[Reset]:
    """The resets of a log, in order of time; the first valid estimate is no reset.

    Args:
        topics: Topics of the log, of which those of the position and of the attitude are used.
        begin: The time at which the log begins [us].
    """
    resets = []
    for counter in COUNTERS:
        fields = topics.get(f"{counter.topic}:0", {})
        if not {counter.name, *counter.fields} <= set(fields):
            continue
        counts = fields[counter.name].astype(int)
        time = stamps(fields, begin)
        for row in (np.flatnonzero(np.diff(counts)) + 1).tolist():
            if not was_valid(fields, counter, row - 1):
                continue
            is_stated = (counts[row] - counts[row - 1]) % 256 == 1 and set(counter.deltas) <= set(fields)
            jump = stated_jump(fields, counter, row) if is_stated else measured_jump(fields, counter, row)
            resets.append(Reset(counter, row, float(time[row]), jump, is_stated))
    return sorted(resets, key=lambda reset: reset.time)


def was_valid(fields: Mapping[str, np.ndarray], counter: Counter, row: int) -> bool:
    """Whether a message has valid values of a counter's fields."""
    for flag, names in VALIDITY.items():
        if names == counter.fields and flag in fields and not fields[flag][row]:
            return False
    return all(np.isfinite(fields[name][row]) for name in counter.fields)


def stated_jump(fields: Mapping[str, np.ndarray], counter: Counter, row: int) -> tuple[float, ...]:
    """The jump that the message in a row states, one number for each field of ``counter.deltas``."""
    return tuple(float(fields[name][row]) for name in counter.deltas)


def measured_jump(fields: Mapping[str, np.ndarray], counter: Counter, row: int) -> tuple[float, ...]:
    """The jump as the difference from the message before a row, which includes the motion in between."""
    following, preceding = (
        np.array([float(fields[name][message]) for name in counter.fields]) for message in (row, row - 1)
    )
    jump = (
        quaternion_product(following, conjugate(preceding)) if counter.fields == QUATERNION else following - preceding
    )
    return tuple(map(float, jump))


def quaternion_product(left: np.ndarray, right: np.ndarray) -> np.ndarray:
    """The product of quaternions w, x, y, z; shape (4, ...)."""
    w, x, y, z = left
    return np.array(
        [
            w * right[0] - x * right[1] - y * right[2] - z * right[3],
            w * right[1] + x * right[0] + y * right[3] - z * right[2],
            w * right[2] - x * right[3] + y * right[0] + z * right[1],
            w * right[3] + x * right[2] - y * right[1] + z * right[0],
        ]
    )


def conjugate(quaternion: np.ndarray) -> np.ndarray:
    """The inverse of a unit quaternion, shape (4, ...)."""
    return np.array([quaternion[0], *(-part for part in quaternion[1:])])


def invalid_spans(topics: TopicData, begin: float, end: float) -> list[InvalidSpan]:
    """The spans in which the estimator calls position or velocity invalid, in order of their flags.

    Args:
        topics: Topics of the log.
        begin: The time at which the log begins [us].
        end: End of the log [s], up to which the last message holds.
    """
    fields = topics.get(f"{POSITION}:0", {})
    spans = []
    for flag, names in VALIDITY.items():
        if flag not in fields:
            continue
        time = stamps(fields, begin)
        for begin_row, end_row in zip(*flag_runs(fields[flag] == 0), strict=True):
            stop = float(time[end_row]) if end_row < len(time) else max(end, float(time[-1]))
            spans.append(InvalidSpan(flag, names, float(time[begin_row]), stop))
    return spans


def without_invalid(topics: TopicData) -> TopicData:
    """The topics, with NaN in place of values that the estimator calls invalid."""
    fields = topics.get(f"{POSITION}:0", {})
    changed = dict(fields)
    for flag, names in VALIDITY.items():
        for name in names:
            if flag in fields and name in fields:
                changed[name] = np.where(fields[flag] == 0, np.nan, fields[name].astype(float))
    return {**topics, f"{POSITION}:0": changed} if fields else topics


def without_jumps(topics: TopicData, resets: Sequence[Reset]) -> TopicData:
    """The topics, with the stated jumps of position, heading and attitude removed, also from the setpoints."""
    changed = {name: dict(fields) for name, fields in topics.items()}
    has_heading = "heading_reset_counter" in topics.get(f"{POSITION}:0", {})
    for reset in reversed(resets):  # rotations do not commute: the last one goes first
        if not reset.is_removed:
            continue
        fields = changed[f"{reset.counter.topic}:0"]
        if reset.counter.fields == QUATERNION:
            quaternions = np.array([fields[name].astype(float) for name in QUATERNION])
            quaternions[:, reset.row :] = quaternion_product(
                conjugate(np.array(reset.jump)), quaternions[:, reset.row :]
            )
            fields.update(zip(QUATERNION, quaternions, strict=True))
            w, x, y, z = reset.jump
            angle = float(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))
            jumps = {} if has_heading else {"heading": angle}
        else:
            jumps = dict(zip(reset.counter.fields, reset.jump, strict=True))
            for name, jump in jumps.items():
                fields[name] = without_jump(fields[name], reset.row, jump)
        begin, end = stamps_around_reset(reset, resets, topics)
        for topic, names in SETPOINTS.items():
            setpoint = changed.get(f"{topic}:0", {})
            setpoint_jumps = {
                name: jumps[source] for name, source in names.items() if source in jumps and name in setpoint
            }
            if setpoint_jumps:
                row = first_row_after_reset(setpoint, setpoint_jumps, begin, end)
                for name, jump in setpoint_jumps.items():
                    setpoint[name] = without_jump(setpoint[name], row, jump)
    return changed


def without_jump(values: np.ndarray, row: int, jump: float) -> np.ndarray:
    """Values with a jump subtracted from a row on."""
    changed = values.astype(float)
    changed[row:] -= jump
    return changed


def stamps_around_reset(reset: Reset, resets: Sequence[Reset], topics: TopicData) -> tuple[float, float]:
    """The stamps of the estimate's last message before a reset and of its first one after it [us].

    For a reset of the heading, they are those of the attitude's reset at the same time, if there is one.
    """

    def stamps_of(jump: Reset) -> tuple[float, float]:
        published = topics[f"{jump.counter.topic}:0"]["timestamp"]
        return float(published[jump.row - 1]), float(published[jump.row])

    begin, end = stamps_of(reset)
    if reset.counter.fields == ("heading",):
        for rotation in resets:
            if rotation.counter.topic == ATTITUDE and begin < stamps_of(rotation)[1] <= end:
                return stamps_of(rotation)
    return begin, end


def first_row_after_reset(
    setpoint: Mapping[str, np.ndarray], jumps: Mapping[str, float], begin: float, end: float
) -> int:
    """The first message of a setpoint that is in the frame of the estimate after a reset.

    If the setpoint steps by the jump near the reset, the message with that step is the first. Otherwise it is the first
    message at or after ``end``.

    Args:
        setpoint: The fields of the setpoint's topic.
        jumps: The jump of the frame along some of these fields, by field.
        begin: The stamp of the estimate's last message before the reset [us].
        end: The stamp of the estimate's first message after the reset [us].
    """
    time = setpoint["timestamp"].astype(float)
    latest = end + SETPOINT_DELAY / MICROSECOND
    nearby = np.flatnonzero((time[1:] > begin) & (time[1:] <= latest)) + 1
    squares = np.zeros(len(nearby))
    for name, jump in jumps.items():
        values = setpoint[name].astype(float)
        excess = values[nearby] - values[nearby - 1] - jump
        if name == "yaw":
            excess = np.remainder(excess + np.pi, 2.0 * np.pi) - np.pi
        squares += excess**2
    finite_rows = np.flatnonzero(np.isfinite(squares))
    if finite_rows.size and np.sqrt(squares[finite_rows].min()) <= SAME_JUMP * np.linalg.norm(list(jumps.values())):
        return int(nearby[finite_rows[np.argmin(squares[finite_rows])]])
    return int(np.searchsorted(time, end))


def needed_fields(topic: str, name: str, topics: TopicData) -> tuple[str, ...]:
    """The topic's own fields from which a field is computed; the field itself if it is not in the model's axes."""
    derived = derived_fields(topic, topics.get(f"{topic}:0", {})).get(name)
    return (name,) if derived is None else derived.needs


def concerns(reset: Reset, topic: str, needs: Iterable[str]) -> bool:
    """Whether a reset changes one of the fields ``needs`` of a topic, or the velocity along the axis of one of them.

    A field of a setpoint counts as the estimate's field in the same frame; a reset of the attitude concerns its yaw.

    Args:
        reset: The reset.
        topic: Name of the topic.
        needs: The topic's own fields from which a column is computed.
    """
    jumping = set(reset.counter.fields)
    if topic in SETPOINTS:
        needs = [SETPOINTS[topic].get(name, "") for name in needs]
        if reset.counter.topic == ATTITUDE:
            return "heading" in needs
    elif topic != reset.counter.topic:
        return False
    return bool(jumping & {*needs, *(SAME_AXIS.get(name, "") for name in needs)})


def concerned_resets(
    topics: TopicData, begin: float, columns: Sequence[tuple[str, str]], start: float
) -> tuple[Reset, ...]:
    """The resets of a log after a time that concern some columns.

    Args:
        topics: Topics of the log.
        begin: The time at which the log begins [us].
        columns: Topic and field of each column.
        start: The time after which resets count, from the beginning of the log [s].
    """
    needs = [(topic, needed_fields(topic, name, topics)) for topic, name in columns]
    later_resets = [reset for reset in resets_of(topics, begin) if reset.time > start]
    return tuple(reset for reset in later_resets if any(concerns(reset, *fields) for fields in needs))


def concerned_spans(topics: TopicData, begin: float, columns: Sequence[tuple[str, str]]) -> tuple[InvalidSpan, ...]:
    """The spans in which some columns, each a topic and a field, are invalid; the log begins at ``begin`` [us]."""
    needs = {field for topic, name in columns if topic == POSITION for field in needed_fields(topic, name, topics)}
    spans = invalid_spans(topics, begin, log_end(topics, begin))
    return tuple(span for span in spans if needs & set(span.fields))
