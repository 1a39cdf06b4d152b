"""A plant in an FMU, which makes a step between two samples by its own solver, with constant command.

In units, y stands for the unit of the plant's output, and u for the unit of its command.
"""

from collections.abc import Sequence
from math import nan
from typing import Annotated, Any, NamedTuple, NoReturn

from dssc_jax.core.contracts import Plant
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.named import report_type
from dssc_jax.core.native.fmu import INPUT, OUTPUT, NativeFmu
from dssc_jax.core.native.fmu_instances import FmuFunctions, FmuPorts, empty_words
from dssc_jax.core.native.fmu_tables import (
    FILE_KEYS,
    OUTPUTS_KEY,
    WITHOUT_DERIVATIVE,
    Connection,
    connection,
    connections,
    fmu_of,
    named_signals,
    parameter_connections,
    params_type,
    reported_outputs,
    require_distinct,
    value_references,
    values_of,
)
from dssc_jax.core.quantities import Quantity
from dssc_jax.core.registry import Entry
from dssc_jax.core.signals import Info, Measurement, Params, PlantInput, Scalar, Signals
from dssc_jax.core.smoothness import not_smooth
from dssc_jax.core.toml import TomlTable
from dssc_jax.core.units import COMMAND, ChannelUnits
from dssc_jax.core.units import OUTPUT as OUTPUT_UNIT

K_P = Quantity("y/(s^2 u)", "high-frequency gain k_p; absent: metrics that need it are NaN")
COMMAND_KEY = "command"
DISTURBANCE_KEY = "disturbance"
INPUTS_KEY = "inputs"
Y_KEY = "y"
RATE_KEY = "y_dot"


class FmuPlantParams(NamedTuple):
    """Parameters of a plant in an FMU.

    When the FMU is known, its own parameters are one more field.
    """

    k_p: Annotated[Scalar | None, K_P] = None


class FmuState(NamedTuple):
    """State of a plant in an FMU, as far as it is outside of the FMU's instance.

    Args:
        words: Handle of the instance, and number of steps that it has made.
        y: Output.
        y_dot: Derivative of the output.
        outputs: Additional outputs that the study reports.
    """

    words: tuple[Scalar, ...]
    y: Scalar
    y_dot: Scalar
    outputs: tuple[Scalar, ...]


