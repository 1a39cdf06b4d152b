"""A stand-in for the CUDA driver: it runs the kernel's own program on this processor, one thread after another."""

import ctypes
from contextlib import contextmanager
from types import SimpleNamespace

from dssc_jax.lanes.gpu import driver, ptx
from dssc_jax.lanes.gpu.kernel_text import SPECIAL_REGISTERS
from dssc_jax.lanes.interface import ENTRY_POINT
from dssc_jax.lanes.llvm import machine

ADDRESS, NUMBER, TEXT = (ctypes.POINTER(kind) for kind in (ctypes.c_uint64, ctypes.c_int, ctypes.c_char_p))
NAMES = {0: b"CUDA_SUCCESS", 2: b"CUDA_ERROR_OUT_OF_MEMORY", 218: b"CUDA_ERROR_INVALID_PTX"}


class Kernel:
    """A kernel's text as machine code, whose special registers are variables."""

    def __init__(self, text):
        for register in SPECIAL_REGISTERS.values():
            intrinsic, variable = f"@llvm.nvvm.read.ptx.sreg.{register}.x()", f"@{register}"
            function = f"define i32 {variable}_read() {{\n  %v = load i32, ptr {variable}\n  ret i32 %v\n}}"
            text = text.replace(f"declare i32 {intrinsic}", f"{variable} = global i32 0\n{function}")
            text = text.replace(intrinsic, f"{variable}_read()")
        module = machine.parsed_module(text.replace("define ptx_kernel void", "define void"))
        self._engine = machine.engine_of(module)
        self._engine.finalize_object()
        places = {name: self._engine.get_global_value_address(name) for name in SPECIAL_REGISTERS.values()}
        self.registers = {name: ctypes.c_uint32.from_address(place) for name, place in places.items()}
        signature = ctypes.CFUNCTYPE(None, *[ctypes.c_uint64] * 3)
        self.run = signature(self._engine.get_function_address(ENTRY_POINT))


class Library:
    """The functions of the driver that lanes need, by their names in C.

    Args:
        capability: Of the GPU.
        memory: Bytes of the GPU.
    """

    def __init__(self, capability=(9, 0), memory=2**30):
        self.capability, self.memory = capability, memory
        self.calls, self.blocks, self.loaded = [], {}, []
        for name in driver.ARGUMENTS:
            setattr(self, name, self.function(name))

    def function(self, name):
        action = getattr(self, name.removesuffix("_v2").removesuffix("Async"), lambda *arguments: 0)
        prototype = ctypes.CFUNCTYPE(ctypes.c_int, *driver.ARGUMENTS[name])

        def called(*arguments):
            self.calls.append(name)
            return action(*arguments) or 0

        return prototype(called)

    def cuGetErrorName(self, status, place):
        ctypes.cast(place, TEXT)[0] = NAMES[status]

    def cuDeviceGetName(self, text, size, device):
        ctypes.memmove(text, b"Emulated GPU\0", 13)

    def cuDeviceGetAttribute(self, place, attribute, device):
        ctypes.cast(place, NUMBER)[0] = self.capability[attribute - driver.MAJOR]

    def cuModuleLoadDataEx(self, place, code, count, options, values):
        try:
            self.loaded.append(Kernel(code.decode()))
        except RuntimeError as error:
            ctypes.memmove(ctypes.cast(values, ADDRESS)[0], str(error).encode() + b"\0", len(str(error)) + 1)
            return 218
        ctypes.cast(place, ADDRESS)[0] = len(self.loaded)
        return 0

    def cuModuleGetFunction(self, place, module, name):
        assert name.decode() == ENTRY_POINT
        ctypes.cast(place, ADDRESS)[0] = module

    def cuMemAlloc(self, place, size):
        if sum(map(ctypes.sizeof, self.blocks.values())) + size > self.memory:
            return 2
        block = (ctypes.c_char * size)()
        self.blocks[ctypes.addressof(block)] = block
        ctypes.cast(place, ADDRESS)[0] = ctypes.addressof(block)
        return 0

    def cuMemFree(self, address):
        del self.blocks[address]

    def cuMemcpyHtoD(self, target, source, size, stream):
        assert size <= ctypes.sizeof(self.blocks[target])
        ctypes.memmove(target, source, size)

    def cuMemcpyDtoH(self, target, source, size, stream):
        assert size <= ctypes.sizeof(self.blocks[source])
        ctypes.memmove(target, source, size)

    def cuLaunchKernel(self, function, blocks, by, bz, threads, ty, tz, shared, stream, places, extra):
        kernel = self.loaded[function - 1]
        pointers = ctypes.cast(places, ADDRESS)
        arguments = [ctypes.cast(pointers[i], ADDRESS)[0] for i in range(3)]
        registers = SimpleNamespace(**kernel.registers)
        registers.ntid.value = threads
        for block in range(blocks):
            for thread in range(threads):
                registers.ctaid.value, registers.tid.value = block, thread
                kernel.run(*arguments)


@contextmanager
def emulated(monkeypatch, **properties):
    """Let lanes find the stand-in as the driver of this machine; their kernels stay LLVM's text."""
    library = Library(**properties)
    driver.driver.cache_clear()
    with monkeypatch.context() as patch:
        patch.setenv("DSSC_JAX_CACHE", "off")
        patch.setattr(ptx, "ptx", str.encode)
        patch.setattr(driver.ctypes, "CDLL", lambda name: library)
        yield library
    driver.driver.cache_clear()
