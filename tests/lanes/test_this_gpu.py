"""Lanes on this machine's GPU, if it has one: the bits of strict arithmetic on the processor."""

import jax
import numpy as np
import pytest

from dssc_jax.lanes.gpu.driver import GpuError, driver
from dssc_jax.lanes.gpu.kernel_lanes import THREADS, KernelLanes
from dssc_jax.lanes.lanes import CompiledLanes
from tests.lanes.gpu_here import needs_gpu
from tests.lanes.test_gpu import EVERYTHING, every_function, recorded
from tests.lanes.test_translation import PLACES, X

pytestmark = needs_gpu


def both(lane, arguments, types, count):
    """Results of strict arithmetic on the GPU and on the processor, as pairs of columns."""
    kinds = KernelLanes, CompiledLanes
    results = [kind(lane, *types, strict=True).start(arguments, count, 1)() for kind in kinds]
    return zip(*map(jax.tree.leaves, results), strict=True)


@pytest.mark.parametrize("name", EVERYTHING)
def test_operations_have_the_bits_of_strict_arithmetic(name):
    types = [jax.ShapeDtypeStruct((), column.dtype) for column in (X, PLACES)]
    with np.errstate(all="ignore"):
        for gpu, processor in both(EVERYTHING[name], (X, PLACES), types, len(X)):
            np.testing.assert_array_equal(gpu, processor)


@pytest.mark.parametrize("real", [np.float64, np.float32])
@pytest.mark.parametrize("count", [1, THREADS, THREADS + 1, 100_003])
def test_functions_and_recordings_have_the_bits_of_strict_arithmetic(real, count):
    def lane(x):
        return every_function(x), recorded(x)

    x = np.linspace(-1.0, 1.0, count).astype(real)
    for gpu, processor in both(lane, (x,), [jax.ShapeDtypeStruct((), real)], count):
        assert gpu.dtype == processor.dtype
        np.testing.assert_array_equal(gpu, processor)


def test_two_batches_at_a_time():
    x = np.linspace(0.1, 3.0, 7)
    kernel = KernelLanes(recorded, jax.ShapeDtypeStruct((), np.float64))
    finish = [kernel.start((x,), 7, 1) for _ in range(2)]
    plain = jax.jit(jax.vmap(recorded))(x)
    for wait in finish:
        for column, expected in zip(*map(jax.tree.leaves, (wait(), plain)), strict=True):
            np.testing.assert_allclose(column, expected, rtol=1e-14)


def test_what_the_driver_says_of_a_kernel_is_shown():
    with pytest.raises(GpuError, match="CUDA_ERROR_INVALID_PTX"):
        driver().kernel(b".version 7.4\n.target sm_80\n.address_size 64\nnonsense\n", "lanes")


def test_too_large_a_batch_is_refused_and_the_next_one_runs():
    kernel = KernelLanes(lambda x: x + 1.0, jax.ShapeDtypeStruct((), np.float64), strict=True)
    gpu = driver()
    with pytest.raises(GpuError, match="OUT_OF_MEMORY; run smaller blocks"):
        gpu.reserve(2**50)
    assert kernel.start((np.zeros(3),), 3, 1)().tolist() == [1.0, 1.0, 1.0]
