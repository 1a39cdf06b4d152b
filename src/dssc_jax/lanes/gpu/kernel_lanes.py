"""Batches of lanes on a GPU."""

import ctypes
import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from dssc_jax.lanes.gpu import ptx
from dssc_jax.lanes.gpu.driver import Driver, driver
from dssc_jax.lanes.interface import ENTRY_POINT
from dssc_jax.lanes.lanes import CompiledLanes

if TYPE_CHECKING:
    from dssc_jax.lanes.gpu.kernel_text import TracedKernel

THREADS = 256  # threads of a block; a multiprocessor holds as many of the vehicle's program


class KernelLanes(CompiledLanes):
    """The program of a lane as a kernel, which runs one lane in each thread.

    The arguments are those of :class:`CompiledLanes`; ``width`` has no effect, since a thread has one lane.

    Raises:
        Unsupported: An operation has no translation, or none for a GPU.
        GpuError: There is no GPU that can run lanes.
    """

    def translated(
        self, lane: Callable[..., Any], arguments: tuple[Any, ...], width: int | None, strict: bool
    ) -> "TracedKernel":
        """Trace a lane; return the lane's program and the kernel's text for LLVM.

        Args:
            lane: A function of trees of scalars.
            arguments: Its arguments, with ``jax.ShapeDtypeStruct`` in place of each scalar.
            width: Without effect: a thread has one lane.
            strict: Whether products and sums are never contracted.
        """
        from dssc_jax.lanes.gpu.kernel_text import TracedKernel  # not needed if the cache has the kernel

        return TracedKernel(lane, arguments, strict)

    def compiled(self) -> bytes:
        """Compile the text to PTX."""
        return ptx.ptx(self.traced.text)

    def load(self, code: bytes) -> "LoadedKernel":
        """Load the PTX into the GPU's driver."""
        return LoadedKernel(code, driver())

    def interleaved(self, lanes: int) -> int:
        """Return ``lanes``: a GPU stores the recordings of the whole batch sample by sample."""
        return lanes


class LoadedKernel:
    """A kernel that a GPU can run.

    Args:
        code: PTX with the kernel :data:`~dssc_jax.lanes.interface.ENTRY_POINT`.
        gpu: The driver of the GPU.
    """

    def __init__(self, code: bytes, gpu: Driver) -> None:
        """Load the PTX into the driver."""
        self._gpu = gpu
        gpu.use()
        self._kernel = gpu.kernel(code, ENTRY_POINT)

    def start(
        self, inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray], lanes: int, width: int, threads: int
    ) -> Callable[[], float]:
        """Begin to run all lanes, one in each thread of the GPU; see :class:`~dssc_jax.lanes.interface.Loaded`.

        The contract's ``width`` and ``threads``, which concern a CPU, have no effect.

        Raises:
            GpuError: The driver refused a call, such as a request for more memory than the GPU has.
        """
        batch = KernelBatch(self._gpu)
        try:
            input_table = batch.table([batch.copy_to_gpu(column) for column in inputs])
            output_addresses = [batch.reserve(column.nbytes) for column in outputs]
            output_table = batch.table(output_addresses)
            arguments = [ctypes.c_uint64(number) for number in (input_table, output_table, lanes)]
            blocks = -(-lanes // THREADS)  # rounded up
            self._gpu.launch(self._kernel, blocks, THREADS, arguments, batch.stream)
        except BaseException:
            batch.close()
            raise

        def wait() -> float:
            """Wait for the lanes and copy the results to the host; return the time at which the lanes ended [s]."""
            self._gpu.use()  # the caller's thread may differ from the one that started the batch
            try:
                self._gpu.wait(batch.stream)
                end_time = time.perf_counter()
                for column, address in zip(outputs, output_addresses, strict=True):
                    self._gpu.fetch(column, address, batch.stream)
                self._gpu.wait(batch.stream)
            finally:
                batch.close()
            return end_time

        return wait


class KernelBatch:
    """One batch on a GPU: its stream, its memory, and the arrays that are being copied.

    Args:
        gpu: The driver.
    """

    def __init__(self, gpu: Driver) -> None:
        """Open a stream; no memory is reserved yet."""
        gpu.use()
        self._gpu = gpu
        self._addresses: list[int] = []  # of the memory to free
        self._arrays: list[np.ndarray] = []  # kept until they are copied
        self.stream = gpu.stream()

    def reserve(self, size: int) -> int:
        """Reserve ``size`` bytes on the GPU until :meth:`close`, and return their address."""
        address = self._gpu.reserve(size)
        self._addresses.append(address)
        return address

    def copy_to_gpu(self, array: np.ndarray) -> int:
        """Begin to copy an array to the GPU, and return the address of the copy."""
        address = self.reserve(array.nbytes)
        self._arrays.append(array)
        self._gpu.send(address, array, self.stream)
        return address

    def table(self, addresses: Sequence[int]) -> int:
        """Begin to copy a table of addresses to the GPU, with a 0 at its end; return the address of the copy."""
        return self.copy_to_gpu(np.array([*addresses, 0], np.uint64))  # the 0 keeps the table from being empty

    def close(self) -> None:
        """Wait for the stream, free the memory and close the stream."""
        self._gpu.wait(self.stream)
        for address in self._addresses:
            self._gpu.free(address)
        self._gpu.close(self.stream)
