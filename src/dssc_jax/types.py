"""The types needed to write a model or a metric: contracts, signals, quantities and registry rows."""

from dssc_jax.closed_loop.metrics.streaming import Metric
from dssc_jax.core.contracts import (
    Controller,
    Differentiator,
    Disturbance,
    LinearDynamics,
    Moments,
    NoParams,
    Plant,
    Preset,
    Reference,
    Sensor,
    Timing,
    Unmodelled,
    Variation,
)
from dssc_jax.core.default_functions import stateless, unchanged
from dssc_jax.core.harmonic_balance import HarmonicBalance
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Discretisation, Entry, Registry, Slot, single
from dssc_jax.core.sampled_linear import LinearSystem
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
from dssc_jax.core.wind import Wind, WindBounds

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
    "LinearDynamics",
    "LinearSystem",
    "Measurement",
    "Metric",
    "Moments",
    "NamedSignal",
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
    "Timing",
    "TrackingError",
    "Unmodelled",
    "Variation",
    "Wind",
    "WindBounds",
    "not_smooth",
    "piecewise",
    "single",
    "stateless",
    "tracking_error",
    "unchanged",
]
