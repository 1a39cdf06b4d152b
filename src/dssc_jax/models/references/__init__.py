"""Registries of references: REFERENCES of one channel, TRAJECTORIES of the vehicle; a family is one file."""

from dssc_jax.core.contracts import NoParams, Reference
from dssc_jax.core.default_functions import unchanging
from dssc_jax.core.registry import Registry, single
from dssc_jax.core.signals import ReferencePoint
from dssc_jax.models.references.chirp import CHIRP
from dssc_jax.models.references.flights import HOVER, STEPS, WHOLE_MISSION
from dssc_jax.models.references.multisine import MULTISINE
from dssc_jax.models.references.record import RECORD
from dssc_jax.models.references.sine import MISSION_ENTRY, SINE
from dssc_jax.models.references.steps import PULSES, RAMP_REFERENCE, STEP_REFERENCE
from dssc_jax.models.references.waypoints import SOCCER_FIELD, WAYPOINTS

ZERO = Reference(NoParams, lambda params, t: ReferencePoint(0.0, 0.0, 0.0), last_change=unchanging)

REFERENCES: Registry = {
    "zero": single(ZERO, "regulation to the origin"),
    "sine": single(SINE, "offset + amplitude sin(2 pi t/period + phase)", amplitude=0.5, period=2.0),
    "step": single(STEP_REFERENCE, "a step at a given time", size=0.5, at=0.3),
    "ramp": single(RAMP_REFERENCE, "a ramp, for a given time or without end", slope=0.3, rise=0.5),
    "pulses": single(PULSES, "a train of rectangular pulses", size=0.2, period=0.4, width=0.1),
    "chirp": CHIRP,
    "multisine": single(MULTISINE, "a sum of sines", amplitudes=[0.1, 0.2], frequencies=[0.5, 1.0]),
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
    "waypoints": single(
        WAYPOINTS,
        "georeferenced waypoints, flown at bounded speed",
        latitude_deg=[-22.86, -22.8598],
        longitude_deg=[-43.23, -43.23],
        altitude=[5.0, 6.0],
        speed=1.0,
        acceleration=1.0,
    ),
}
