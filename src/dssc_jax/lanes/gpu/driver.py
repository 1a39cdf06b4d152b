"""Calls of the CUDA driver by ctypes: memory, modules and launches. No software is needed but the GPU's driver.

Names, types and constants are those of NVIDIA's CUDA Driver API, version 11.4 and later.
"""

import ctypes
import sys
from ctypes import byref, c_char_p, c_int, c_size_t, c_uint, c_uint64, c_void_p
from functools import cache
from typing import Any

import numpy as np

from dssc_jax.lanes.gpu.ptx import CAPABILITY

LIBRARY = "nvcuda.dll" if sys.platform == "win32" else "libcuda.so.1"
MAJOR, MINOR = 75, 76  # CU_DEVICE_ATTRIBUTE_COMPUTE_CAPABILITY_MAJOR and _MINOR
LOG, LOG_SIZE = 5, 6  # CU_JIT_ERROR_LOG_BUFFER and its size
LOG_BYTES = 8192  # size of the buffer for the driver's messages about PTX
NON_BLOCKING = 1  # CU_STREAM_NON_BLOCKING
OUT_OF_MEMORY = 2  # CUDA_ERROR_OUT_OF_MEMORY

ARGUMENTS: dict[str, tuple[Any, ...]] = {
    "cuInit": (c_uint,),
    "cuGetErrorName": (c_int, c_void_p),
    "cuDeviceGet": (c_void_p, c_int),
    "cuDeviceGetName": (c_void_p, c_int, c_int),
    "cuDeviceGetAttribute": (c_void_p, c_int, c_int),
    "cuDevicePrimaryCtxRetain": (c_void_p, c_int),
    "cuCtxSetCurrent": (c_void_p,),
    "cuModuleLoadDataEx": (c_void_p, c_char_p, c_uint, c_void_p, c_void_p),
    "cuModuleGetFunction": (c_void_p, c_void_p, c_char_p),
    "cuStreamCreate": (c_void_p, c_uint),
    "cuStreamSynchronize": (c_void_p,),
    "cuStreamDestroy_v2": (c_void_p,),
    "cuMemAlloc_v2": (c_void_p, c_size_t),
    "cuMemFree_v2": (c_uint64,),
    "cuMemcpyHtoDAsync_v2": (c_uint64, c_void_p, c_size_t, c_void_p),
    "cuMemcpyDtoHAsync_v2": (c_void_p, c_uint64, c_size_t, c_void_p),
    "cuLaunchKernel": (c_void_p, *([c_uint] * 7), c_void_p, c_void_p, c_void_p),
}
"""Types of the arguments of each function that is called. All return the number of an error, or 0."""


class GpuError(Exception):
    """The error if there is no GPU that can run lanes, or if the GPU's driver has refused a call."""


