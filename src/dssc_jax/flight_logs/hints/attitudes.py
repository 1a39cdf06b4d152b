"""The attitude with which a logged flight begins, compared with that of the study.

A vehicle in wind is tilted, and one in a manoeuvre turns. Compared with a study that begins level, it drifts away at
first, and a fit explains that by another wind, drag or integral.
"""

import math
import warnings
from typing import NamedTuple

import jax
import numpy as np

from dssc_jax.closed_loop.beginning import begin_plant
from dssc_jax.core.numerics import arithmetic
from dssc_jax.flight_logs.hints.references import median_values
from dssc_jax.flight_logs.reading.reader import Column, FlightLog, ulog_column
from dssc_jax.flight_logs.reading.ulog import LogWarning, TopicData, is_ulog, read_topics
from dssc_jax.flight_logs.signal_warnings import Hint
from dssc_jax.models.uav.inner_loops.article import euler_of
from dssc_jax.models.uav.onboard import UavState
from dssc_jax.study import Study
from dssc_jax.study.record_files import recorded_frame

TILTED = math.radians(1.0)  # least difference between the tilt of the log and that of the study that is reported
TURNING = 0.1  # rad/s, least difference between the body rates of the log and of the study that is reported
NEAR = 0.1  # s from the beginning of the study, within which the log needs a value
ULOG_COLUMNS = {
    "phi": "vehicle_attitude.phi",
    "theta": "vehicle_attitude.theta",
    "rate_x": "vehicle_angular_velocity.p",
    "rate_y": "vehicle_angular_velocity.q",
    "rate_z": "vehicle_angular_velocity.r",
}
"""The columns of a ULog, by the names that tables have, which are those of trajectories."""
ANGLES = ("phi", "theta")
RATES = ("rate_x", "rate_y", "rate_z")


class FirstMotion(NamedTuple):
    """Roll and pitch [rad], and the body rate [rad/s], at the beginning; () where the log lacks them."""

    angles: tuple[float, ...]
    rate: tuple[float, ...]


def attitude_columns(log: FlightLog) -> dict[str, Column]:
    """Get the columns of roll, pitch and body rate that a log has, by name; the log's file is read once more."""
    if log.file is None:
        return {name: log.columns[name] for name in ULOG_COLUMNS if name in log.columns}
    if is_ulog(log.file):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LogWarning)  # the first reading of the log has warned
            topics, begin, _ = read_topics(log.file, {column.partition(".")[0] for column in ULOG_COLUMNS.values()})
        present = {name: column for name, column in ULOG_COLUMNS.items() if has_attitude_fields(topics, column)}
        return {name: ulog_column(topics, begin, name, column) for name, column in present.items()}
    frame = recorded_frame(log.file)
    numbers = frame.select_dtypes("number")
    if log.clock.column not in numbers:
        return {}
    time = log.clock.scale * numbers[log.clock.column].to_numpy(float)
    return {name: Column(time, numbers[name].to_numpy(float)) for name in ULOG_COLUMNS if name in numbers}


def has_attitude_fields(topics: TopicData, column: str) -> bool:
    """Whether a log has the fields from which a column is computed: a quaternion for an angle, a vector for a rate."""
    topic, _, field = column.partition(".")
    fields = topics.get(f"{topic}:0", {})
    return ("q[0]" if field in ANGLES else "xyz[0]") in fields


def value_near(column: Column | None, time: float) -> float:
    """The value of a column nearest to a time of the log [s]; NaN if there is none near it."""
    if column is None:
        return math.nan
    rows = np.flatnonzero(np.isfinite(column.time) & np.isfinite(column.value))
    if not rows.size:
        return math.nan
    nearest = rows[np.argmin(np.abs(column.time[rows] - time))]
    return float(column.value[nearest]) if abs(column.time[nearest] - time) <= NEAR else math.nan


def logged_motion(log: FlightLog) -> FirstMotion:
    """The attitude and body rate at the time of the log at which the study begins."""
    columns = attitude_columns(log)
    angles_and_rates = []
    for names in (ANGLES, RATES):
        values = tuple(value_near(columns.get(name), log.start) for name in names)
        angles_and_rates.append(values if np.isfinite(values).all() else ())
    return FirstMotion(*angles_and_rates)


def study_motion(study: Study) -> FirstMotion | None:
    """The attitude and body rate with which a study begins, at its laws' medians; None if its plant is no vehicle."""
    with arithmetic(study.config.loop.precision):
        state = begin_plant(study.loop, study.params(median_values(study)), jax.random.key(0))
        if not isinstance(state, UavState):
            return None
        phi, theta, _ = euler_of(state.attitude.matrix())
        return FirstMotion((float(phi), float(theta)), tuple(map(float, state.rate)))


def attitude_hints(study: Study, log: FlightLog) -> dict[str, Hint]:
    """Hints that a log begins with another tilt or body rate than the study, by name of the study's field.

    Fields whose numbers have laws get no hint, because a fit estimates them.
    """
    if not hasattr(study.template.plant, "body_rate"):
        return {}
    logged = logged_motion(log)
    initial = study_motion(study) if logged.angles or logged.rate else None
    hints: dict[str, Hint] = {}
    if initial is None:
        return hints
    if logged.angles and not has_free_tilt(study) and math.dist(logged.angles, initial.angles) > TILTED:
        roll, pitch = logged.angles
        text = (
            f"and plant.pitch: the study begins with a tilt of {tilt_degrees(initial.angles):.3g} degrees, the log "
            f"with one of {tilt_degrees(logged.angles):.3g}. Set plant.roll = {roll:.4g} and "
            f"plant.pitch = {pitch:.4g}, or give them laws around these, which a fit estimates"
        )
        hints["plant.roll"] = Hint("start-motion", text)
    has_free_rate = any(name.startswith("plant.body_rate.") for name in study.laws)
    if logged.rate and not has_free_rate and math.dist(logged.rate, initial.rate) > TURNING:
        p, q, r = logged.rate
        text = (
            f"has a length of {math.hypot(*initial.rate):.3g} rad/s, and the log begins with "
            f"{math.hypot(p, q, r):.3g}. Set plant.body_rate = [{p:.4g}, {q:.4g}, {r:.4g}]"
        )
        hints["plant.body_rate"] = Hint("start-motion", text)
    return hints


def has_free_tilt(study: Study) -> bool:
    """Whether the tilt at the beginning has a law, or follows from a wind that has one."""
    if {"plant.roll", "plant.pitch"} & set(study.laws):
        return True
    software = study.loop.mimo_plant.software
    is_settled = software is not None and software.settled(study.template.plant)
    has_tilt = study.template.plant.roll is not None and study.template.plant.pitch is not None
    return is_settled and not has_tilt and any(name.startswith("wind.") for name in study.laws)


def tilt_degrees(angles: tuple[float, ...]) -> float:
    """The angle of body z from the vertical, for roll and pitch [rad]."""
    return math.degrees(math.acos(math.cos(angles[0]) * math.cos(angles[1])))
