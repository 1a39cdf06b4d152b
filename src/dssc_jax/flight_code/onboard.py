"""Sampled software on board of a plant, such as the inner loops with the mixer, traced to be written as C.

The gains of the software are parameters of the code. All other numbers of the study are constants of the code, so a
number with a law is refused if the software reads it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.onboard import Onboard
from dssc_jax.core.signals import PlantInput, Scalar, State
from dssc_jax.flight_code.controller import TracedFunction, leaf_names, traced_function
from dssc_jax.flight_code.parameters import Parameter, loop_parameters
from dssc_jax.lanes.c.names import member_names
from dssc_jax.lanes.unsupported import Unsupported
from dssc_jax.study import Study


@dataclass(frozen=True)
class TracedSoftware:
    """Traced software on board.

    The inputs of each function begin with the parameters, the numbers with laws and the readings, in this order. Below,
    three dots stand for these inputs.

    Args:
        prefix: Prefix of its functions and types in C.
        parameters: Numbers that may be changed in flight.
        laws: Names of the numbers that have a law in the study and are no parameters; the software must not read them,
            because the C has them as constants.
        readings: Names of its measurements in C.
        state_names: Names of its states in C.
        commands: Names of its commands in C, one for each channel.
        start: ``(...) -> states`` before the first sample.
        sample: ``(..., states, commands) -> states`` after the part that runs at a sample of the loop.
        tick: ``(..., states) -> states`` after a tick.
        transfer: ``(..., drives) -> (states, feasible)``: states from which the software goes on driving the actuators
            as another one did, and 1 if its limits allow this, else 0; None: no handover is possible.
        drive_names: Names of the states that drive actuators.
        ticks: Number of ticks in a sample.
        period: Time between two ticks [s].
        precision: Bits of a number.
        outputs: Sentences for the documentation: what its results drive.
        directions: Names of the readings of each vector of length 1.
    """

    prefix: str
    parameters: tuple[Parameter, ...]
    laws: tuple[str, ...]
    readings: tuple[str, ...]
    state_names: tuple[str, ...]
    commands: tuple[str, ...]
    start: TracedFunction
    sample: TracedFunction
    tick: TracedFunction
    transfer: TracedFunction | None
    drive_names: tuple[str, ...]
    ticks: int
    period: float
    precision: int
    outputs: tuple[str, ...]
    directions: tuple[tuple[str, ...], ...]

    @property
    def real(self) -> np.dtype:
        """The dtype of its numbers."""
        return np.dtype(f"float{self.precision}")


def without_software(software: Onboard, state: State) -> State:
    """The plant's state without the software's part, which leaves the software's measurements.

    Args:
        software: The software on board.
        state: The plant's state.
    """
    return software.holding(state, ())  # (): nothing held


class SoftwareFunctions(NamedTuple):
    """The functions of software on board, of trees of scalars, before they are traced.

    Args:
        params_of: ``(numbers) -> parameters of the plant``, from the parameters and the numbers with laws.
        start: Computes the states before the first sample. The arguments of this function and of the next ones are
            those in :class:`TracedSoftware`.
        sample: Computes the states after the part that runs at a sample of the loop.
        tick: Computes the states after a tick.
        transfer: Computes the states for a takeover in flight; to be called only if the software can take over.
    """

    params_of: Callable[[Sequence[Scalar]], Any]
    start: Callable[..., State]
    sample: Callable[..., State]
    tick: Callable[..., State]
    transfer: Callable[..., State]


def software_functions(study: Study, software: Onboard, period: float, names: Sequence[str]) -> SoftwareFunctions:
    """The functions of the software on board of a study's plant.

    Args:
        study: The study.
        software: The software.
        period: Time between two ticks [s].
        names: Names of the numbers with which each function begins.
    """
    loop = study.loop

    # Generated C would repeat docstrings of these functions; the type of the result tells what they compute.

    def params_of(values: Sequence[Scalar]) -> Any:
        return study.params(dict(zip(names, values, strict=True))).plant

    def start(values: Sequence[Scalar], readings: State) -> State:
        return as_arrays(software.start(params_of(values), readings, None))

    def sample(values: Sequence[Scalar], readings: State, held: State, commands: tuple[Scalar, ...]) -> State:
        params = params_of(values)
        drive = PlantInput(commands, (0.0,) * len(commands), None, quiet_inputs(loop.plant, params))
        state = software.holding(readings, held)
        return as_arrays(software.held(software.sample(params, state, drive, loop.sample_time)))

    def tick(values: Sequence[Scalar], readings: State, held: State) -> State:
        return as_arrays(software.held(software.tick(params_of(values), software.holding(readings, held), period)))

    def transfer(values: Sequence[Scalar], readings: State, driven: tuple[Scalar, ...]) -> State:
        assert software.taken_over is not None  # traced only if there is one
        return as_arrays(software.taken_over(params_of(values), readings, driven, loop.sample_time))

    return SoftwareFunctions(params_of, start, sample, tick, transfer)


def traced_software(study: Study, name: str) -> TracedSoftware | None:
    """Trace the software on board of a study's plant; None if the plant has none.

    Args:
        study: The study, without a sweep.
        name: Name of the study in C.

    Raises:
        ConfigError: An operation has no exact form in C.
    """
    loop = study.loop
    software = loop.mimo_plant.software
    period = None if software is None else software.period(study.template.plant)
    if software is None or period is None:
        return None
    parameters = software_parameters(study, software)
    keys = [parameter.key for parameter in parameters]
    laws = tuple(sorted(set(study.laws).difference(keys)))
    functions = software_functions(study, software, period, (*keys, *laws))
    try:
        with arithmetic(study.config.loop.precision):
            number = jax.ShapeDtypeStruct((), jnp.result_type(float))
            values = (number,) * (len(keys) + len(laws))
            params_of = functions.params_of
            true_state = jax.eval_shape(lambda numbers: as_arrays(loop.plant.init(params_of(numbers))), values)
            plant_state = estimated_shape(study, true_state)
            readings = jax.tree.map(lambda leaf: number, without_software(software, plant_state))
            held = jax.tree.map(lambda leaf: number, software.held(plant_state))
            commands = (number,) * len(loop.channels)
            traced_start, _ = traced_function(functions.start, values, readings)
            traced_sample, _ = traced_function(functions.sample, values, readings, held, commands)
            traced_tick, _ = traced_function(functions.tick, values, readings, held)
            state_names = leaf_names(held)
            drive_names = names_in_field(state_names, software.drives)
            traced_transfer = None
            if software.taken_over is not None:
                drives = (number,) * len(drive_names)
                traced_transfer, _ = traced_function(functions.transfer, values, readings, drives)
    except Unsupported as problem:
        raise ConfigError("plant", f"its software has no exact form in C: {problem}") from None
    command_names = member_names(channel or "command" for channel in loop.channels)
    reading_names = leaf_names(readings)
    return TracedSoftware(
        prefix=f"{name}_inner_loop",
        parameters=parameters,
        laws=laws,
        readings=reading_names,
        state_names=state_names,
        commands=tuple(command_names),
        start=traced_start,
        sample=traced_sample,
        tick=traced_tick,
        transfer=traced_transfer,
        drive_names=drive_names,
        ticks=round(loop.sample_time / period),
        period=period,
        precision=study.config.loop.precision,
        outputs=software.outputs(study.template.plant),
        directions=tuple(names_in_field(reading_names, field) for field in software.directions),
    )


def estimated_shape(study: Study, true_state: State) -> State:
    """Shapes and dtypes of the plant's state as its estimator reports it; of the true state without an estimator.

    Args:
        study: The study.
        true_state: Shapes and dtypes of the plant's true state.
    """
    params = study.template.plant
    estimation = study.loop.mimo_plant.estimation
    if estimation is None or not estimation.is_enabled(params):
        return true_state
    return jax.eval_shape(lambda state: as_arrays(estimation.estimated_state(params, state)), true_state)


def names_in_field(names: Sequence[str], field: str) -> tuple[str, ...]:
    """The names in C of a field's leaves, which begin with the field: FIELD_1, FIELD_2, ..."""
    return tuple(name for name in names if name.startswith(f"{field}_"))


def software_parameters(study: Study, software: Onboard) -> tuple[Parameter, ...]:
    """The numbers of the software that may be changed in flight.

    They are the numbers in the fields that the software declares as tunable.

    Args:
        study: The study.
        software: The software on board.
    """
    gains, *_ = software.tunable or ("",)  # the field with the gains comes first

    def is_tunable(path: str) -> bool:
        """Whether a number of the loop belongs to a tunable field of the plant; a path is SLOT.FIELD..."""
        slot, _, path_in_slot = path.partition(".")
        field = path_in_slot.partition(".")[0]
        return slot == "plant" and field in software.tunable

    def name_in_c(key: str) -> str:
        """The name in C of a number: its path without the plant and, for gains, without their field."""
        _, field, *fields = key.split(".")
        return "_".join(fields if field == gains else [field, *fields])

    return loop_parameters(study, is_tunable, name_in_c)
