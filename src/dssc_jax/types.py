"""The types needed to write a model: contracts, signals, quantities and registry rows."""

from dssc_jax.core.contracts import (
    Controller,
    Differentiator,
    Disturbance,
    NoParams,
    Plant,
    Preset,
    Reference,
    Sensor,
    Unmodelled,
    Wind,
    stateless,
    unchanged,
)
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Discretisation, Entry, Registry, Slot, single
from dssc_jax.core.signals import (
    Command,
    Measurement,
    Outcome,
    PlantInput,
    ReferencePoint,
    Scalar,
    State,
    TrackingError,
    tracking_error,
)
from dssc_jax.core.units import ChannelUnits

__all__ = [
    "ChannelUnits",
    "Command",
    "Controller",
    "Differentiator",
    "Discretisation",
    "Disturbance",
    "Entry",
    "Measurement",
    "NoParams",
    "Outcome",
    "Plant",
    "PlantInput",
    "Preset",
    "Quantity",
    "Reference",
    "ReferencePoint",
    "Registry",
    "Scalar",
    "Sensor",
    "Slot",
    "State",
    "TrackingError",
    "Unmodelled",
    "Wind",
    "single",
    "stateless",
    "tracking_error",
    "unchanged",
]
