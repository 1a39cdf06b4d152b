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
CODE_LEVEL = 2  # optimisation level of LLVM's code generation
PARTS = 32  # parts of a batch for each thread; many, because neither parts nor cores are equally fast


def usable_cores() -> int:
    """Number of cores to use: those of the system, or fewer if the environment variable asks for it."""
    limit = os.environ.get(CORES_VARIABLE, "")
    return min(available_cores(), max(1, int(limit))) if limit.isdecimal() else available_cores()


def available_cores() -> int:
    """Number of cores on which the system lets this process run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def features() -> Any:
    """The features of this processor: a mapping from LLVM's names to whether the processor has the feature."""
    return llvm.get_host_cpu_features()


@cache
def scheduling_model() -> str:
    """Name of the processor for which LLVM orders instructions; those of this processor are used.

    On x86-64 it is Atom, which executes instructions in order. For it, LLVM fills waiting times with independent
    instructions, as :mod:`dssc_jax.lanes.passes.scheduling` does; for others it often restores the order of the text.
    """
    return "atom" if llvm.get_process_triple().startswith("x86_64") else llvm.get_host_cpu_name()


def code_settings() -> list[str]:
    """LLVM's version and the processor, in words for a manifest."""
    return [f"llvm {'.'.join(map(str, llvm.llvm_version_info))}", f"processor {llvm.get_host_cpu_name()}"]


def add_symbol(symbol: str, address: int) -> None:
    """Register the address of a symbol, so that machine code of this process can call the function."""
    llvm.add_symbol(symbol, address)


@cache
def has_near_constants() -> bool:
    """Whether compiled code reads each constant from memory where it is used, at an offset from the instruction.

    On x86-64 without AVX-512 there are 16 vector registers, too few to hold constants, so each constant is read where
    it is used. This needs a memory manager that has been tried with Linux's object files only.
    """
    triple = llvm.get_process_triple()
    return triple.startswith("x86_64") and "linux" in triple and vector_bits() < 512


def target_machine() -> Any:
    """A new description of this processor for LLVM; an engine takes possession of the one it is given."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    relocation, model = ("pic", "small") if has_near_constants() else ("default", "jitdefault")
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=scheduling_model(), features=features().flatten(), opt=CODE_LEVEL, reloc=relocation, codemodel=model
    )


@cache
def vector_bits() -> int:
    """Number of bits of this processor's widest vectors that LLVM can use."""
    for name, bits in (("avx512f", 512), ("avx", 256)):
        if features().get(name):
            return bits
    return 128


def code_name(text: str) -> str:
    """The name in the cache of a module's machine code: a digest of the text and of :func:`translator`."""
    return f"lanes-{hashlib.sha256(chr(10).join((text, *translator())).encode()).hexdigest()}"


@cache
def translator() -> tuple[str, ...]:
    """Everything that determines the machine code of a module beside its text: LLVM's version and its settings."""
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
    """Parse the text of a module, and set it for this processor."""
    module = llvm.parse_assembly(text)
    machine = target_machine()
    module.triple = machine.triple
    module.data_layout = str(machine.target_data)
    return module


def engine_of(module: Any) -> Any:
    """LLVM's engine for a module, which loads code and constants near each other where instructions need that."""
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
        self._engine = engine_of(llvm.parse_assembly(""))
        self._engine.add_object_file(llvm.ObjectFileRef.from_data(self.code))
        self._engine.finalize_object()
        pointer = ctypes.c_void_p
        count = ctypes.c_int64
        signature = ctypes.CFUNCTYPE(None, pointer, pointer, count, count)
        self._function = signature(self.address(ENTRY_POINT))

    def address(self, symbol: str) -> int:
        """The address of a function of the code."""
        return int(self._engine.get_function_address(symbol))

    def start(
        self, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray], lanes: int, width: int, threads: int
    ) -> Callable[[], float]:
        """Begin to run all lanes; see :class:`~dssc_jax.lanes.interface.Loaded`."""
        part = max(1, -(-lanes // (width * threads * PARTS))) * width
        starts = iter(range(0, lanes, part))
        lock = threading.Lock()
        stop_event = threading.Event()

        def work() -> float:  # refers to the columns, so that they exist as long as it runs
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
            except BaseException:  # such as Ctrl-C: the threads finish their parts and end
                stop_event.set()
                raise

        weakref.finalize(finish, stop_event.set)  # the caller has dropped the function, so nobody waits
        return finish


def addresses(columns: Sequence[np.ndarray]) -> np.ndarray:
    """The addresses of contiguous arrays, as an array."""
    return np.array([column.ctypes.data for column in columns] or [0], np.uintp)


@cache
def workers(threads: int) -> ThreadPoolExecutor:
    """The pool of a number of threads, one for the whole process."""
    return ThreadPoolExecutor(threads, thread_name_prefix="lanes")
