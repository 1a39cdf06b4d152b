"""Instances of an FMU, one for each draw, and the functions by which lanes start and step them.

An instance has hidden state, so a step is no pure function. A lane therefore carries a handle, which identifies its
instance, and the number of steps that it has made. A step is made only if this number equals the one that the instance
has reached, so no step can be repeated or left out unnoticed. The instance begins at the start of the draw, with the
draw's parameters, and no other lane has its handle. So the numbers of a draw depend neither on other draws nor on the
order or the number of threads.

An instance that fails, or that gets an input that is not finite, is freed. All further outputs of the draw are NaN, and
the draw ends as one that diverges.
"""

import ctypes
import hashlib
import struct
import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from math import isfinite, nan

import jax
import jax.numpy as jnp
import numpy as np

from dssc_jax.core.errors import ConfigError
from dssc_jax.core.native.fmi import FmiError, require_success
from dssc_jax.core.native.fmu import NativeFmu
from dssc_jax.core.signals import Scalar
from dssc_jax.lanes import foreign
from dssc_jax.lanes.foreign import ForeignFunction, MemoryPlace, call

MOST_INSTANCES = 1 << 15
"""Largest number of instances of an FMU at once; a new draw beyond this number frees the oldest instance."""

MOST_HANDLES = 1 << 32
NO_INSTANCE = 0
"""The handle of a draw whose instance has failed."""

HEAD = 16
"""Bytes before the numbers in the memory of a call: two words of 4 bytes, and the length of a step in 8 bytes."""

NUMBER = 8  # bytes of a float64
WORD = np.dtype(np.uint32)
REAL = np.dtype(np.float64)
WORD_PLACES = (MemoryPlace(WORD, 0), MemoryPlace(WORD, 4))
"""Places of an instance's words in the memory of a call."""

Words = tuple[jax.Array, jax.Array]
"""State of an instance in a lane: its handle and the number of steps made."""

FAULTS: list[str] = []
"""Faults of this process that make results invalid without a trace in the outcome of a draw."""


@dataclass(frozen=True)
class FmuPorts:
    """An FMU with the variables that a study connects.

    Args:
        fmu: The FMU.
        parameters: Value references of the variables that are set before t = 0.
        inputs: Value references of the variables that are set before each step.
        outputs: Value references of the variables that are read at t = 0 and after each step.
    """

    fmu: NativeFmu
    parameters: tuple[int, ...]
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]

    def symbol(self, function: str) -> str:
        """Return the name by which compiled lanes call a function of the FMU's instances.

        The name contains digests of the FMU's content and of the ports, so that compiled lanes cannot call a function
        of another FMU, or of the same FMU with other ports.
        """
        ports = repr((self.parameters, self.inputs, self.outputs)).encode()
        ports_digest = hashlib.sha256(ports).hexdigest()[:16]
        return f"dssc_jax_fmu_{self.fmu.sha256}_{ports_digest}_{function}"


class Instance:
    """A running instance, which counts the steps that it has made.

    Args:
        address: Address of the instance in the FMU's library.
        steps: Number of steps of the whole flight, after which the instance is freed.
    """

    __slots__ = ("address", "step_count", "steps")

    def __init__(self, address: int, steps: int) -> None:
        """Begin with no step made."""
        self.address = address
        self.step_count = 0
        self.steps = steps


