"""The signals that controllers and plant report at a sample, found without a simulation."""

import jax

from dssc_jax.closed_loop.control import control, initial_control, measure
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.named import signals_in
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.signals import Info


def first_infos(loop: Loop, params: LoopParams) -> tuple[tuple[Info, ...], Info]:
    """The info of each channel's controller, and of the plant, at the first sample of a loop at rest without noise.

    Only the names of the fields matter, so channels that differ in numbers alone share one info.
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
    wind = loop.wind.value(params.wind, loop.wind.init(params.wind, jax.random.key(0)), 0.0)
    drive = loop.zero_input(params.plant)._replace(wind=wind, condition=loop.condition(params, 0.0))
    return tuple(infos), loop.mimo_plant.monitor(params.plant, plant, drive)


def fields_of(info: Info, part: str) -> tuple[str, ...]:
    """Names of the signals in an info; ``part`` is the part that reports it, for the message.

    Raises:
        ConfigError: The info is neither a NamedTuple nor an empty tuple.
    """
    if not hasattr(info, "_fields") and info != ():
        rule = "must report a NamedTuple as its info, or () for nothing"
        raise ConfigError(part, rule)
    return tuple(signals_in(info))
