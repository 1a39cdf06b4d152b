"""What controllers and plant report at a sample, without simulating one."""

import jax

from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.closed_loop.sample import as_arrays, control, initial_control, measure
from dssc_jax.core.adapters import quiet_inputs
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.events import condition_at
from dssc_jax.core.named import signals_in
from dssc_jax.core.signals import Info, PlantInput, Signals


def first_infos(loop: Loop, params: LoopParams) -> tuple[tuple[Info, ...], Info]:
    """The info of each channel's controller, and of the plant, at the first sample of a loop at rest without noise.

    Channels that differ in numbers alone share one info; only its form is of use.
    """
    plant = as_arrays(loop.plant.init(params.plant))
    references = loop.mimo_reference.at(params.reference, 0.0)
    exact = measure(loop, params, plant, references)
    measurements = tuple(m._replace(signals=(0.0,) * len(loop.measures)) for m in exact)
    forms: dict[object, Info] = {}
    infos = []
    for i in range(len(loop.channels)):
        form = loop.differentiator[i], loop.controller[i], jax.tree.structure(params.controller[i])
        if form not in forms:
            start = as_arrays(initial_control(loop, params, i, measurements[i], references[i]))
            forms[form] = control(loop, params, i, start, measurements[i], references[i])[1].info
        infos.append(forms[form])
    zeros: Signals = (0.0,) * len(loop.channels)
    wind = loop.wind.value(params.wind, loop.wind.init(params.wind, jax.random.key(0)), 0.0)
    condition = condition_at(loop.events, params.events, 0.0, loop.sample_time, loop.rotors)
    drive: PlantInput[Signals] = PlantInput(zeros, zeros, wind, quiet_inputs(loop.plant, params.plant), condition)
    return tuple(infos), loop.mimo_plant.monitor(params.plant, plant, drive)


def fields_of(info: Info, part: str) -> tuple[str, ...]:
    """Names of an info's fields.

    Raises:
        ConfigError: it is neither a NamedTuple nor an empty tuple.
    """
    if not hasattr(info, "_fields") and info != ():
        rule = "must report a NamedTuple as its info, or () for nothing"
        raise ConfigError(part, rule)
    return tuple(signals_in(info))