class Instances:
    """The running instances of an FMU with the same ports, and the functions by which lanes start and step them.

    Args:
        ports: The FMU and its connected variables.
    """

    def __init__(self, ports: FmuPorts) -> None:
        """Begin without instances, and make the arrays and layouts of all calls."""
        self.ports = ports
        self.calls = ports.fmu.calls
        self._running: OrderedDict[int, Instance] = OrderedDict()  # by handle, the oldest first
        self._finished: list[int] = []  # handles of instances that have made all their steps
        self._dropped: set[int] = set()  # handles of instances that were freed because there were too many
        self._last = NO_INSTANCE  # the handle that was given last
        self._lock = threading.Lock()
        self._parameters = references(ports.parameters)
        self._inputs = references(ports.inputs)
        self._outputs = references(ports.outputs)
        self._start_head = struct.Struct("=II")  # two words
        self._step_head = struct.Struct(f"=IId{len(ports.inputs)}d")  # two words, length of the step, inputs
        self._no_outputs = struct.pack(f"={len(ports.outputs)}d", *[nan] * len(ports.outputs))
        self.functions = {
            "start": ctypes.CFUNCTYPE(None, ctypes.c_void_p)(self.start),
            "step": ctypes.CFUNCTYPE(None, ctypes.c_void_p)(self.step),
        }

    def start(self, memory: int) -> None:
        """Begin a draw with an instance of its own; compiled lanes call this method.

        Args:
            memory: Address of the call's memory. Before the call it holds a word without meaning, the number of steps
                and the parameters; afterwards, the handle, a step count of 0 and the outputs.
        """
        _, steps = self._start_head.unpack(ctypes.string_at(memory, self._start_head.size))
        outputs = memory + HEAD + NUMBER * len(self._parameters)
        handle = NO_INSTANCE
        with self._lock:
            self._free_finished()
            try:
                instance = Instance(self._start_instance(memory + HEAD), steps)
                handle = self._register(instance)
                self._read(instance.address, outputs)
            except FmiError:
                self._close(handle)
                handle = NO_INSTANCE
                ctypes.memmove(outputs, self._no_outputs, len(self._no_outputs))
        ctypes.memmove(memory, self._start_head.pack(handle, 0), self._start_head.size)

    def step(self, memory: int) -> None:
        """Make a step of a draw's instance; compiled lanes call this method.

        Args:
            memory: Address of the call's memory. Before the call it holds the handle, the step count, the length of the
                step [s] and the inputs; afterwards, the handle, the new step count and the outputs.
        """
        handle, step_count, h, *inputs = self._step_head.unpack(ctypes.string_at(memory, self._step_head.size))
        outputs = memory + HEAD + NUMBER * len(self._inputs)
        if not self._try_step(handle, step_count, h, inputs, memory, outputs):
            handle = NO_INSTANCE
            ctypes.memmove(outputs, self._no_outputs, len(self._no_outputs))
        ctypes.memmove(memory, self._start_head.pack(handle, step_count + 1), self._start_head.size)

    def _try_step(
        self, handle: int, step_count: int, h: float, inputs: Sequence[float], memory: int, outputs: int
    ) -> bool:
        """Make a step and write its outputs, or free an instance that fails; return whether the step succeeded.

        Args:
            handle: Handle of the instance.
            step_count: Number of steps that the lane has made.
            h: Length of the step [s].
            inputs: Values of the ports' inputs.
            memory: Address of the call's memory, which also holds the inputs.
            outputs: Address to which the outputs are written.
        """
        instance = self._instance_at(handle, step_count)
        if instance is None:
            return False
        calls = self.calls
        try:
            if not all(map(isfinite, inputs)):
                raise FmiError("an input is not finite")
            if inputs:
                require_success("set", calls.set_reals(instance.address, self._inputs, len(inputs), memory + HEAD))
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

    def _instance_at(self, handle: int, step_count: int) -> Instance | None:
        """Return the instance of a handle if it has made as many steps as the lane; else None.

        A lane that is one step behind computes the last sample of an ended draw again. This is no fault, because the
        results of that sample are not read. Any other difference is noted as a fault, as is an instance that was freed
        to make room. A handle without an instance for another reason belongs to a draw that failed.
        """
        instance = self._running.get(handle)
        if instance is None:
            if handle in self._dropped:
                note_fault(self.ports, f"has more than {MOST_INSTANCES} draws at once; run fewer in a batch")
            return None
        if step_count == instance.step_count:
            return instance
        if step_count != instance.step_count - 1:
            note_fault(
                self.ports,
                f"was asked for step {step_count} after {instance.step_count}; steps must be made in order",
            )
        return None

    def _start_instance(self, parameters: int) -> int:
        """Make an instance, set its parameters and start it at t = 0; return its address.

        Args:
            parameters: Address of the values of the parameters in the memory of the call.

        Raises:
            FmiError: A call fails.
        """
        address = self.calls.instantiate("draw")
        try:
            count = len(self._parameters)
            if count:
                require_success("set", self.calls.set_reals(address, self._parameters, count, parameters))
            self.calls.initialise(address)
        except FmiError:
            self.calls.free(address)
            raise
        return address

    def _read(self, address: int, outputs: int) -> None:
        """Write the outputs of the instance at ``address`` to memory at ``outputs``; raise FmiError if that fails."""
        require_success("get", self.calls.get_reals(address, self._outputs, len(self._outputs), outputs))

    def _register(self, instance: Instance) -> int:
        """Store a new instance, and return its handle; free the oldest if there are :data:`MOST_INSTANCES` already."""
        while len(self._running) >= MOST_INSTANCES:
            oldest, dropped = self._running.popitem(last=False)
            self._dropped.add(oldest)
            self.calls.free(dropped.address)
        self._last = self._last % (MOST_HANDLES - 1) + 1  # 1, 2, ..., 2^32 - 1, 1, ...: never NO_INSTANCE
        self._running[self._last] = instance
        return self._last

    def _close(self, handle: int) -> None:
        """Free the instance of a handle, if there is one."""
        instance = self._running.pop(handle, None)
        if instance is not None:
            self.calls.free(instance.address)

    def _free_finished(self) -> None:
        """Free the instances whose flights have made all their steps.

        They are kept until a new draw begins, because a lane may ask for the last step twice.
        """
        while self._finished:
            self._close(self._finished.pop())


