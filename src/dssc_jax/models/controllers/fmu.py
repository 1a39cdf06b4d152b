"""A controller in an FMU: at each sample it gets the signals of the sample, makes a step, and gives the command."""

from typing import NamedTuple

import jax.numpy as jnp

from dssc_jax.core.contracts import Controller
from dssc_jax.core.errors import ConfigError, nearest
from dssc_jax.core.named import report_type
from dssc_jax.core.native.fmu import INPUT, OUTPUT, NativeFmu
from dssc_jax.core.native.fmu_instances import FmuFunctions, FmuPorts, empty_words
from dssc_jax.core.native.fmu_tables import (
    FILE_KEYS,
    OUTPUTS_KEY,
    WITHOUT_DERIVATIVE,
    connection,
    connections,
    fmu_of,
    parameter_connections,
    params_type,
    reported_outputs,
    require_distinct,
    value_references,
    values_of,
)
from dssc_jax.core.native.named_types import named_type
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import Command, Info, Measurement, Params, ReferencePoint, Scalar
from dssc_jax.core.smoothness import not_smooth
from dssc_jax.core.toml import TomlTable
from dssc_jax.models.controllers.library import unloaded
from dssc_jax.models.controllers.nominal import L0

COMMAND_KEY = "command"


class SampledSignals(NamedTuple):
    """The signals that a controller in an FMU can read at a sample.

    Args:
        y: Measured y.
        y_dot: Measured y'.
        y_ref: Reference y_m.
        y_ref_dot: Derivative of the reference.
        y_ref_ddot: Second derivative of the reference.
        error: y_m - y, the negative of the error e of the metrics.
    """

    y: Scalar
    y_dot: Scalar
    y_ref: Scalar
    y_ref_dot: Scalar
    y_ref_ddot: Scalar
    error: Scalar


class FmuController:
    """A controller that an FMU defines, with the variables that a study's table connects.

    Args:
        fmu: The FMU.
        table: The table.

    Raises:
        ConfigError: A variable is not there or cannot be connected, or a signal is unknown.
    """

    def __init__(self, fmu: NativeFmu, table: TomlTable) -> None:
        """Connect the loop's signals to the FMU's variables."""
        self.fmu = fmu
        self.inputs = connections(fmu, table, "inputs", INPUT)
        if not self.inputs:
            rule = f"is required: the FMU's input for each of the signals that it gets, of {', '.join(SIGNALS)}"
            raise ConfigError("inputs", rule)
        for signal, _ in self.inputs:
            if signal not in SIGNALS:
                raise ConfigError(f"inputs.{signal}", f"is no signal of a controller; {nearest(signal, SIGNALS)}")
        require_distinct(self.inputs)
        self.command = connection(fmu, table, COMMAND_KEY, OUTPUT)
        self.outputs = reported_outputs(fmu, table)
        self.parameters = parameter_connections(fmu, table, self.inputs)
        ports = FmuPorts(
            fmu,
            parameters=value_references(self.parameters),
            inputs=value_references(self.inputs),
            outputs=value_references((self.command, *self.outputs)),
        )
        self.functions = FmuFunctions(ports)

    def init(self, gains: Params, measurement: Measurement, reference: ReferencePoint) -> tuple[Scalar, ...]:
        """The state before an instance of the FMU is started: empty words, which :meth:`begin` replaces.

        The empty words hold the place of the instance's handle; parameters and signals do not enter here.
        """
        return empty_words()

    def begin(self, gains: Params, state: tuple[Scalar, ...], lane: Scalar, steps: int) -> tuple[Scalar, ...]:
        """Start an instance with the draw's parameters; return the state at t = 0.

        Args:
            gains: Gains with the FMU's parameters.
            state: The state of :meth:`init`, which is not used.
            lane: Word that tells the draw's instance apart.
            steps: Number of steps of the flight.
        """
        words, _ = self.functions.start(lane, steps, values_of(gains))
        return words

    def step(
        self,
        gains: Params,
        state: tuple[Scalar, ...],
        measurement: Measurement,
        reference: ReferencePoint,
        dt: Scalar,
    ) -> tuple[tuple[Scalar, ...], Command, Info]:
        """One sample: the FMU gets the signals of the sample, makes a step, and its output is the command.

        The whole command is the robust part u, and the nominal part u_n is 0. Other outputs of the FMU that the study
        reports are the info.
        """
        error = reference.y - measurement.y
        signals = SampledSignals(measurement.y, measurement.y_dot, *reference, error)
        inputs = [getattr(signals, signal) for signal, _ in self.inputs]
        words, (command, *outputs) = self.functions.step(state, dt, inputs)
        info: Info = ()
        if outputs:
            report = report_type(tuple(signal for signal, _ in self.outputs))
            info = report(*outputs)
        return words, Command(command, jnp.zeros_like(command)), info

    def controller(self) -> Controller:
        """The controller, an instance of its contract."""
        quantities = {signal: variable.quantity for signal, variable in self.outputs}
        return Controller(
            params_type(self.parameters, "l0", L0, 1.0),
            self.init,
            self.step,
            smooth=not_smooth(WITHOUT_DERIVATIVE),
            info=named_type("Info", quantities, {}) if quantities else None,
            native=self.fmu.file,
            begin=self.begin,
            takes_rate=any(signal == "y_dot" for signal, _ in self.inputs),
        )


SIGNALS = SampledSignals._fields


def loaded_controller(table: TomlTable) -> Controller:
    """The controller of the FMU that a study's table names by file and digest.

    Raises:
        ConfigError: The FMU is not loaded, or a variable is not there or cannot be connected.
    """
    return FmuController(fmu_of(table), table).controller()


FMU_CONTROLLER = Entry(
    {None: unloaded(WITHOUT_DERIVATIVE)},
    "a controller in an FMU for co-simulation; `parameters` sets the FMU's parameters and initial values",
    loaded=loaded_controller,
    keys={
        **FILE_KEYS,
        "inputs": f"table with the FMU's input for each signal that it gets, of {', '.join(SIGNALS)}",
        COMMAND_KEY: "the FMU's output that is the command",
        "outputs": OUTPUTS_KEY,
    },
    native=True,
)
