"""Lanes on 64-bit ARM have the bits of strict arithmetic here: 128-bit vectors (NEON), emulated."""

import re

import jax
import numpy as np
import pytest

from dssc_jax.lanes.lanes import CompiledLanes
from tests.lanes.lanes_on_arm import ArmLanes, needs_arm
from tests.lanes.test_gpu import every_function, recorded

VECTOR = re.compile(r"\tfmul\tv\d+\.(2d|4s)")
COUNT = 24

pytestmark = needs_arm


def lane(x):
    return every_function(x), recorded(x)


@pytest.mark.parametrize(("real", "width"), [(np.float64, 1), (np.float64, 2), (np.float64, 8), (np.float32, 4)])
def test_functions_have_the_same_bits(real, width, tmp_path):
    with jax.enable_x64(real is np.float64):
        number = jax.ShapeDtypeStruct((), real)
        x = np.linspace(-3.0, 3.0, COUNT, dtype=real)
        emulated = ArmLanes(tmp_path, lane, number, strict=True, width=width)
        here = CompiledLanes(lane, number, strict=True)
        assert (VECTOR.search(emulated.assembly) is not None) == (width > 1)
        results = emulated.start((x,), COUNT, 1)()
        expected = here.start((x,), COUNT, 1)()
    for column, reference in zip(*map(jax.tree.leaves, (results, expected)), strict=True):
        assert column.dtype == reference.dtype
        np.testing.assert_array_equal(column, reference)