def note_fault(ports: FmuPorts, rule: str) -> None:
    """Add a fault of an FMU to :data:`FAULTS`, unless it is there already.

    Args:
        ports: The FMU and its connected variables.
        rule: What is wrong, in words that follow the FMU's name.
    """
    text = f"the FMU '{ports.fmu.file}' {rule}"
    if text not in FAULTS:
        FAULTS.append(text)


def require_no_faults() -> None:
    """Require, after a batch of lanes, that every FMU has made its steps once and in order.

    Raises:
        ConfigError: :data:`FAULTS` has an entry, so the results are not valid. The list is emptied.
    """
    if FAULTS:
        text = FAULTS.pop()
        FAULTS.clear()
        raise ConfigError("", text)


def references(places: Sequence[int]) -> ctypes.Array[ctypes.c_uint]:
    """Return value references of an FMU's variables as an array of C."""
    return (ctypes.c_uint * len(places))(*places)


class FmuFunctions:
    """The start and the steps of an FMU's instances, as functions that lanes can call.

    Args:
        ports: The FMU and its connected variables.
    """

    def __init__(self, ports: FmuPorts) -> None:
        """Register both functions, so that lanes can call them."""
        self.ports = ports
        step_head = (*WORD_PLACES, MemoryPlace(REAL, 8))  # the words and the length of the step
        self._start = foreign_function(ports, "start", WORD_PLACES, len(ports.parameters))
        self._step = foreign_function(ports, "step", step_head, len(ports.inputs))

    def start(self, lane: Scalar, steps: int, parameters: Sequence[Scalar]) -> tuple[Words, list[jax.Array]]:
        """Start an instance; return its words, which are handle and step count, and its outputs at t = 0.

        Args:
            lane: A traced word that differs from draw to draw. It has no other effect than that each draw makes a call
                of its own.
            steps: Number of steps of the flight.
            parameters: Values of the ports' parameters.

        Raises:
            ConfigError: The loop does not compute in 64 bits.
        """
        handle, step_count, *outputs = call_in_double(self._start, lane, jnp.uint32(steps), *parameters)
        return (handle, step_count), outputs

    def step(self, words: Sequence[Scalar], h: Scalar, inputs: Sequence[Scalar]) -> tuple[Words, list[jax.Array]]:
        """Make a step; return the words and the outputs after the step.

        Args:
            words: Handle and step count before the step.
            h: Length of the step [s].
            inputs: Values of the ports' inputs, constant over the step.

        Raises:
            ConfigError: The loop does not compute in 64 bits.
        """
        handle, step_count, *outputs = call_in_double(self._step, *words, h, *inputs)
        return (handle, step_count), outputs


def foreign_function(ports: FmuPorts, name: str, head_places: tuple[MemoryPlace, ...], numbers: int) -> ForeignFunction:
    """Return a function of an FMU's instances in the form that lanes can call, and register it if it is new.

    The memory of a call holds a head of :data:`HEAD` bytes, then the numbers, then the outputs.

    Args:
        ports: The FMU and its connected variables.
        name: ``start`` or ``step``.
        head_places: Places of the operands in the head.
        numbers: Number of parameters or inputs.
    """
    outputs = len(ports.outputs)
    symbol = ports.symbol(name)
    if symbol not in foreign.ADDRESSES:
        foreign.provide(symbol, ctypes.cast(instances_of(ports).functions[name], ctypes.c_void_p).value or 0)
    number_places = tuple(MemoryPlace(REAL, HEAD + NUMBER * i) for i in range(numbers))
    output_places = tuple(MemoryPlace(REAL, HEAD + NUMBER * (numbers + i)) for i in range(outputs))
    size = HEAD + NUMBER * (numbers + outputs)
    return ForeignFunction(symbol, size, (*head_places, *number_places), (*WORD_PLACES, *output_places))


@cache
def instances_of(ports: FmuPorts) -> Instances:
    """Return the instances of an FMU with these ports; compiled lanes refer to them, so a process has one object."""
    return Instances(ports)


def call_in_double(function: ForeignFunction, *operands: Scalar) -> list[jax.Array]:
    """Call an FMU's function, which takes float64 numbers, and return its results.

    Raises:
        ConfigError: The loop computes in 32 bits.
    """
    if jnp.result_type(float).itemsize < NUMBER:
        raise ConfigError("loop.precision", "must be 64, the precision of FMUs")
    return call(function, *operands)


def empty_words() -> Words:
    """Return the handle and step count of a draw whose instance has not been started."""
    return jnp.uint32(NO_INSTANCE), jnp.uint32(0)
