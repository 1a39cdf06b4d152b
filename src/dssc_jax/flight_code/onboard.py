"""Sampled software on board of a plant, such as the inner loops with the mixer, traced for its C.

Its gains are parameters of the code. All other numbers of the study are constants: one that it reads and that has a law
is refused.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import keystr, tree_flatten_with_path

from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.numerics import arithmetic, as_arrays
from dssc_jax.core.onboard import Onboard
from dssc_jax.core.signals import PlantInput, Scalar, State
from dssc_jax.flight_code.controller import TracedFunction
from dssc_jax.flight_code.parameters import Parameter, loop_parameters
from dssc_jax.lanes.c.names import member_names
from dssc_jax.lanes.tracing.origins import translate_with_origins
from dssc_jax.lanes.unsupported import Unsupported
from dssc_jax.study import Study


@dataclass(frozen=True)
class TracedSoftware:
    """Software on board. The inputs of a function: parameters, laws, readings, held numbers, commands, in this order.

    Args:
        prefix: Prefix of its functions and types in C.
        parameters: Its numbers that may be changed in flight.
        laws: Names of the study's other laws, of which it must read none.
        readings: Names of what it measures, in C.
        state_names: Names of its state in C.
        commands: Names of its commands in C, one for each channel.
        start: Gives the held numbers before the first sample.
        sample: Gives the held numbers after the part that runs at a sample of the loop.
        tick: Gives the held numbers after a tick.
        transfer: Gives the held numbers from which it goes on driving as another software did, and 1 where its limits
            let it do so, else 0; None: it cannot.
        drive_names: Names of the held numbers that drive actuators.
        ticks: Ticks in a sample.
        period: Time between two ticks [s].
        precision: Bits of a number.
        outputs: Sentences on what its results drive.
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
        """The type of its numbers."""
        return np.dtype(f"float{self.precision}")


def without_held(software: Onboard, state: State) -> State:
    """The plant's state with () in place of what the software holds."""
    return software.holding(state, ())


def names_of(tree: Any) -> tuple[str, ...]:
    """A name in C for each leaf of a tree."""
    paths = (keystr(path, simple=True, separator=".") for path, _ in tree_flatten_with_path(tree)[0])
    return tuple(member_names(path.replace(".", "_") for path in paths))


def traced_software(study: Study, name: str) -> TracedSoftware | None:
    """The software on board of a study's plant; None: the study's plant has none.

    Args:
        study: The study, without a sweep.
        name: Its name in C.

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
    count = len(loop.channels)

    def params_of(values: Sequence[Scalar]) -> Any:
        return study.params(dict(zip((*keys, *laws), values, strict=True))).plant

    def start(values: Sequence[Scalar], readings: State) -> State:
        return as_arrays(software.start(params_of(values), readings, None))

    def sample(values: Sequence[Scalar], readings: State, held: State, commands: tuple[Scalar, ...]) -> State:
        params = params_of(values)
        drive = PlantInput(commands, (0.0,) * count, None, quiet_inputs(loop.plant, params))
        state = software.holding(readings, held)
        return as_arrays(software.held(software.sample(params, state, drive, loop.sample_time)))

    def tick(values: Sequence[Scalar], readings: State, held: State) -> State:
        return as_arrays(software.held(software.tick(params_of(values), software.holding(readings, held), period)))

    def transfer(values: Sequence[Scalar], readings: State, driven: tuple[Scalar, ...]) -> State:
        assert software.taken_over is not None  # traced only if there is one
        return as_arrays(software.taken_over(params_of(values), readings, driven, loop.sample_time))

    try:
        with arithmetic(study.config.loop.precision):
            number = jax.ShapeDtypeStruct((), jnp.result_type(float))
            values = (number,) * (len(keys) + len(laws))
            plant_state = jax.eval_shape(lambda at: as_arrays(loop.plant.init(params_of(at))), values)
            estimation = loop.mimo_plant.estimation
            if estimation is not None and estimation.is_enabled(study.template.plant):
                plant_state = jax.eval_shape(
                    lambda at: as_arrays(estimation.estimated_state(study.template.plant, at)), plant_state
                )
            readings = jax.tree.map(lambda leaf: number, without_held(software, plant_state))
            held = jax.tree.map(lambda leaf: number, software.held(plant_state))
            commands = (number,) * count
            traced_start = traced_function(start, values, readings)
            traced_sample = traced_function(sample, values, readings, held, commands)
            traced_tick = traced_function(tick, values, readings, held)
            state_names = names_of(held)
            drive_names = tuple(held_name for held_name in state_names if held_name.startswith(f"{software.drives}_"))
            traced_transfer = None
            if software.taken_over is not None:
                traced_transfer = traced_function(transfer, values, readings, (number,) * len(drive_names))
    except Unsupported as problem:
        raise ConfigError("plant", f"its software has no exact form in C: {problem}") from None
    command_names = member_names(channel or "command" for channel in loop.channels)
    reading_names = names_of(readings)
    directions = []
    for field in software.directions:
        directions.append(tuple(reading for reading in reading_names if reading.startswith(f"{field}_")))
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
        directions=tuple(directions),
    )


def software_parameters(study: Study, software: Onboard) -> tuple[Parameter, ...]:
    """The numbers of the software that its C may change in flight."""

    def belongs(path: str) -> bool:
        slot, field, *_ = [*path.split("."), ""]
        return slot == "plant" and field in software.tunable

    def name(key: str) -> str:
        """The fields of a number behind the plant, and behind the first of the fields, that of the gains."""
        _, field, *fields = key.split(".")
        return "_".join(fields if field == software.tunable[0] else [field, *fields])

    return loop_parameters(study, belongs, name)


def traced_function(function: Callable[..., State], *shapes: Any) -> TracedFunction:
    """A function of the software, traced."""
    program, _, origins = translate_with_origins(function, *shapes)
    return TracedFunction(program, origins)
