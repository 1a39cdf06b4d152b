"""The closed loop as data, before JAX traces it: a model in each slot, such as the plant, and the clock."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import jax

from dssc_jax.core.adapters import as_mimo_plant, as_mimo_reference, quiet_inputs
from dssc_jax.core.contracts import Controller, Differentiator, Disturbance, Plant, Reference, Sensor, Unmodelled
from dssc_jax.core.events import Condition, VehicleEvent, condition_at
from dssc_jax.core.integrators import Integrator
from dssc_jax.core.named import NamedSignal
from dssc_jax.core.numerics import stream
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.signals import Measurements, Params, PlantInput, ReferencePoints, Scalar, Signals
from dssc_jax.core.wind import Wind


def signal_name(channel: str, signal: str) -> str:
    """Name of a channel's signal in results, such as ``x_e``; ``e`` alone if the channel's name is empty."""
    return f"{channel}_{signal}" if channel else signal


class LoopParams(NamedTuple):
    """Parameters of every part of a :class:`Loop`; any number may be traced.

    Args:
        plant: Parameters of the plant.
        reference: Parameters of the reference.
        wind: Parameters of the wind.
        controller: Parameters of each channel's controller.
        sensor: Parameters of each channel's sensor.
        differentiator: Parameters of each channel's differentiator.
        unmodelled: Parameters of each channel's unmodelled dynamics.
        disturbance: Parameters of each channel's disturbance.
        inputs: Parameters of the disturbance at each input that the plant names.
        signal_sensor: Parameters of the sensor of each measured signal.
        events: Parameters of each event.
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
    """The rule that ends a draw: it has settled once |e| <= ``error`` in every channel for the time ``hold``.

    Args:
        error: Bound on |e| in the unit of the output [m; rad for psi].
        hold: Time for which the bound must hold [s].
        after: Time before which no sample counts [s].
    """

    error: float
    hold: float
    after: float


@dataclass(frozen=True)
class Loop:
    """A closed loop before tracing: a model in each slot, and the clock.

    Controller, sensor, differentiator, unmodelled dynamics and disturbance have one model per channel.

    Args:
        plant: The plant.
        reference: The desired outputs of all channels.
        wind: The wind; ``NO_WIND`` for a plant that feels none.
        controller: Controllers.
        sensor: Sensors of the outputs.
        differentiator: Differentiators of the readings, on the flight computer.
        unmodelled: Dynamics between command and plant that the controllers do not know.
        disturbance: Matched disturbances.
        channels: Names of the channels; one empty name for a plant with one channel.
        sample_time: Sample time T_s [s].
        steps: Number of samples.
        substeps: Integrator steps between two samples.
        integrator: Method of integration.
        settled: Rule for ending a settled draw; None: no draw ends in this way.
        inputs: A disturbance at each input that the plant names.
        input_names: Names of the inputs of ``inputs``.
        outputs: Signals that the plant's monitor reports and that are declared with unit and meaning.
        measures: Signals that are measured beside y and y' of each channel.
        signal_sensor: A sensor for each measured signal.
        events: Events of the vehicle, such as the loss of a rotor.
        rotors: Number of the vehicle's rotors if there are events, else 0.
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

    def condition(self, params: LoopParams, t: Scalar) -> Condition | None:
        """The vehicle's condition after the events up to the sample at t [s]; None without events."""
        return condition_at(self.events, params.events, t, self.sample_time, self.rotors)

    def zero_input(self, params: Params) -> PlantInput[Signals]:
        """The input of a plant with these parameters if all commands and disturbances are 0, without wind."""
        zeros = (0.0,) * len(self.channels)
        return PlantInput(zeros, zeros, wind=None, inputs=quiet_inputs(self.plant, params))

    def key(self, draw: jax.Array, slot: str, name: str = "") -> jax.Array:
        """The random key of one part in one draw; it does not depend on which other parts the study has.

        Args:
            draw: The draw's key.
            slot: The kind of part, such as ``sensor``.
            name: Name of the part's channel, input or signal; empty for a part without such a name.
        """
        return jax.random.fold_in(draw, stream(f"{slot}.{name}" if name else slot))

    def key_at(self, draw: jax.Array, slot: str, name: str, call: Scalar) -> jax.Array:
        """The random key of a part for one of its calls.

        Args:
            draw: The draw's key.
            slot: The kind of part, as for :meth:`key`.
            name: Name of the part's channel, input or signal; empty for a part without such a name.
            call: Number of the call: 0 for ``init``, and k + 1 for sample k.
        """
        return jax.random.fold_in(self.key(draw, slot, name), call)
