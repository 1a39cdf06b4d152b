"""Machine code of a lane's program: compilation by LLVM, and calls that share the lanes between threads.

A call of compiled code releases Python's lock, so threads of this process use all cores. Each takes the next vectors
of lanes when it is done with its own; lanes are independent, so it does not matter which thread runs which.
"""

import ctypes
import hashlib
import os
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np

from dssc_jax.lanes.interface import ENTRY_POINT

CORES_VARIABLE = "DSSC_JAX_CORES"
CODE_LEVEL = 2  # optimisation level of LLVM's code generation
PARTS = 32  # parts of a batch per thread: some are quicker than others, and so are cores


def usable_cores() -> int:
    """Cores that this process may use; the environment may limit them further."""
    limit = os.environ.get(CORES_VARIABLE, "")
    return min(available_cores(), max(1, int(limit))) if limit.isdecimal() else available_cores()


def available_cores() -> int:
    """Cores that the system gives to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def features() -> Any:
    """The features of this processor: for each of LLVM's names whether it has the feature."""
    return llvm.get_host_cpu_features()


@cache
def scheduling_model() -> str:
    """The processor for which LLVM chooses among the instructions that this one has, and orders them.

    Atom executes them in order. For it, LLVM puts what does not wait between what waits, as
    :mod:`dssc_jax.lanes.passes.scheduling` does; for others it often restores the order of the text.
    """
    return "atom" if llvm.get_process_triple().startswith("x86_64") else llvm.get_host_cpu_name()


def code_settings() -> list[str]:
    """The facts about the machine code for a manifest: LLVM's version and the processor."""
    return [f"llvm {'.'.join(map(str, llvm.llvm_version_info))}", f"processor {llvm.get_host_cpu_name()}"]


def add_symbol(symbol: str, address: int) -> None:
    """Let machine code of this process call a function by its symbol."""
    llvm.add_symbol(symbol, address)


@cache
def has_near_constants() -> bool:
    """Whether instructions read constants at a distance from themselves, and not at an address in a register.

    On x86-64 without AVX-512, 16 vector registers are too few to keep constants; each is read where it is used. The
    memory manager on which this depends is tried with Linux's object files alone.
    """
    triple = llvm.get_process_triple()
    return triple.startswith("x86_64") and "linux" in triple and vector_bits() < 512


def target_machine() -> Any:
    """A description of this processor for LLVM; an engine takes it over."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    relocation, model = ("pic", "small") if has_near_constants() else ("default", "jitdefault")
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=scheduling_model(), features=features().flatten(), opt=CODE_LEVEL, reloc=relocation, codemodel=model
    )


@cache
def vector_bits() -> int:
    """Bits of this processor's widest vectors that LLVM knows how to use."""
    for name, bits in (("avx512f", 512), ("avx", 256)):
        if features().get(name):
            return bits
    return 128


def code_name(text: str) -> str:
    """A name for the machine code of a module: that of its text and of all that translates it."""
    return f"lanes-{hashlib.sha256(chr(10).join((text, *translator())).encode()).hexdigest()}"


@cache
def translator() -> tuple[str, ...]:
    """The facts that decide the machine code of a module's text: LLVM, the processor, its features, the addresses."""
    model = scheduling_model()
    instructions = features().flatten()
    addresses = str(has_near_constants())
    return llvmlite.__version__, str(llvm.llvm_version_info), model, instructions, str(CODE_LEVEL), addresses


def object_code(text: str) -> bytes:
    """Compile a module to an object file."""
    return target_machine().emit_object(module_here(text))


def assembly(text: str) -> str:
    """The machine code of a module for a reader."""
    return target_machine().emit_assembly(module_here(text))


def module_here(text: str) -> Any:
    """A module for this processor."""
    module = llvm.parse_assembly(text)
    machine = target_machine()
    module.triple = machine.triple
    module.data_layout = str(machine.target_data)
    return module


def engine_of(module: Any) -> Any:
    """LLVM's engine that loads a module; code and constants lie in one place where they must be near each other."""
    manager = has_near_constants() or None  # llvmlite's memory manager, which is not the default everywhere
    return llvm.create_mcjit_compiler(module, target_machine(), use_lmm=manager)


@dataclass
class LoadedCode:
    """Machine code in this process.

    Args:
        code: An object file with the function :data:`~dssc_jax.lanes.interface.ENTRY_POINT`.
    """

    code: bytes

    def __post_init__(self) -> None:
        self._engine = engine_of(llvm.parse_assembly(""))
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(self.code))
        self._engine.finalize_object()
        pointer = ctypes.c_void_p
        count = ctypes.c_int64
        signature = ctypes.CFUNCTYPE(None, pointer, pointer, count, count)
        self._function = signature(self.address(ENTRY_POINT))

    def address(self, symbol: str) -> int:
        """Where a function of the code lies in memory."""
        return int(self._engine.get_function_address(symbol))

    def start(
        self, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray], lanes: int, width: int, threads: int
    ) -> Callable[[], float]:
        """Begin to run all lanes; see :class:`~dssc_jax.lanes.interface.Loaded`."""
        part = max(1, -(-lanes // (width * threads * PARTS))) * width
        starts = iter(range(0, lanes, part))
        lock = threading.Lock()
        stop_event = threading.Event()

        def work() -> float:  # holds the columns as long as it runs, whoever else lets go of them
            input_addresses = addresses(inputs)
            output_addresses = addresses(outputs)
            while True:
                with lock:
                    first = next(starts, None)
                if first is None or stop_event.is_set():
                    return time.perf_counter()
                last = min(first + part, lanes)
                self._function(input_addresses.ctypes.data, output_addresses.ctypes.data, first, last)

        futures: list[Future[float]] = [workers(threads).submit(work) for _ in range(min(threads, -(-lanes // part)))]

        def finish() -> float:
            try:
                return max(future.result() for future in futures)
            except BaseException:  # such as Ctrl-C: the threads end with the part that they run
                stop_event.set()
                raise

        weakref.finalize(finish, stop_event.set)  # nobody waits any more
        return finish


def addresses(columns: Sequence[np.ndarray]) -> np.ndarray:
    """Addresses of contiguous arrays."""
    return np.array([column.ctypes.data for column in columns] or [0], np.uintp)


@cache
def workers(threads: int) -> ThreadPoolExecutor:
    """A pool of threads of this process."""
    return ThreadPoolExecutor(threads, thread_name_prefix="lanes")
