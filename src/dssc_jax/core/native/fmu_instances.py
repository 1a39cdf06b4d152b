"""Instances of an FMU, one for each draw, and the functions by which lanes start and step them.

An instance has hidden state, so a step is no pure function. What a lane carries is therefore a handle and the number of
steps that were made. A step is made only from the number that its instance has reached, so that it cannot be made twice
or left out unseen. The instance begins at the start of the draw, with the draw's parameters, and no other lane has its
handle. So a draw's numbers depend neither on other draws nor on the order or the number of threads in which they run.

An instance that fails, or that gets an input that is not finite, is freed; all its further outputs are NaN, and the
draw ends as one that diverges.
"""

import ctypes
import hashlib
import struct
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product
from math import inf, isfinite, nan

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native.fmi import FmiError, required
from dssc_jax.core.native.fmu import NativeFmu, failure
from dssc_jax.core.signals import Scalar
from dssc_jax.lanes import foreign
from dssc_jax.lanes.foreign import ForeignFunction, MemoryPlace, call

MOST_INSTANCES = 1 << 15
"""Instances of an FMU that are kept at once; those of draws that ended early are freed last used first."""

MOST_HANDLES = 1 << 32
NO_INSTANCE = 0
"""The handle of a draw whose instance has failed."""

HEAD = 16
"""Bytes before the numbers of a call: two words, and the length of a step."""

NUMBER = 8
WORD = np.dtype(np.uint32)
REAL = np.dtype(np.float64)

TRIED_STEPS = 64
TRIED_STEP = 0.01
"""Length of the steps of a trial if the FMU states none [s]."""

Words = tuple[jax.Array, jax.Array]
"""What a lane carries: the handle and the number of steps made."""

FAULTS: list[str] = []
"""What went wrong in this process that no outcome of a draw can tell."""


@dataclass(frozen=True)
class FmuPorts:
    """The variables of an FMU that a study connects.

    Args:
        fmu: The FMU.
        parameters: Value references of what is set before t = 0.
        inputs: Value references of what is set before each step.
        outputs: Value references of what is read at t = 0 and after each step.
    """

    fmu: NativeFmu
    parameters: tuple[int, ...]
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]

    def symbol(self, function: str) -> str:
        """A name for a function in compiled lanes, which binds them to the FMU's content and the ports."""
        ports = repr((self.parameters, self.inputs, self.outputs)).encode()
        return f"dssc_jax_fmu_{self.fmu.sha256}_{hashlib.sha256(ports).hexdigest()[:16]}_{function}"


class Instance:
    """An instance: its address, how many steps it has made, and how many its flight has."""

    __slots__ = ("address", "step_count", "steps")

    def __init__(self, address: int, steps: int) -> None:
        self.address = address
        self.step_count = 0
        self.steps = steps


