"""The states of a flight about which its loop is linearised."""

import numpy as np
from jax.flatten_util import ravel_pytree

from dssc_jax.analyses.loop_margins.operating_points import states_in_flight
from dssc_jax.closed_loop.first_state import initial_state
from dssc_jax.closed_loop.sample import step
from dssc_jax.engine.sampling import draw, draw_key


def test_they_are_those_of_the_samples_one_after_the_other(uncertain):
    """The reference is a sine: at a sample too early, the states would differ by what it moves in a sample."""
    study = uncertain.override({"sweep": {}})
    indices = np.arange(2)
    values = draw(study, indices)
    samples = (0, 1, 2, 7)
    states = states_in_flight(study, values, indices, samples)
    for lane in range(2):
        params = study.params({name: column[lane] for name, column in values.items()})
        key = draw_key(study.config.seed, indices[lane])
        state = initial_state(study.loop, params, key)
        flown = {}
        for k in range(8):
            flown[k] = ravel_pytree(state)[0]
            state, _ = step(study.loop, params, key, state, k)
        for k, recorded in zip(samples, states, strict=True):
            np.testing.assert_allclose(recorded[lane], flown[max(k, 1)], rtol=1e-12, atol=1e-14)
