"""Machine code of a lane's program: compilation by LLVM, and its run in several threads.

A call of compiled code releases Python's lock, so the threads of this process use all cores. A thread that has finished
its vectors of lanes takes the next ones; lanes are independent, so results do not depend on the thread.
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
"""Environment variable with the largest number of cores to use."""
CODE_LEVEL = 2  # optimisation level of LLVM's code generation
PARTS = 32  # parts of a batch for each thread; many, because neither parts nor cores are equally fast


def usable_cores() -> int:
    """Return the number of cores to use: all available ones, or fewer if :data:`CORES_VARIABLE` says so, at least 1."""
    limit = os.environ.get(CORES_VARIABLE, "")
    if not limit.isdecimal():
        return available_cores()
    return min(available_cores(), max(1, int(limit)))


def available_cores() -> int:
    """Return the number of cores on which the system lets this process run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def features() -> Any:
    """Return the features of this processor: for each of LLVM's names, whether the processor has the feature."""
    return llvm.get_host_cpu_features()


@cache
def scheduling_model() -> str:
    """Return the name of the processor for which LLVM orders instructions.

    LLVM still uses all instructions of this processor. On x86-64 the name is that of Atom, which executes instructions
    in order. For Atom, LLVM fills waiting times with independent instructions, as
    :mod:`dssc_jax.lanes.passes.scheduling` does. For other processors, LLVM often restores the order of the text.
    """
    return "atom" if llvm.get_process_triple().startswith("x86_64") else llvm.get_host_cpu_name()


def code_settings() -> list[str]:
    """Return LLVM's version and the processor's name, in words for the manifest of a study."""
    return [f"llvm {'.'.join(map(str, llvm.llvm_version_info))}", f"processor {llvm.get_host_cpu_name()}"]


def add_symbol(symbol: str, address: int) -> None:
    """Register the address of a symbol, so that machine code of this process can call the function."""
    llvm.add_symbol(symbol, address)


@cache
def has_near_constants() -> bool:
    """Whether compiled code reads each constant from memory where it is used, at a place near the instruction.

    This is so on Linux and x86-64 without AVX-512. Such a processor has 16 vector registers, too few to hold constants.
    Other systems are excluded because the memory manager that places code and constants near each other has been tried
    with Linux's object files only.
    """
    triple = llvm.get_process_triple()
    return triple.startswith("x86_64") and "linux" in triple and vector_bits() < 512


def target_machine() -> Any:
    """Return a new description of this processor for LLVM. Each call makes one, because an engine takes it over."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    relocation, model = ("pic", "small") if has_near_constants() else ("default", "jitdefault")
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=scheduling_model(), features=features().flatten(), opt=CODE_LEVEL, reloc=relocation, codemodel=model
    )


@cache
def vector_bits() -> int:
    """Return the number of bits of the widest vectors that LLVM can use on this processor: 512, 256 or 128."""
    for name, bits in (("avx512f", 512), ("avx", 256)):
        if features().get(name):
            return bits
    return 128


def code_name(text: str) -> str:
    """Return the name under which the cache keeps a module's machine code: a digest of text and :func:`translator`."""
    lines = "\n".join((text, *translator()))
    return f"lanes-{hashlib.sha256(lines.encode()).hexdigest()}"


@cache
def translator() -> tuple[str, ...]:
    """Return all that determines the machine code of a module, apart from its text: LLVM's version and settings."""
    model = scheduling_model()
    instructions = features().flatten()
    addresses = str(has_near_constants())
    return llvmlite.__version__, str(llvm.llvm_version_info), model, instructions, str(CODE_LEVEL), addresses


def object_code(text: str) -> bytes:
    """Compile the text of a module to an object file."""
    return target_machine().emit_object(parsed_module(text))


def assembly(text: str) -> str:
    """Compile the text of a module to assembly language."""
    return target_machine().emit_assembly(parsed_module(text))


def parsed_module(text: str) -> Any:
    """Parse the text of a module, and set this processor as its target."""
    module = llvm.parse_assembly(text)
    machine = target_machine()
    module.triple = machine.triple
    module.data_layout = str(machine.target_data)
    return module


def engine_of(module: Any) -> Any:
    """Return LLVM's engine for a module; it loads code and constants near each other where instructions need that."""
    manager = has_near_constants() or None  # llvmlite's memory manager, which is not the default everywhere
    return llvm.create_mcjit_compiler(module, target_machine(), use_lmm=manager)


@dataclass
class LoadedCode:
    """Machine code that is loaded into this process.

    Args:
        code: An object file with the function :data:`~dssc_jax.lanes.interface.ENTRY_POINT`.
    """

    code: bytes

    def __post_init__(self) -> None:
        """Load the object file, and find its function: (inputs, outputs, first lane, lane after the last)."""
        self._engine = engine_of(llvm.parse_assembly(""))
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(self.code))
        self._engine.finalize_object()
        pointer = ctypes.c_void_p
        lane = ctypes.c_int64
        signature = ctypes.CFUNCTYPE(None, pointer, pointer, lane, lane)
        self._run_lanes = signature(self.address(ENTRY_POINT))

    def address(self, symbol: str) -> int:
        """Return the address of a function of the code, given the function's symbol."""
        return int(self._engine.get_function_address(symbol))

    def start(
        self, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray], lanes: int, width: int, threads: int
    ) -> Callable[[], float]:
        """Begin to run all lanes on ``threads`` threads; see :class:`~dssc_jax.lanes.interface.Loaded`.

        The batch is divided into parts of whole vectors. A thread that has finished a part takes the next one.
        """
        vectors_of_part = max(1, rounded_up(lanes, width * threads * PARTS))
        part = vectors_of_part * width  # lanes that a thread takes at once
        first_lanes = iter(range(0, lanes, part))
        lock = threading.Lock()
        stop_event = threading.Event()

        def run_parts() -> float:
            """Run parts of the batch until none is left; return the time at the end [s].

            This function refers to the columns, which must stay in memory while the machine code uses their addresses.
            """
            input_addresses = addresses(inputs)
            output_addresses = addresses(outputs)
            while True:
                with lock:
                    first = next(first_lanes, None)
                if first is None or stop_event.is_set():
                    return time.perf_counter()
                end = min(first + part, lanes)
                self._run_lanes(input_addresses.ctypes.data, output_addresses.ctypes.data, first, end)

        pool = workers(threads)
        busy_threads = min(threads, rounded_up(lanes, part))
        futures: list[Future[float]] = [pool.submit(run_parts) for _ in range(busy_threads)]

        def wait() -> float:
            """Wait for all threads; return the time at which the last one ended [s].

            An exception while waiting, such as Ctrl-C, stops the threads after the parts that they are running.
            """
            try:
                return max(future.result() for future in futures)
            except BaseException:  # such as Ctrl-C: the threads finish their parts and end
                stop_event.set()
                raise

        weakref.finalize(wait, stop_event.set)  # if the caller drops ``wait``, nobody needs the remaining parts
        return wait


def rounded_up(numerator: int, denominator: int) -> int:
    """Return the quotient of two positive integers, rounded up to a whole number."""
    return -(-numerator // denominator)


def addresses(columns: Sequence[np.ndarray]) -> np.ndarray:
    """Return the addresses of contiguous arrays as an array; [0] if there are none.

    Machine code takes the address of the returned array, so that array must not be empty.
    """
    return np.array([column.ctypes.data for column in columns] or [0], np.uintp)


@cache
def workers(threads: int) -> ThreadPoolExecutor:
    """Return the pool of a number of threads; the process has one pool for each number."""
    return ThreadPoolExecutor(threads, thread_name_prefix="lanes")