class Instances:
    """The instances of an FMU with the same ports.

    Args:
        ports: The FMU and its connected variables.
    """

    def __init__(self, ports: FmuPorts) -> None:
        self.ports = ports
        self.calls = ports.fmu.calls
        self._running: OrderedDict[int, Instance] = OrderedDict()
        self._finished: list[int] = []
        self._dropped: set[int] = set()
        self._last = NO_INSTANCE
        self._lock = threading.Lock()
        self._parameters = references(ports.parameters)
        self._inputs = references(ports.inputs)
        self._outputs = references(ports.outputs)
        self._start_head = struct.Struct("=II")
        self._step_head = struct.Struct(f"=IId{len(ports.inputs)}d")
        self._none = struct.pack(f"={len(ports.outputs)}d", *[nan] * len(ports.outputs))
        self.functions = {
            "start": ctypes.CFUNCTYPE(None, ctypes.c_void_p)(self.start),
            "step": ctypes.CFUNCTYPE(None, ctypes.c_void_p)(self.step),
        }

    def start(self, memory: int) -> None:
        """Begin a draw: from steps and parameters to handle and outputs."""
        _, steps = self._start_head.unpack(ctypes.string_at(memory, self._start_head.size))
        outputs = memory + HEAD + NUMBER * len(self._parameters)
        handle = NO_INSTANCE
        with self._lock:
            self._free_finished()
            try:
                instance = Instance(self._begun(memory + HEAD), steps)
                handle = self._kept(instance)
                self._read(instance.address, outputs)
            except FmiError:
                self._close(handle)
                handle = NO_INSTANCE
                ctypes.memmove(outputs, self._none, len(self._none))
        ctypes.memmove(memory, self._start_head.pack(handle, 0), self._start_head.size)

    def step(self, memory: int) -> None:
        """Make a step: from handle, step count, length and inputs to handle, step count and outputs."""
        handle, step_count, h, *inputs = self._step_head.unpack(ctypes.string_at(memory, self._step_head.size))
        outputs = memory + HEAD + NUMBER * len(self._inputs)
        if self._stepped(handle, step_count, h, inputs, memory, outputs):
            ctypes.memmove(memory, self._start_head.pack(handle, step_count + 1), self._start_head.size)
            return
        ctypes.memmove(outputs, self._none, len(self._none))
        ctypes.memmove(memory, self._start_head.pack(NO_INSTANCE, step_count + 1), self._start_head.size)

    def _stepped(
        self, handle: int, step_count: int, h: float, inputs: Sequence[float], memory: int, outputs: int
    ) -> bool:
        """Whether the step was made and its outputs are written."""
        instance = self._running.get(handle)
        if instance is None:
            if handle in self._dropped:
                fault(self.ports, f"has more than {MOST_INSTANCES} draws at once; run fewer in a batch")
            return False
        if step_count != instance.step_count:
            # a draw that has ended is asked for its last sample again, and not read
            if step_count != instance.step_count - 1:
                fault(
                    self.ports,
                    f"was asked for step {step_count} after {instance.step_count}; steps must be made in order",
                )
            return False
        calls = self.calls
        try:
            if not all(map(isfinite, inputs)):
                raise FmiError("an input is not finite")
            if inputs:
                required("set", calls.set_reals(instance.address, self._inputs, len(inputs), memory + HEAD))
            if not calls.step(instance.address, step_count * h, h):
                raise FmiError("the step fails")
            self._read(instance.address, outputs)
        except FmiError:
            with self._lock:
                self._close(handle)
            return False
        instance.step_count = step_count + 1
        if instance.step_count == instance.steps:
            self._finished.append(handle)
        return True

    def _begun(self, parameters: int) -> int:
        """The address of a new instance at t = 0, with its parameters."""
        address = self.calls.instantiate("draw")
        try:
            count = len(self._parameters)
            if count:
                required("set", self.calls.set_reals(address, self._parameters, count, parameters))
            self.calls.initialise(address)
        except FmiError:
            self.calls.free(address)
            raise
        return address

    def _read(self, address: int, outputs: int) -> None:
        """Read the outputs; raises FmiError."""
        required("get", self.calls.get_reals(address, self._outputs, len(self._outputs), outputs))

    def _kept(self, instance: Instance) -> int:
        """The handle of a new instance."""
        while len(self._running) >= MOST_INSTANCES:
            oldest, dropped = self._running.popitem(last=False)
            self._dropped.add(oldest)
            self.calls.free(dropped.address)
        self._last = self._last % (MOST_HANDLES - 1) + 1
        self._running[self._last] = instance
        return self._last

    def _close(self, handle: int) -> None:
        """Free an instance, if there is one of this handle."""
        instance = self._running.pop(handle, None)
        if instance is not None:
            self.calls.free(instance.address)

    def _free_finished(self) -> None:
        """Free the instances of finished flights: a new draw begins, so those are over."""
        while self._finished:
            self._close(self._finished.pop())


def fault(ports: FmuPorts, rule: str) -> None:
    """Note a fault, once."""
    text = f"the FMU '{ports.fmu.file}' {rule}"
    if text not in FAULTS:
        FAULTS.append(text)


def require_no_faults() -> None:
    """Require that every FMU has made its steps as it was asked to; called after a batch of lanes.

    Raises:
        ConfigError: One has not, so that the results are not valid.
    """
    if FAULTS:
        text = FAULTS.pop()
        FAULTS.clear()
        raise ConfigError("", text)


def references(places: Sequence[int]) -> ctypes.Array[ctypes.c_uint]:
    """Value references as the library takes them."""
    return (ctypes.c_uint * len(places))(*places)


class FmuFunctions:
    """The start and the steps of an FMU's instances, as functions that lanes can call.

    Args:
        ports: The FMU and its connected variables.
    """

    def __init__(self, ports: FmuPorts) -> None:
        self.ports = ports
        outputs = len(ports.outputs)
        self._start = foreign_function(ports, "start", 2, len(ports.parameters), outputs)
        self._step = foreign_function(ports, "step", 3, len(ports.inputs), outputs)

    def start(self, lane: Scalar, steps: int, parameters: Sequence[Scalar]) -> tuple[Words, list[jax.Array]]:
        """The words of a new draw (its handle and step count), and its outputs at t = 0.

        Args:
            lane: A word that is traced for each draw, so that each draw calls.
            steps: Number of steps of its flight.
            parameters: Values before t = 0.

        Raises:
            ConfigError: The loop does not compute in 64 bits.
        """
        handle, step_count, *outputs = call_in_double(self._start, lane, jnp.uint32(steps), *parameters)
        return (handle, step_count), outputs

    def step(self, words: Sequence[Scalar], h: Scalar, inputs: Sequence[Scalar]) -> tuple[Words, list[jax.Array]]:
        """The words after a step, and the outputs.

        Args:
            words: The words before the step.
            h: Length of the step [s].
            inputs: Inputs that are held over the step.

        Raises:
            ConfigError: The loop does not compute in 64 bits.
        """
        handle, step_count, *outputs = call_in_double(self._step, *words, h, *inputs)
        return (handle, step_count), outputs


