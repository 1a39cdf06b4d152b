"""Functions of C within lanes: one call a lane, no memory between calls, the same in plain XLA."""

import ctypes
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax import lanes
from dssc_jax.lanes import foreign
from dssc_jax.lanes.foreign import ForeignFunction, MemoryPlace
from dssc_jax.lanes.unsupported import Unsupported

SOURCE = """
#include <stdint.h>
typedef struct { double x; uint64_t count; float narrow; uint32_t left; double sum; } memory;
void accumulate(void *pointer)
{
    memory *const m = pointer;
    m->left += 7;               /* what the call before left, if the memory were not cleared */
    m->count += 1;
    m->sum = m->x * (double)m->count + m->narrow;
}
"""


def place(kind, offset):
    return MemoryPlace(np.dtype(kind), offset)


X, COUNT, NARROW, LEFT, SUM = place("f8", 0), place("u8", 8), place("f4", 16), place("u4", 20), place("f8", 24)
ACCUMULATE = ForeignFunction("tests_accumulate", 32, (X, COUNT, NARROW), (COUNT, LEFT, SUM))


@pytest.fixture(scope="module", autouse=True)
def library(tmp_path_factory):
    if shutil.which("cc") is None:
        pytest.skip("needs cc")
    folder = tmp_path_factory.mktemp("foreign")
    (folder / "f.c").write_text(SOURCE)
    subprocess.run(["cc", "-O1", "-shared", "-fPIC", folder / "f.c", "-o", folder / "f.so"], check=True)
    loaded = ctypes.CDLL(str(folder / "f.so"))
    foreign.provide(ACCUMULATE.symbol, ctypes.cast(loaded.accumulate, ctypes.c_void_p).value)
    return loaded


def lane(x, narrow):
    """Thirty calls in a row, with the count carried as a word."""

    def turn(_, carry):
        count, total, left = carry
        count, new_left, term = foreign.call(ACCUMULATE, x, count, narrow)
        return count, total + term, jnp.maximum(left, new_left)

    begin = (jnp.zeros((), jnp.uint64), jnp.zeros(()), jnp.zeros((), jnp.uint32))
    return jax.lax.fori_loop(0, 30, turn, begin)


@pytest.mark.parametrize("strict", [False, True])
def test_lanes_equal_the_closed_form(strict):
    xs = np.linspace(-1.0, 1.0, 77)
    narrow = np.float32(0.1) * np.ones(77, np.float32)
    count, total, left = lanes.compile(lane, 1.0, np.float32(1.0), strict=strict)(xs, narrow)
    assert (count == 30).all()
    assert (left == 7).all()
    np.testing.assert_allclose(total, 465.0 * xs + 30.0 * np.float64(np.float32(0.1)), rtol=1e-13, atol=1e-12)


def test_plain_xla_gives_the_same_bits():
    """Through a callback, whose numbers keep their 64 bits; nested batches too."""
    xs = np.linspace(-1.0, 1.0, 12).reshape(3, 4) / 3.0
    narrow = np.ones((3, 4), np.float32) / np.float32(3.0)
    plain = jax.jit(jax.vmap(jax.vmap(lane)))(xs, narrow)
    compiled = lanes.compile(lane, 1.0, np.float32(1.0), strict=True)(xs.ravel(), narrow.ravel())
    for ours, theirs in zip(compiled, plain, strict=True):
        np.testing.assert_array_equal(ours, np.asarray(theirs).ravel())


def test_what_does_not_vary_is_shared_by_no_lane():
    """A call whose operands are the same in every lane counts as different in each."""
    batch = lanes.compile(lambda x: x + foreign.call(ACCUMULATE, 2.0, np.uint64(1), np.float32(0.5))[2], 1.0)
    np.testing.assert_array_equal(batch(np.arange(5.0)), np.arange(5.0) + 4.5)


def test_it_has_no_derivative():
    with pytest.raises(Unsupported, match="a derivative of native code: tests_accumulate"):
        jax.grad(lambda x: lane(x, np.float32(1.0))[1])(1.0)


def test_wrong_operands_are_refused():
    with pytest.raises(TypeError, match="takes 3 operands, got 1"):
        foreign.call(ACCUMULATE, 1.0)
    with jax.enable_x64(False), pytest.raises(TypeError, match="needs 64 bits in JAX"):
        foreign.call(ACCUMULATE, 1.0, 1, 1.0)
