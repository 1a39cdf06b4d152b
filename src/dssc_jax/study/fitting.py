"""Controllers that are fitted to the nominal plant, in which each law has its nominal value, when a study is built."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.closed_loop.readings import STATE
from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.contracts import Plant
from dssc_jax.core.errors import errors_under
from dssc_jax.core.named import NamedSignal, signals_in
from dssc_jax.core.numerics import arithmetic
from dssc_jax.core.setting import LoopSetting, NominalPlant
from dssc_jax.core.signals import Params, PlantInput, Scalar
from dssc_jax.study.components import Component
from dssc_jax.study.laws import UncertainValue
from dssc_jax.study.numbers import dotted_name

COMMAND_DISTURBANCE = "disturbance"
"""Name of the disturbance that adds to the command."""


def nominal_params(params: Params) -> Params:
    """Replace each law and expression in parameters by its nominal value."""
    return jax.tree.map(lambda leaf: leaf.nominal if isinstance(leaf, UncertainValue) else leaf, params)


def setting_of(
    plant: Plant, params: Params, sample_time: float, measured_signals: Sequence[NamedSignal]
) -> LoopSetting:
    """The setting to which a controller of this loop is fitted.

    Args:
        plant: Model of the plant.
        params: Parameters of the plant, in plain numbers.
        sample_time: Sample time T_s [s].
        measured_signals: Signals that the loop measures besides y and y'.

    Returns:
        The setting, with the nominal plant if the plant is linear and has one channel.
    """
    names = tuple(signal.name for signal in measured_signals)
    is_linear = plant.linear is not None and plant.remainder is None and len(plant.channels) < 2
    return LoopSetting(sample_time, names, nominal_plant(plant, params, names) if is_linear else None)


def nominal_plant(plant: Plant, params: Params, signal_names: Sequence[str]) -> NominalPlant:
    """Matrices of a linear plant with one channel, in plain numbers.

    The plant declares the matrices of its state. The rows of the output and of the measured signals follow from
    differentiation of what it measures and reports.

    Args:
        plant: Model of the plant, with ``linear``.
        params: Parameters of the plant, in plain numbers.
        signal_names: Names of the measured signals besides y and y'.
    """
    assert plant.linear is not None  # checked by setting_of
    dynamics = plant.linear(params)
    inputs = plant.inputs(params) if plant.inputs else ()
    leaves, structure = jax.tree.flatten(plant.init(params))
    order = len(leaves)
    quiet = quiet_inputs(plant, params)

    def signals(x: jax.Array, command: Scalar) -> jax.Array:
        state = structure.unflatten(list(x))
        drive = PlantInput(command, 0.0, None, quiet)
        measurement = plant.measure(params, state, drive)
        report = plant.monitor(params, state, drive)
        values = {"y": measurement.y, "y_dot": measurement.y_dot} | signals_in(report)
        values |= {f"{STATE}{i}": leaf for i, leaf in enumerate(x, start=1)}
        return jnp.stack([jnp.asarray(values[name]) for name in ("y", *signal_names)])

    with arithmetic():
        rows, feedthrough = map(np.asarray, jax.jacfwd(signals, argnums=(0, 1))(jnp.zeros(order), 0.0))
    columns = [*dynamics.disturbance, *dynamics.inputs]
    return NominalPlant(
        a=np.asarray(dynamics.a, float),
        command=np.asarray(dynamics.command[0], float),
        disturbances=np.asarray(columns, float).T,
        output=rows[0],
        signals=rows[1:],
        feedthrough=feedthrough[1:],
        inputs=(COMMAND_DISTURBANCE, *(signal.name for signal in inputs)),
    )


def fitted_controllers(
    controllers: Sequence[Component],
    plant: Component,
    channels: Sequence[str],
    sample_time: float,
    measured_signals: Sequence[NamedSignal],
) -> list[Component]:
    """Fit the gains of each controller whose model has ``fit``; other controllers stay.

    Args:
        controllers: Controller of each channel.
        plant: The plant, parsed.
        channels: Names of the channels.
        sample_time: Sample time T_s [s].
        measured_signals: Signals that the loop measures besides y and y'.

    Raises:
        ConfigError: A controller cannot be fitted.
    """
    if all(component.model.fit is None for component in controllers):
        return list(controllers)
    setting = setting_of(plant.model, nominal_params(plant.params), sample_time, measured_signals)
    result = []
    for name, component in zip(channels, controllers, strict=True):
        if component.model.fit is not None:
            with errors_under(dotted_name("controller", name)):
                component = replace(component, params=component.model.fit(component.params, setting))
        result.append(component)
    return result
