"""Time that stops when every draw has ended."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from dssc_jax.closed_loop.time_loops import CHECK_INTERVAL, scan_recorded, until_all_ended

STEPS = 1000


class Counting(NamedTuple):
    """A draw that flies for so many samples, and counts those that were computed."""

    k: jax.Array
    end: jax.Array
    computed: jax.Array


def counted(ends):
    def sample(at):
        return Counting(at.k + 1, at.end, at.computed + 1)

    def single(end):
        zero = jnp.zeros((), jnp.int32)
        at = Counting(zero, end, zero)
        return until_all_ended(sample, lambda at: at.k < at.end, at, STEPS, "tile").computed

    return np.asarray(jax.jit(jax.vmap(single, axis_name="tile"))(jnp.asarray(ends)))


@pytest.mark.parametrize(
    ("ends", "computed"),
    [
        ([STEPS, 3], STEPS),  # one flies on: all are computed to the end
        ([10, 3], CHECK_INTERVAL),
        ([CHECK_INTERVAL + 1, 0], 2 * CHECK_INTERVAL),
        ([0, 0], 0),
        ([STEPS + 7, STEPS + 7], STEPS),  # never beyond the last sample
    ],
)
def test_a_tile_stops_at_the_first_look_without_a_flying_draw(ends, computed):
    assert counted(ends).tolist() == [computed, computed]


@pytest.mark.parametrize("stride", [1, 3, 7, 8])
def test_a_recording_holds_every_nth_sample_and_ends_with_the_last(stride):
    def sample(at):
        return Counting(at.k + 1, at.end, at.computed + at.k), at.k

    zero = jnp.zeros((), jnp.int32)
    end, recorded = scan_recorded(sample, Counting(zero, zero, zero), 8, stride)
    assert np.asarray(recorded).tolist() == list(range(0, 8, stride))
    assert (int(end.k), int(end.computed)) == (8, sum(range(8)))
