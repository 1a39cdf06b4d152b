"""A vehicle's lanes on 64-bit ARM have the bits of strict arithmetic here: 128-bit vectors (NEON), emulated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.engine.batching import lane_of_study, values_of_draws
from dssc_jax.lanes.lanes import CompiledLanes
from tests.lanes.lanes_on_arm import ArmLanes, needs_arm

COUNT = 24


@needs_arm
@pytest.mark.parametrize(("precision", "width"), [(64, 4), (32, 4)])
def test_vehicles_have_the_same_bits(precision, width, tmp_path):
    """The study of 30 uncertain vehicles in wind, for a quarter of a second."""
    changes = {"draws": COUNT, "loop.duration": 0.25, "loop.precision": precision, "requirement": []}
    study = dj.Study.load("studies/uav_robustness.toml").override(changes).without_sweep()
    with jax.enable_x64(precision == 64):
        real = jnp.result_type(float)
        values = {name: np.asarray(column, real) for name, column in values_of_draws(study, slice(0, COUNT)).items()}
        index = np.arange(COUNT, dtype=np.uint32)
        types = jax.tree.map(lambda column: jax.ShapeDtypeStruct((), column.dtype), (values, index))
        program = lane_of_study(study, axis_name=None)
        results = ArmLanes(tmp_path, program, *types, strict=True, width=width).start((values, index), COUNT, 1)()
        expected = CompiledLanes(program, *types, strict=True).start((values, index), COUNT, 1)()
    numbers = jax.tree.leaves(expected)
    assert len(numbers) > 10
    for column, reference in zip(jax.tree.leaves(results), numbers, strict=True):
        np.testing.assert_array_equal(column, reference)
