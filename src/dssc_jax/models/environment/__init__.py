"""Registries of the loop's environment: references, sensors, disturbances, wind."""

from dssc_jax.core.contracts import Reference
from dssc_jax.core.registry import Registry, single
from dssc_jax.models.environment import disturbances, references, signals, waypoints
from dssc_jax.models.environment.records import RECORD, RECORDED_DISTURBANCE
from dssc_jax.models.environment.sensors import SENSORS
from dssc_jax.models.environment.wind import WINDS

WAYPOINTS = Reference(waypoints.WaypointParams, waypoints.at, waypoints.curve)
SOCCER_FIELD = WAYPOINTS._replace(defaults=waypoints.SOCCER_FIELD)

REFERENCES: Registry = {
    "zero": single(references.ZERO, "regulation to the origin"),
    "sine": single(references.SINE, "offset + amplitude sin(2 pi t/period + phase)"),
    "step": single(signals.STEP_REFERENCE, "a step at a given time"),
    "ramp": single(signals.RAMP_REFERENCE, "a ramp, for a given time or without end"),
    "pulses": single(signals.PULSES, "a train of rectangular pulses"),
    "chirp": signals.CHIRP,
    "multisine": single(signals.MULTISINE, "a sum of sines"),
    "record": RECORD,
    "mission": references.MISSION_ENTRY,
}
TRAJECTORIES: Registry = {
    "zero": single(references.HOVER, "hover at the origin, or at a given position"),
    "hover": single(references.HOVER, "a fixed position and yaw"),
    "steps": single(references.STEPS, "steps of position and yaw, from the origin"),
    "mission": single(references.WHOLE_MISSION, "the article's mission, all four axes"),
    "soccer_field": single(SOCCER_FIELD, "waypoints over a soccer field (made up), like the article's field test"),
    "waypoints": single(WAYPOINTS, "georeferenced waypoints, flown at bounded speed"),
}
DISTURBANCES: Registry = {
    "none": single(disturbances.NO_DISTURBANCE, "no disturbance"),
    "constant": single(disturbances.CONSTANT, "a constant"),
    "step": single(disturbances.STEP, "a step at a given time"),
    "sine": single(disturbances.SINE_DISTURBANCE, "amplitude sin(2 pi t/period + phase)"),
    "spline": single(disturbances.SPLINE, "a cubic spline of given knots: any signal of bounded amplitude and slope"),
    "record": RECORDED_DISTURBANCE,
    "filtered_noise": single(disturbances.FILTERED_NOISE, "Gauss-Markov noise, exactly sampled"),
    "partition": single(disturbances.PARTITION, "d_1 + d_2 + d_3 of (30), attaining the bounds of (A1)-(A3)"),
}
__all__ = ["DISTURBANCES", "REFERENCES", "SENSORS", "TRAJECTORIES", "WINDS"]
