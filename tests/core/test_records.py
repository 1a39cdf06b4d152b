"""The mean of a held record over an interval."""

import jax
import numpy as np
import pytest

from dssc_jax.core.records import Interpolation, cubic_pieces, held_mean, held_record

TIMES = (0.0, 0.33, 0.71, 1.234, 2.0)
VALUES = (1.0, -1.0, 2.0, 0.0, 0.5)
DT = 0.1


def means(times, values, begins, dt=DT):
    """Means over the intervals [begin, begin + dt), by a compiled program."""
    record = held_record(cubic_pieces(times, values, Interpolation.HOLD))
    return np.array(jax.jit(jax.vmap(lambda t: held_mean(record, t, dt)))(np.asarray(begins)))


@pytest.mark.parametrize("dt", [0.1, 0.7, 3.0])
def test_it_is_the_mean_of_the_values_at_many_instants(dt):
    """Also before the first time, after the last, and over several values at once."""
    begins = np.arange(-8, 40) * 0.1
    share = (np.arange(20_000) + 0.5) / 20_000
    places = np.searchsorted(TIMES, begins[:, None] + share * dt, side="right") - 1
    expected = np.asarray(VALUES)[np.maximum(places, 0)].mean(axis=1)
    np.testing.assert_allclose(means(TIMES, VALUES, begins, dt), expected, atol=3e-4)


def test_values_on_the_grid_keep_their_bits():
    """Although the times of samples, k T_s, and of the record differ by roundings."""
    values = np.random.default_rng(1).normal(size=300)
    times = np.array([float(f"{k / 10:g}") for k in range(300)])
    assert (times != np.arange(300) * DT).any()
    np.testing.assert_array_equal(means(tuple(times), tuple(values), np.arange(300) * DT), values)


def test_values_that_alternate_within_each_interval_cancel():
    values = np.resize([1.0, -1.0], 60)
    np.testing.assert_allclose(means(tuple(np.arange(60) * DT / 2), tuple(values), np.arange(30) * DT), 0.0, atol=1e-12)