def foreign_function(ports: FmuPorts, name: str, head: int, numbers: int, outputs: int) -> ForeignFunction:
    """A function of an FMU's instances: words, then the length of a step, the numbers and the outputs."""
    symbol = ports.symbol(name)
    if symbol not in foreign.ADDRESSES:
        foreign.provide(symbol, ctypes.cast(instances_of(ports).functions[name], ctypes.c_void_p).value or 0)
    word_places = (MemoryPlace(WORD, 0), MemoryPlace(WORD, 4))
    first = (*word_places, MemoryPlace(REAL, 8))[:head]
    places = tuple(MemoryPlace(REAL, HEAD + NUMBER * i) for i in range(numbers))
    output_places = tuple(MemoryPlace(REAL, HEAD + NUMBER * (numbers + i)) for i in range(outputs))
    return ForeignFunction(
        symbol, HEAD + NUMBER * (numbers + outputs), (*first, *places), (*word_places, *output_places)
    )


@cache
def instances_of(ports: FmuPorts) -> Instances:
    """The instances of an FMU with these ports in this process, whose code stays loaded."""
    return Instances(ports)


def call_in_double(function: ForeignFunction, *operands: Scalar) -> list[jax.Array]:
    """The results of a call.

    Raises:
        ConfigError: The loop does not compute in 64 bits, as FMUs do.
    """
    if jnp.result_type(float).itemsize < NUMBER:
        raise ConfigError("loop.precision", "must be 64, the precision of FMUs")
    return call(function, *operands)


def no_words() -> Words:
    """The words of a state that has no instance yet."""
    return jnp.uint32(NO_INSTANCE), jnp.uint32(0)


def require_independent(fmu: NativeFmu) -> None:
    """Require that an FMU starts, and that two instances of it do not disturb each other.

    Each must give the same bits alone and in turn with the other.

    Raises:
        ConfigError: It does not start, or its instances disturb each other.
    """
    try:
        separate_outputs = [tried_outputs(fmu, [flight]) for flight in (0, 1)]
        joint_outputs = tried_outputs(fmu, [0, 1])
        repeated_outputs = tried_outputs(fmu, [0])
    except FmiError as error:
        raise failure(fmu, error) from None
    if joint_outputs != separate_outputs[0] + separate_outputs[1] or repeated_outputs != separate_outputs[0]:
        rule = "keeps numbers outside of its instances (static or global variables), which would mix the draws"
        raise ConfigError("file", f"'{fmu.file}' {rule}; export it without them")


def tried_outputs(fmu: NativeFmu, flights: Sequence[int]) -> list[bytes]:
    """Step some flights in turn with inputs that vary; the bits of all outputs of each, until its step fails."""
    calls = fmu.calls
    inputs = [variable.reference for variable in fmu.variables.values() if variable.causality == "input"]
    outputs = [variable.reference for variable in fmu.variables.values() if variable.causality == "output"]
    h = fmu.step_size or TRIED_STEP
    bits_of_flights = {flight: bytearray() for flight in flights}
    instances: dict[int, int] = {}
    try:
        for flight in flights:
            instances[flight] = calls.instantiate(f"trial {flight}")
            calls.initialise(instances[flight])
        ended_flights: set[int] = set()
        for k, flight in product(range(TRIED_STEPS), flights):
            if flight in ended_flights:
                continue
            signals = np.cos(np.arange(1.0, 1.0 + len(inputs)) * (0.1 * k + flight + 1.0))
            values = np.full(len(outputs), inf)
            address = instances[flight]
            is_successful = (
                not inputs or calls.set_reals(address, references(inputs), len(inputs), signals.ctypes.data) <= 1
            )
            is_successful = is_successful and calls.step(address, k * h, h)
            if outputs and is_successful:
                is_successful = calls.get_reals(address, references(outputs), len(outputs), values.ctypes.data) <= 1
            if not is_successful:
                ended_flights.add(flight)
            bits_of_flights[flight] += values.tobytes()
    finally:
        for address in instances.values():
            calls.free(address)
    return [bytes(bits_of_flights[flight]) for flight in flights]
