"""Estimates several times beyond their laws are refused where a fit is poor."""

from types import SimpleNamespace

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.possible_values import require_possible
from dssc_jax.flight_logs.fit.refusals import Explained, Unexplained
from tests.flight_logs.closed_loop import study_of

GOOD = Explained(residual=0.003, noise=0.003, output=1.0, independent=9.0, limit=0.004, reading_noise=0.003)
POOR = GOOD._replace(residual=0.34)


def problem_of(value):
    """A problem whose best k_p is a value, and lies 2 standard deviations beyond its law."""
    study = study_of()
    return SimpleNamespace(
        study=study,
        names=("plant.k_p",),
        laws=[study.laws["plant.k_p"]],
        is_kept=np.array([False]),
        values=lambda x: np.array([value]),
        beyond_laws=lambda x: np.array([2.0]),
    )


def test_a_tiny_gain_beside_its_law_is_refused_where_the_fit_is_poor():
    with pytest.raises(Unexplained, match=r"best value of plant.k_p is 0.0102"):
        require_possible(problem_of(0.0102), np.zeros(1), [POOR])
    require_possible(problem_of(0.0102), np.zeros(1), [GOOD])
    require_possible(problem_of(0.4), np.zeros(1), [POOR])
