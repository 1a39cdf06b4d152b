"""Registries of references: REFERENCES of one channel, TRAJECTORIES of the vehicle; a family is one file."""

from dssc_jax.core.contracts import NoParams, Reference
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.signals import ReferencePoint
from dssc_jax.models.references.chirp import CHIRP
from dssc_jax.models.references.flights import HOVER, STEPS, WHOLE_MISSION
from dssc_jax.models.references.multisine import MULTISINE
from dssc_jax.models.references.record import RECORD
from dssc_jax.models.references.sine import MISSION_ENTRY, SINE
from dssc_jax.models.references.steps import PULSES, RAMP_REFERENCE, STEP_REFERENCE
from dssc_jax.models.references.waypoints import SOCCER_FIELD, WAYPOINTS

ZERO = Reference(NoParams, lambda params, t: ReferencePoint(0.0, 0.0, 0.0))

REFERENCES: Registry = {
    "zero": single(ZERO, "regulation to the origin"),
    "sine": single(SINE, "offset + amplitude sin(2 pi t/period + phase)"),
    "step": single(STEP_REFERENCE, "a step at a given time"),
    "ramp": single(RAMP_REFERENCE, "a ramp, for a given time or without end"),
    "pulses": single(PULSES, "a train of rectangular pulses"),
    "chirp": CHIRP,
    "multisine": single(MULTISINE, "a sum of sines"),
    "record": RECORD,
    "mission": MISSION_ENTRY,
}
TRAJECTORIES: Registry = {
    "zero": single(HOVER, "hover at the origin, or at a given position"),
    "hover": single(HOVER, "a fixed position and yaw"),
    "steps": single(STEPS, "steps of position and yaw, from the origin"),
    "mission": single(WHOLE_MISSION, "the article's mission, all four axes"),
    "soccer_field": single(
        WAYPOINTS._replace(defaults=SOCCER_FIELD),
        "waypoints over a soccer field (made up), like the article's field test",
    ),
    "waypoints": single(WAYPOINTS, "georeferenced waypoints, flown at bounded speed"),
}
