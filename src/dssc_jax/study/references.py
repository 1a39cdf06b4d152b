"""References of a plant of one's own: a flight has four points, and the plant may have another number of channels."""

from dataclasses import replace
from functools import lru_cache

from dssc_jax.closed_loop.loop import Loop
from dssc_jax.core.contracts import Plant, Reference
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.signals import Params, ReferencePoints, Scalar
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.references import TRAJECTORIES
from dssc_jax.study.importing import imported

FLIGHT_POINTS = 4
"""Number of points of a flight: x, y, z and yaw."""


def with_further_references(table: TomlTable) -> TomlTable:
    """A study's table in which each channel beyond a flight's points has a reference: its own, or zero."""
    plant = table.get("plant")
    reference = table.get("reference", {})
    kind = plant.get("kind") if isinstance(plant, dict) else None
    if not isinstance(kind, str) or ":" not in kind or not isinstance(reference, dict):
        return table
    if all(name != reference.get("kind", "zero") for name in TRAJECTORIES):
        return table  # a reference of one's own has a point for each channel
    try:
        model = imported(kind, "plant.kind")
    except ConfigError:
        return table  # the study's parsing reports it
    channels = model.channels if isinstance(model, Plant) else ()
    further_references = {channel: {"kind": "zero"} for channel in channels[FLIGHT_POINTS:]}
    return {**table, "reference": further_references | reference} if further_references else table


def with_reference_of_channels(loop: Loop) -> Loop:
    """The loop whose reference has as many points as the plant has channels: a flight's first ones."""
    if not 1 < len(loop.channels) < FLIGHT_POINTS:
        return loop
    return replace(loop, reference=first_points(loop.reference, len(loop.channels)))


@lru_cache(maxsize=64)
def first_points(reference: Reference, count: int) -> Reference:
    """A reference's first points; the same function for the same reference, so that programs are compiled once."""

    def at(params: Params, t: Scalar) -> ReferencePoints:
        return reference.at(params, t)[:count]

    return reference._replace(at=at)
