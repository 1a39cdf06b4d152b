"""The types needed to write a model: contracts, signals, quantities and registry rows."""

from dssc_jax.core.contracts import (
    Controller,
    Differentiator,
    Disturbance,
    HarmonicBalance,
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
from dssc_jax.core.smoothness import SMOOTH, Smoothness, not_smooth, piecewise
from dssc_jax.core.units import ChannelUnits

__all__ = [
    "SMOOTH",
    "ChannelUnits",
    "Command",
    "Controller",
    "Differentiator",
    "Discretisation",
    "Disturbance",
    "Entry",
    "HarmonicBalance",
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
    "Smoothness",
    "State",
    "TrackingError",
    "Unmodelled",
    "Wind",
    "not_smooth",
    "piecewise",
    "single",
    "stateless",
    "tracking_error",
    "unchanged",
]