class Driver:
    """The driver of the first GPU that this process may use.

    It works in the GPU's primary context, which other libraries of the process share.

    Args:
        library: The driver's shared library, loaded by ctypes.

    Raises:
        GpuError: There is no GPU, or it is too old.
    """

    def __init__(self, library: Any) -> None:
        """Find the first GPU, and retain its context."""
        self._library = library
        for function, types in ARGUMENTS.items():
            getattr(library, function).argtypes = types
        self.call("cuInit", 0)  # flags, which CUDA reserves
        device = c_int()
        self.call("cuDeviceGet", byref(device), 0)  # the first
        self.device = device.value
        name = ctypes.create_string_buffer(256)
        self.call("cuDeviceGetName", name, len(name), self.device)
        self.name = name.value.decode()
        self._require_capability()
        context = c_void_p()
        self.call("cuDevicePrimaryCtxRetain", byref(context), self.device)
        self._context = context

    def _require_capability(self) -> None:
        """Require that the GPU is new enough to run lanes.

        Raises:
            GpuError: The GPU's compute capability is below :data:`~dssc_jax.lanes.gpu.ptx.CAPABILITY`.
        """
        major = self.attribute(MAJOR)
        minor = self.attribute(MINOR)
        if (major, minor) < CAPABILITY:
            least_major, least_minor = CAPABILITY
            minimum = f"{least_major}.{least_minor}"
            raise GpuError(f"{self.name} has compute capability {major}.{minor}, lanes need {minimum} or later")

    def call(self, name: str, *arguments: Any) -> None:
        """Call a function of the driver.

        Args:
            name: Name of the function, a key of :data:`ARGUMENTS`.
            arguments: Arguments of the function.

        Raises:
            GpuError: The function returns an error.
        """
        status = getattr(self._library, name)(*arguments)
        if status != 0:
            remedy = "; run smaller blocks" if status == OUT_OF_MEMORY else ""
            raise GpuError(f"{name} of the CUDA driver: {self._error_name(status)}{remedy}")

    def _error_name(self, status: int) -> str:
        """Return the driver's name of an error number; "error NUMBER" if the driver does not know the number."""
        name = c_char_p()
        is_known = self._library.cuGetErrorName(status, byref(name)) == 0
        return name.value.decode() if is_known and name.value else f"error {status}"

    def attribute(self, number: int) -> int:
        """Return the value of an attribute of the GPU, given the attribute's number in the API."""
        value = c_int()
        self.call("cuDeviceGetAttribute", byref(value), number, self.device)
        return value.value

    def use(self) -> None:
        """Set the GPU's context for the calling thread; each thread must do this before its other calls."""
        self.call("cuCtxSetCurrent", self._context)

    def kernel(self, code: bytes, entry: str) -> c_void_p:
        """Load PTX, and return the handle of its kernel named ``entry``.

        Raises:
            GpuError: The driver cannot translate the PTX; the message contains the driver's own message.
        """
        module = c_void_p()
        log = ctypes.create_string_buffer(LOG_BYTES)
        options = (c_int * 2)(LOG, LOG_SIZE)
        # the API takes an array of pointers, and reads the buffer's size from the bits of the second one
        values = (c_void_p * 2)(ctypes.addressof(log), LOG_BYTES)
        try:
            self.call("cuModuleLoadDataEx", byref(module), code, len(options), options, values)
        except GpuError as error:
            message = log.value.decode(errors="replace").strip()
            raise GpuError(f"{error}: {message}") from None
        handle = c_void_p()
        self.call("cuModuleGetFunction", byref(handle), module, entry.encode())
        return handle

    def stream(self) -> c_void_p:
        """Create a stream: a queue of operations, which the GPU performs in order."""
        stream = c_void_p()
        self.call("cuStreamCreate", byref(stream), NON_BLOCKING)
        return stream

    def wait(self, stream: c_void_p) -> None:
        """Wait until all operations of a stream are finished."""
        self.call("cuStreamSynchronize", stream)

    def close(self, stream: c_void_p) -> None:
        """Destroy a stream."""
        self.call("cuStreamDestroy_v2", stream)

    def reserve(self, size: int) -> int:
        """Reserve ``size`` bytes of the GPU's memory, and return their address."""
        address = c_uint64()
        self.call("cuMemAlloc_v2", byref(address), max(size, 1))  # the driver refuses 0 bytes
        return address.value

    def free(self, address: int) -> None:
        """Free memory that :meth:`reserve` has reserved."""
        self.call("cuMemFree_v2", address)

    def send(self, address: int, array: np.ndarray, stream: c_void_p) -> None:
        """Queue the copy of a contiguous array to an address on the GPU; the array must live until the copy is done."""
        self.call("cuMemcpyHtoDAsync_v2", address, array.ctypes.data, array.nbytes, stream)

    def fetch(self, array: np.ndarray, address: int, stream: c_void_p) -> None:
        """Queue the copy from an address on the GPU into a contiguous array."""
        self.call("cuMemcpyDtoHAsync_v2", array.ctypes.data, address, array.nbytes, stream)

    def launch(self, kernel: c_void_p, blocks: int, threads: int, arguments: list[c_uint64], stream: c_void_p) -> None:
        """Queue a run of a kernel.

        Args:
            kernel: Handle of the kernel.
            blocks: Number of blocks.
            threads: Number of threads in each block.
            arguments: Arguments of the kernel, of 64 bits each.
            stream: The stream.
        """
        addresses = [ctypes.addressof(argument) for argument in arguments]
        address_array = (c_void_p * len(addresses))(*addresses)
        grid = blocks, 1, 1  # along three axes
        block = threads, 1, 1
        shared_bytes = 0
        self.call("cuLaunchKernel", kernel, *grid, *block, shared_bytes, stream, address_array, None)  # no extras


@cache
def driver() -> Driver:
    """Return the driver of this machine's first GPU, which is loaded at the first call.

    Raises:
        GpuError: The machine has no driver, or no GPU that can run lanes.
    """
    try:
        library = ctypes.CDLL(LIBRARY)
    except OSError:
        raise GpuError(f"this machine has no driver of NVIDIA's ({LIBRARY} cannot be loaded)") from None
    return Driver(library)
