"""Outputs that begin elsewhere than the study: what a difference that lasts says of other numbers."""

import numpy as np

from dssc_jax.flight_logs.fit.start_doubts import effect_text


def test_a_constant_difference_of_the_starts_moves_no_estimate():
    noise = 0.003 * np.random.default_rng(0).normal(size=300)
    assert "hardly take any of it" in effect_text(0.35 + noise, 0.35, 0.003)
    assert "are wrong then" in effect_text(0.35 * np.linspace(1.0, 0.0, 300) + noise, 0.35, 0.003)
