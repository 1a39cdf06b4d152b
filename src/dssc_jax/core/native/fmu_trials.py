"""Trial flights, which find out whether an FMU keeps numbers outside of its instances."""

from collections.abc import Sequence
from itertools import product
from math import inf

import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native.fmi import WARNING, FmiError
from dssc_jax.core.native.fmu import INPUT, OUTPUT, NativeFmu, failure
from dssc_jax.core.native.fmu_instances import references

TRIAL_STEPS = 64  # of a trial flight
TRIAL_STEP = 0.01
"""Length of the steps of a trial flight if the FMU states none [s]."""


def require_independent(fmu: NativeFmu) -> None:
    """Require that an FMU starts, and that two instances of it do not disturb each other.

    Two trial flights must give the same bits whether they run one after the other or in turn, step by step. The first
    flight must give the same bits again when it is repeated.

    Raises:
        ConfigError: The FMU does not start, or its instances disturb each other.
    """
    try:
        first = trial_outputs(fmu, [0])
        second = trial_outputs(fmu, [1])
        alternating = trial_outputs(fmu, [0, 1])
        repeated_first = trial_outputs(fmu, [0])
    except FmiError as error:
        raise failure(fmu, error) from None
    if alternating != first + second or repeated_first != first:
        rule = "keeps numbers outside of its instances (static or global variables), which would mix the draws"
        raise ConfigError("file", f"'{fmu.file}' {rule}; export it without them")


def trial_outputs(fmu: NativeFmu, flights: Sequence[int]) -> list[bytes]:
    """Fly some trial flights in turn, step by step, with inputs that oscillate.

    Args:
        fmu: The FMU.
        flights: Numbers of the flights; the inputs of a flight depend on its number.

    Returns:
        The bits of all outputs of each flight, up to its first step that fails.

    Raises:
        FmiError: An instance does not start.
    """
    calls = fmu.calls
    inputs = fmu.references_with(INPUT)
    h = fmu.step_size or TRIAL_STEP
    outputs = {flight: bytearray() for flight in flights}
    instances: dict[int, int] = {}
    try:
        for flight in flights:
            instances[flight] = calls.instantiate(f"trial {flight}")
            calls.initialise(instances[flight])
        ended_flights: set[int] = set()
        for k, flight in product(range(TRIAL_STEPS), flights):
            if flight in ended_flights:
                continue
            angles = np.arange(1.0, 1.0 + len(inputs)) * (0.1 * k + flight + 1.0)
            signals = np.cos(angles)
            values = trial_step(fmu, instances[flight], k * h, h, signals)
            if values is None:
                ended_flights.add(flight)
            else:
                outputs[flight] += values.tobytes()
    finally:
        for address in instances.values():
            calls.free(address)
    return [bytes(outputs[flight]) for flight in flights]


def trial_step(fmu: NativeFmu, address: int, t: float, h: float, signals: np.ndarray) -> np.ndarray | None:
    """Make a step of an instance in a trial flight: set its inputs, advance, and read its outputs.

    Args:
        fmu: The FMU.
        address: Address of the instance.
        t: Time at the start of the step [s].
        h: Length of the step [s].
        signals: Values of all inputs, float64.

    Returns:
        The values of all outputs; None if a call fails.
    """
    calls = fmu.calls
    inputs = fmu.references_with(INPUT)
    outputs = fmu.references_with(OUTPUT)
    values = np.full(len(outputs), inf)
    if inputs:
        status = calls.set_reals(address, references(inputs), len(inputs), signals.ctypes.data)
        if status > WARNING:
            return None
    if not calls.step(address, t, h):
        return None
    if outputs:
        status = calls.get_reals(address, references(outputs), len(outputs), values.ctypes.data)
        if status > WARNING:
            return None
    return values
