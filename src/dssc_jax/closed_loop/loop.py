"""The loop before tracing: a model in each named slot, their parameters, and the clock."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax

from dssc_jax.core.adapters import as_mimo_plant, as_mimo_reference
from dssc_jax.core.contracts import Controller, Differentiator, Disturbance, Plant, Reference, Sensor, Unmodelled
from dssc_jax.core.events import VehicleEvent
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.numerics import stream
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurements, Params, ReferencePoints, Signals
from dssc_jax.core.wind import Wind


class LoopParams(NamedTuple):
    """Parameters of every part of the loop; any number may be traced.

    Those of controller, sensor, differentiator, unmodelled dynamics and disturbance are tuples with one element per
    channel. Those of ``inputs`` are the disturbances at the inputs that the plant names, those of ``signal_sensor`` the
    sensors of the measured signals, and those of ``events`` what happens to the vehicle.
    """

    plant: Params
    reference: Params
    wind: Params
    controller: tuple[Params, ...]
    sensor: tuple[Params, ...]
    differentiator: tuple[Params, ...]
    unmodelled: tuple[Params, ...]
    disturbance: tuple[Params, ...]
    inputs: tuple[Params, ...] = ()
    signal_sensor: tuple[Params, ...] = ()
    events: tuple[Params, ...] = ()


class Settled(NamedTuple):
    """When a draw counts as settled and ends: once t >= ``after``, |e| <= ``error`` in every channel for ``hold``.

    Args:
        error: Bound on |e| [m; rad for psi].
        hold: Time for which the bound must hold [s].
        after: Time before which no error counts [s].
    """

    error: float
    hold: float
    after: float


@dataclass(frozen=True)
class Loop:
    """The static part of the loop, chosen before tracing: a model in each named slot, and the clock.

    Args:
        channels: Names of the channels; one empty name for a plant with one channel.
        sample_time: T_s [s].
        steps: Number of samples.
        substeps: Integrator steps between two samples.
        inputs: A disturbance at each input that the plant names.
        input_names: Names of these inputs.
        outputs: What the plant's monitor reports, as far as it is declared with unit and meaning.
        measures: Signals that are measured beside y and y' of each channel.
        signal_sensor: A sensor for each of them.
        settled: Rule for ending a settled draw; None: never.
        events: What happens to the vehicle.
        rotors: Number of its rotors, if something happens to it.
    """

    plant: Plant
    reference: Reference
    wind: Wind
    controller: tuple[Controller, ...]
    sensor: tuple[Sensor, ...]
    differentiator: tuple[Differentiator, ...]
    unmodelled: tuple[Unmodelled, ...]
    disturbance: tuple[Disturbance, ...]
    channels: tuple[str, ...]
    sample_time: float
    steps: int
    substeps: int = 1
    integrator: Integrator = Integrator.RK4
    settled: Settled | None = None
    inputs: tuple[Disturbance, ...] = ()
    input_names: tuple[str, ...] = ()
    outputs: tuple[NamedSignal, ...] = ()
    measures: tuple[NamedSignal, ...] = ()
    signal_sensor: tuple[Sensor, ...] = ()
    events: tuple[VehicleEvent, ...] = ()
    rotors: int = 0

    @cached_property
    def mimo_plant(self) -> Plant[Measurements, Signals]:
        """The plant with tuples as signals, one value per channel, for any number of channels."""
        return self.plant if len(self.channels) > 1 else as_mimo_plant(self.plant)

    @cached_property
    def mimo_reference(self) -> Reference[ReferencePoints]:
        """The reference with a tuple of points, one per channel, for any number of channels."""
        return self.reference if len(self.channels) > 1 else as_mimo_reference(self.reference)

    @property
    def quantities(self) -> dict[str, Quantity]:
        """Unit and meaning of each of the plant's outputs."""
        return {signal.name: signal.quantity for signal in self.outputs}

    def key(self, draw: jax.Array, slot: str, channel: str = "") -> jax.Array:
        """The random key of a slot in a channel, from the draw's key."""
        return jax.random.fold_in(draw, stream(f"{slot}.{channel}" if channel else slot))
