"""Controllers whose gains are fitted to the nominal plant when a study is read.

In the nominal plant, each uncertain number has the nominal value of its law.
"""

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
from dssc_jax.study.laws import nominal_params
from dssc_jax.study.numbers import dotted_name

COMMAND_DISTURBANCE = "disturbance"
"""Name of the disturbance that adds to the command."""


def setting_of(
    plant: Plant, params: Params, sample_time: float, measured_signals: Sequence[NamedSignal]
) -> LoopSetting:
    """The setting to which a controller's gains are fitted: sample time, measured signals and nominal plant.

    Args:
        plant: Model of the plant.
        params: Parameters of the plant, in plain numbers.
        sample_time: Sample time T_s [s].
        measured_signals: Signals that the loop measures besides y and y'.

    Returns:
        The setting; its nominal plant is None if the plant is nonlinear or has several channels.
    """
    names = tuple(signal.name for signal in measured_signals)
    is_linear = plant.linear is not None and plant.remainder is None
    has_one_channel = len(plant.channels) < 2  # the only channel has no name
    nominal = nominal_plant(plant, params, names) if is_linear and has_one_channel else None
    return LoopSetting(sample_time, names, nominal)


def nominal_plant(plant: Plant, params: Params, signal_names: Sequence[str]) -> NominalPlant:
    """Matrices of a linear plant with one channel, in plain numbers, for the design of its controller.

    The plant declares the matrices of its state equation. Derivatives of its functions ``measure`` and ``monitor`` give
    the rows of the output and of the measured signals.

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
        """The output y, then the m measured signals, shape (1 + m,), for a state and a command, undisturbed."""
        state = structure.unflatten(list(x))
        drive = PlantInput(command, disturbance=0.0, wind=None, inputs=quiet)
        measurement = plant.measure(params, state, drive)
        report = plant.monitor(params, state, drive)
        values = {"y": measurement.y, "y_dot": measurement.y_dot} | signals_in(report)
        values |= {f"{STATE}{i}": leaf for i, leaf in enumerate(x, start=1)}
        return jnp.stack([jnp.asarray(values[name]) for name in ("y", *signal_names)])

    with arithmetic():
        slopes_of = jax.jacfwd(signals, argnums=(0, 1))
        rows, feedthrough = map(np.asarray, slopes_of(jnp.zeros(order), 0.0))
    disturbance_columns = [*dynamics.disturbance, *dynamics.inputs]
    return NominalPlant(
        a=np.asarray(dynamics.a, float),
        command=np.asarray(dynamics.command[0], float),  # the column of the only channel
        disturbances=np.asarray(disturbance_columns, float).T,
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
    """Fit the gains of each controller whose model has the function ``fit``; other controllers stay as they are.

    Args:
        controllers: Controller of each channel, parsed.
        plant: The plant, parsed.
        channels: Names of the channels; one empty name for a plant with one channel.
        sample_time: Sample time T_s [s].
        measured_signals: Signals that the loop measures besides y and y'.

    Raises:
        ConfigError: A controller cannot be fitted.
    """
    if all(component.model.fit is None for component in controllers):
        return list(controllers)
    setting = setting_of(plant.model, nominal_params(plant.params), sample_time, measured_signals)
    fitted = []
    for channel, component in zip(channels, controllers, strict=True):
        if component.model.fit is None:
            fitted.append(component)
            continue
        with errors_under(dotted_name("controller", channel)):
            fitted.append(replace(component, params=component.model.fit(component.params, setting)))
    return fitted