class FmuPlant:
    """A plant that an FMU defines, with the variables that a study's table connects.

    Args:
        fmu: The FMU.
        table: The table.

    Raises:
        ConfigError: A variable is not there or cannot be connected.
    """

    def __init__(self, fmu: NativeFmu, table: TomlTable) -> None:
        """Connect the loop's signals to the FMU's variables; ``disturbance`` and ``y_dot`` are optional."""
        self.fmu = fmu
        self.command = connection(fmu, table, COMMAND_KEY, INPUT)
        self.disturbance_input = connection(fmu, table, DISTURBANCE_KEY, INPUT) if DISTURBANCE_KEY in table else None
        self.inputs = tuple(sorted(connections(fmu, table, INPUTS_KEY, INPUT)))
        self.y = connection(fmu, table, Y_KEY, OUTPUT)
        self.rate_output = connection(fmu, table, RATE_KEY, OUTPUT) if RATE_KEY in table else None
        self.outputs = reported_outputs(fmu, table)
        require_distinct(self.connected_inputs)
        self.parameters = parameter_connections(fmu, table, self.connected_inputs)
        rate = () if self.rate_output is None else (self.rate_output,)
        outputs = (self.y, *rate, *self.outputs)
        ports = FmuPorts(
            fmu,
            parameters=value_references(self.parameters),
            inputs=value_references(self.connected_inputs),
            outputs=value_references(outputs),
        )
        self.functions = FmuFunctions(ports)

    @property
    def connected_inputs(self) -> tuple[Connection, ...]:
        """The inputs that are set before each step.

        They are the command, the disturbance if it has an input of its own, and the named inputs.
        """
        disturbance = () if self.disturbance_input is None else (self.disturbance_input,)
        return (self.command, *disturbance, *self.inputs)

    @property
    def units(self) -> ChannelUnits:
        """Units and meanings of output and command; for a unit that the FMU does not state, the symbol y or u."""
        output = self.y.variable.quantity
        command = self.command.variable.quantity
        return ChannelUnits(output.unit or OUTPUT_UNIT, command.unit or COMMAND, output.meaning, command.meaning)

    def init(self, params: Params) -> FmuState:
        """Return the state before an instance of the FMU is started, which :meth:`begin` replaces."""
        return FmuState(empty_words(), y=0.0, y_dot=0.0, outputs=(0.0,) * len(self.outputs))

    def begin(self, params: Params, state: FmuState, lane: Scalar, steps: int) -> FmuState:
        """Start an instance with the draw's parameters; return the state at t = 0.

        Args:
            params: Parameters, among them the FMU's.
            state: The state of :meth:`init`, whose y' is kept if no output gives y'.
            lane: Word that tells the draw's instance apart.
            steps: Number of steps of the flight.
        """
        words, values = self.functions.start(lane, steps, values_of(params))
        y, y_dot, outputs = self.split_outputs(values)
        return FmuState(words, y, state.y_dot if y_dot is None else y_dot, outputs)

    def advance(self, params: Params, state: FmuState, drive: PlantInput[Scalar], t: Scalar, h: float) -> FmuState:
        """Advance the FMU by one step of length h [s] under constant input.

        A disturbance without an input of its own is added to the command. Without an output for y', y' is the
        difference quotient of y over the step. The FMU keeps its own time, so that ``t`` is not used.
        """
        command = drive.command if self.disturbance_input else drive.command + drive.disturbance
        inputs: Signals = drive.inputs or (0.0,) * len(self.inputs)
        disturbance = (drive.disturbance,) if self.disturbance_input else ()
        words, values = self.functions.step(state.words, h, (command, *disturbance, *inputs))
        y, y_dot, outputs = self.split_outputs(values)
        return FmuState(words, y, (y - state.y) / h if y_dot is None else y_dot, outputs)

    def split_outputs(self, values: Sequence[Scalar]) -> tuple[Scalar, Scalar | None, tuple[Scalar, ...]]:
        """Split the connected outputs into y, y' and the additional outputs; y' is None if no output gives it."""
        y, *others = values
        if self.rate_output is None:
            return y, None, tuple(others)
        y_dot, *outputs = others
        return y, y_dot, tuple(outputs)

    def report(self, params: Params, state: FmuState, drive: PlantInput[Scalar]) -> Info:
        """Report the additional outputs by their names in the study; () if there are none.

        Parameters and input are not used: the state has the outputs of the last step.
        """
        if not self.outputs:
            return ()
        report = report_type(tuple(signal for signal, _ in self.outputs))
        return report(*state.outputs)

    def plant(self) -> Plant:
        """Make the plant, an instance of its contract."""
        return Plant(
            params_type(self.parameters, "k_p", K_P, None),
            self.init,
            no_derivative,
            measure=lambda params, state, drive: Measurement(state.y, state.y_dot),
            input_gain=input_gain,
            units=(self.units,),
            monitor=self.report,
            smooth=not_smooth(WITHOUT_DERIVATIVE),
            outputs=lambda params: named_signals(self.outputs),
            inputs=lambda params: named_signals(self.inputs),
            advance=self.advance,
            begin=self.begin,
            native=self.fmu.file,
        )


def input_gain(params: Params) -> Scalar:
    """Return the high-frequency gain k_p that the study states [y/(s^2 u)]; NaN if it states none."""
    return nan if params.k_p is None else params.k_p


def no_derivative(params: Params, state: FmuState, drive: PlantInput[Scalar], t: Scalar) -> NoReturn:
    """Refuse to give the derivative of the state, which is inside the FMU.

    Raises:
        ConfigError: Always.
    """
    raise ConfigError("plant", WITHOUT_DERIVATIVE)


def loaded_plant(table: TomlTable) -> Plant:
    """Make the plant of the FMU that a study's table names by file and digest.

    Raises:
        ConfigError: The FMU is not loaded, or a variable is not there or cannot be connected.
    """
    return FmuPlant(fmu_of(table), table).plant()


UNLOADED = Plant(
    FmuPlantParams,
    init=lambda params: FmuState(empty_words(), y=0.0, y_dot=0.0, outputs=()),
    derivative=no_derivative,
    measure=lambda params, state, drive: Measurement(state.y, state.y_dot),
    input_gain=input_gain,
    smooth=not_smooth(WITHOUT_DERIVATIVE),
    native="a file",
)
"""Stands for the kind in lists of kinds, where no file is known; no study gets it."""

FMU_KEYS: dict[str, Any] = {
    **FILE_KEYS,
    COMMAND_KEY: "the FMU's input that is the command",
    Y_KEY: "the FMU's output that is y",
    RATE_KEY: "the FMU's output that is y'; absent: the difference quotient of y over the last step",
    DISTURBANCE_KEY: "the FMU's input that is the disturbance beside the command; absent: it is added to the command",
    INPUTS_KEY: "table of inputs of disturbances: the FMU's variable for each name in the study",
    "outputs": OUTPUTS_KEY,
}

FMU_PLANT = Entry(
    {None: UNLOADED},
    "a plant in an FMU for co-simulation; `parameters` sets the FMU's parameters and initial values",
    loaded=loaded_plant,
    keys=FMU_KEYS,
    native=True,
)
