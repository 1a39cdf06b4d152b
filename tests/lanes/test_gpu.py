"""Lanes on a GPU, as far as that goes without one: PTX, its assembly by NVIDIA's ptxas, and the program in threads."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.lanes.gpu import ptx
from dssc_jax.lanes.gpu.driver import GpuError, driver
from dssc_jax.lanes.gpu.kernel_lanes import THREADS, KernelLanes
from dssc_jax.lanes.gpu.kernel_text import TracedKernel
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.unsupported import Unsupported
from tests.lanes.assembler import ARCHITECTURES, assembled
from tests.lanes.gpu_on_cpu import emulated
from tests.lanes.test_translation import CASES, PLACES, X

ARITHMETIC = re.compile(r"^\s+((?:add|sub|mul|fma|mad|div|sqrt|rcp)\.\S*f(?:32|64))", re.MULTILINE)
EVERYTHING = {name: case for name, case in CASES.items() if name != "remainder"}


FUNCTIONS = (
    *(jnp.sin, jnp.cos, jnp.tan, jnp.exp, jnp.exp2, jnp.expm1, jnp.sinh, jnp.cosh, jnp.tanh, jax.nn.sigmoid),
    *(jnp.arctan, jax.lax.erf_inv, lambda x: jnp.log(jnp.abs(x)), lambda x: jnp.log1p(x * x), jnp.arcsin, jnp.arccos),
    *(
        lambda x: jnp.arctan2(x, -0.3),
        lambda x: jnp.abs(x) ** 2.7,
        lambda x: jnp.sqrt(jnp.abs(x)),
        jnp.floor,
        jnp.round,
    ),
)


def every_function(x):
    """A number through the elementary functions, and a random one."""
    total = jnp.maximum(x, 0.5) / (2.0 + x)
    for function in FUNCTIONS:
        total = total + function(x)
    return total + jax.random.normal(jax.random.key(3))


def recorded(x):
    """Every state of a short loop, and its sum."""
    return jax.lax.scan(lambda s, k: (s * x + k, s > x), x, jnp.arange(5.0, dtype=x.dtype))


def instructions(strict, real):
    kernel = TracedKernel(every_function, (jax.ShapeDtypeStruct((), real),), strict)
    return ptx.ptx(kernel.text).decode()


@pytest.mark.parametrize("real", [np.float64, np.float32])
def test_strict_arithmetic_rounds_every_result_to_nearest(real):
    """Without ``.rn`` the assembler may contract a product and a sum."""
    found = ARITHMETIC.findall(instructions(True, real))
    assert len(found) > 50
    assert {name.split(".")[1] for name in found} == {"rn"}
    assert not any(name.startswith(("fma", "mad")) or ".ftz" in name or ".approx" in name for name in found)
    fast = ARITHMETIC.findall(instructions(False, real))
    assert any(name.startswith("fma.rn") for name in fast)
    assert not any(".ftz" in name or ".approx" in name for name in fast)


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_the_assembler_takes_it(architecture):
    kernel = TracedKernel(every_function, (jax.ShapeDtypeStruct((), np.float64),), False)
    usage = assembled(ptx.ptx(kernel.text), architecture)
    assert 16 < usage.registers <= 255


@pytest.mark.parametrize(("real", "limited"), [(np.float32, True), (np.float64, False)])
def test_single_precision_leaves_room_for_two_blocks(real, limited):
    """A multiprocessor has 65,536 registers."""
    code = instructions(True, real)
    assert (f".maxnreg {65536 // (2 * THREADS)}\n" in code) == limited


def test_the_assembler_refuses_what_is_wrong():
    with pytest.raises(ValueError, match="syntax error"):
        assembled(b".version 7.4\n.target sm_80\n.address_size 64\nnonsense\n", ARCHITECTURES[0])


@pytest.mark.parametrize("name", EVERYTHING)
def test_threads_have_the_bits_of_strict_arithmetic(name, monkeypatch):
    types = [jax.ShapeDtypeStruct((), column.dtype) for column in (X, PLACES)]
    with np.errstate(all="ignore"), emulated(monkeypatch):
        kernel = KernelLanes(EVERYTHING[name], *types, strict=True).start((X, PLACES), len(X), 1)()
        vectors = CompiledLanes(EVERYTHING[name], *types, strict=True).start((X, PLACES), len(X), 1)()
    np.testing.assert_array_equal(kernel, vectors)


@pytest.mark.parametrize("count", [1, THREADS, THREADS + 1])
def test_a_batch_of_any_size_has_the_bits_of_each_lane(count, monkeypatch):
    def lane(x):
        return every_function(x), recorded(x)

    x = np.linspace(-1.0, 1.0, count)
    number = jax.ShapeDtypeStruct((), np.float64)
    with emulated(monkeypatch) as library:
        results = KernelLanes(lane, number, strict=True).start((x,), count, 1)()
        assert library.calls.count("cuLaunchKernel") == 1
        assert not library.blocks
    expected = CompiledLanes(lane, number, strict=True, width=1).start((x,), count, 1)()
    for column, reference in zip(*map(jax.tree.leaves, (results, expected)), strict=True):
        assert column.dtype == reference.dtype
        np.testing.assert_array_equal(column, reference)


def test_two_batches_at_a_time(monkeypatch):
    x = np.linspace(0.1, 3.0, 7)
    number = jax.ShapeDtypeStruct((), np.float64)
    with emulated(monkeypatch) as library:
        kernel = KernelLanes(recorded, number)
        finish = [kernel.start((x,), 7, 1) for _ in range(2)]
        one, other = [wait() for wait in finish]
        assert library.calls.count("cuStreamCreate") == library.calls.count("cuStreamDestroy_v2") == 2
    plain = jax.jit(jax.vmap(recorded))(x)
    for first, second, expected in zip(*map(jax.tree.leaves, (one, other, plain)), strict=True):
        np.testing.assert_array_equal(first, second)
        np.testing.assert_allclose(first, expected, rtol=1e-14)


def test_memory_goes_back_where_the_driver_refuses_more(monkeypatch):
    number = jax.ShapeDtypeStruct((), np.float64)
    with emulated(monkeypatch, memory=1000) as library:
        kernel = KernelLanes(jnp.exp, number, strict=True)
        with pytest.raises(GpuError, match=r"cuMemAlloc_v2 .* CUDA_ERROR_OUT_OF_MEMORY; run smaller blocks"):
            kernel.start((np.ones(100),), 100, 1)
        assert not library.blocks
        assert kernel.start((np.zeros(3),), 3, 1)().tolist() == [1.0, 1.0, 1.0]


def test_what_the_driver_says_of_a_kernel_is_shown(monkeypatch):
    with emulated(monkeypatch), pytest.raises(GpuError, match=r"CUDA_ERROR_INVALID_PTX: LLVM IR parsing error"):
        driver().kernel(b"nonsense", "lanes")


def test_an_old_gpu_is_refused(monkeypatch):
    with (
        emulated(monkeypatch, capability=(7, 5)),
        pytest.raises(GpuError, match=r"compute capability 7\.5, lanes need 8\.0"),
    ):
        driver()


def test_what_is_not_exact_on_a_gpu_is_refused():
    number = jax.ShapeDtypeStruct((), np.float64)
    with pytest.raises(Unsupported, match="'rem' of float64: it is not exact on a GPU; run the study on a CPU"):
        TracedKernel(CASES["remainder"], (number, jax.ShapeDtypeStruct((), np.int32)), True)
