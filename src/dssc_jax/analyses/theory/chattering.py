"""Oscillations over the time constant of unmodelled dynamics: simulated, and predicted by a describing function."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from dssc_jax.analyses.theory.describing import limit_cycles
from dssc_jax.analyses.theory.linearised import at_rest
from dssc_jax.core.errors import ConfigError
from dssc_jax.core.quantities import unit_and_meaning
from dssc_jax.engine.batching import medians
from dssc_jax.runs import run as running
from dssc_jax.study import Study
from dssc_jax.study.actuators import kind_in, section_of

SAMPLES_IN_MU = 20  # samples in the smallest time constant: fewer, and the clock chatters rather than the dynamics


def time_constant_of(study: Study) -> str:
    """Dotted name of the time constant that the unmodelled dynamics declare, such as ``unmodelled.mu``.

    Raises:
        ConfigError: The unmodelled dynamics declare no time constant.
    """
    path = f"unmodelled.0.{study.loop.unmodelled[0].time_constant}"  # within the loop's parameters; 0: only channel
    for name, number in study.numbers.items():
        if path in number.paths:
            return name
    rule = "chattering needs dynamics with a time constant, and with one only, such as a lag"
    raise ConfigError(f"{study.source}: {section_of(study.config, 'unmodelled')}.kind", rule)


def chattering(study: Study, values: Sequence[float], *, push: float, after: float) -> xr.Dataset:
    """Simulate and predict the oscillation of sigma after a small push, over the time constant of unmodelled dynamics.

    Apart from the push the loop is at rest, and uncertain numbers have the medians of their laws.

    Args:
        study: A study of one channel whose unmodelled dynamics declare ``time_constant``, such as a lag.
        values: Time constants mu [s].
        push: Initial output, in the unit of the output.
        after: Time after which oscillations have settled or decayed [s].

    Returns:
        A dataset along the time constant, a dimension with its dotted name. ``amplitude`` is the largest simulated
        |sigma| after the time ``after``. ``predicted`` and ``frequency`` are amplitude and frequency by the describing
        function; NaN if the controller has none or no oscillation is predicted.

    Raises:
        ConfigError: The unmodelled dynamics have no time constant, or T_s exceeds a 20th of the smallest mu.
    """
    mu = time_constant_of(study)
    longest = min(values) / SAMPLES_IN_MU
    if study.config.loop.sample_time > longest * (1 + 1e-9):
        raise ConfigError(f"{study.source}: loop.sample_time", f"must be <= {longest:g}, a 20th of mu")
    resting = at_rest(study)
    changes = {
        "plant.initial": [push, 0.0],
        "draws": 1,
        "requirement": [],
        "metrics": {"after": after, "names": ["sigma_max"]},
        "sweep": {mu: [float(value) for value in values]},
    }
    result = running.run(resting.override({**medians(resting), **changes}))
    simulated_amplitude = result.dataset["sigma_max"].values[:, 0]  # 0: the only draw
    predicted_amplitude = np.full(len(values), np.nan)
    predicted_frequency = np.full(len(values), np.nan)
    if study.loop.controller[0].describing is not None:
        for place, cycle in enumerate(limit_cycles(resting, [{mu: value} for value in values])):
            if cycle is not None:
                predicted_amplitude[place] = cycle.amplitude
                predicted_frequency[place] = cycle.frequency
    unit = study.units[0].of("y/s")
    return xr.Dataset(
        {
            "amplitude": ((mu,), simulated_amplitude, unit_and_meaning(unit, "largest |sigma| of what is left")),
            "predicted": ((mu,), predicted_amplitude, unit_and_meaning(unit, "amplitude by describing function")),
            "frequency": ((mu,), predicted_frequency, unit_and_meaning("rad/s", "frequency by describing function")),
        },
        coords={mu: ((mu,), np.asarray(values, float), unit_and_meaning("s", "time constant mu"))},
        attrs={"controller": kind_in(study.config, "controller"), "push": push},
    )
