"""The signals that controllers and plant report at a sample beside their results, found without a simulation."""

import jax

from dssc_jax.closed_loop.control import control, initial_control, measure
from dssc_jax.closed_loop.loop import Loop, LoopParams
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.named import signals_in
from dssc_jax.core.numerics import as_arrays
from dssc_jax.core.signals import Info


def first_infos(loop: Loop, params: LoopParams) -> tuple[tuple[Info, ...], Info]:
    """What each channel's controller reports, and what the plant reports, at the first sample without noise.

    A study reads only the names and types of the reported fields. Therefore channels with the same models share one
    info, even if their parameters have different values.
    """
    plant = as_arrays(loop.plant.init(params.plant))
    references = loop.mimo_reference.at(params.reference, 0.0)
    exact = measure(loop, params, plant, references)
    measurements = tuple(m._replace(signals=(0.0,) * len(loop.measures)) for m in exact)
    info_by_models: dict[object, Info] = {}
    infos = []
    for i in range(len(loop.channels)):
        models = loop.differentiator[i], loop.controller[i], jax.tree.structure(params.controller[i])
        if models not in info_by_models:
            start = as_arrays(initial_control(loop, params, i, measurements[i], references[i]))
            _, controlled = control(loop, params, i, start, measurements[i], references[i])
            info_by_models[models] = controlled.info
        infos.append(info_by_models[models])
    wind = loop.wind.value(params.wind, loop.wind.init(params.wind, jax.random.key(0)), 0.0)
    drive = loop.zero_input(params.plant)._replace(wind=wind, condition=loop.condition(params, 0.0))
    return tuple(infos), loop.mimo_plant.monitor(params.plant, plant, drive)


def fields_of(info: Info, part: str) -> tuple[str, ...]:
    """Names of the signals that a part reports in its info.

    Args:
        info: A NamedTuple of signals, or () if the part reports nothing.
        part: The part, such as ``plant``, for the message.

    Raises:
        ConfigError: The info has another form.
    """
    is_namedtuple = hasattr(info, "_fields")
    if not is_namedtuple and info != ():
        rule = "must report a NamedTuple as its info, or () for nothing"
        raise ConfigError(part, rule)
    return tuple(signals_in(info))
