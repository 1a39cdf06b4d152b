"""The direction of a descent."""

import math

import numpy as np
import pytest

from dssc_jax.analyses.tuning.descent import Multipliers
from dssc_jax.analyses.tuning.objective import Merit
from dssc_jax.analyses.tuning.problem import EvaluatedPoint

CHATTER = np.array([3e107, -8e107])


def point(gradient, excess):
    """A point with one limit, whose excess grows along the first coordinate."""
    merit = Merit(1.0, {}, {"command_tv": excess}, {}, ended=0)
    return EvaluatedPoint(np.zeros(2), merit, np.array(gradient), {"command_tv": np.array([1.0, 0.0])})


@pytest.mark.parametrize("gradient", [CHATTER, [np.inf, 1.0], [1.0, np.nan]])
def test_a_limit_that_chatter_exceeds_decides_alone(gradient):
    direction = Multipliers(1.0).gradient(point(gradient, excess=0.1))
    assert direction[0] > 0.0
    assert direction[1] == 0.0


@pytest.mark.parametrize("gradient", [[-2.0, 3.0], [-2e3, 3e3]])
def test_a_slope_counts_beside_a_limit(gradient):
    direction = Multipliers(2.0).gradient(point(gradient, excess=0.1))
    assert direction[1] == 0.5 * gradient[1]
    assert direction[0] > 0.5 * gradient[0]


def test_a_slope_counts_where_no_limit_pushes():
    np.testing.assert_array_equal(Multipliers(1.0).gradient(point(CHATTER, excess=-0.5)), CHATTER)


@pytest.mark.parametrize("gradient", [[np.nan, np.nan], [np.inf, 1.0]])
def test_a_slope_of_a_flight_that_ended_early_moves_nothing(gradient):
    """Without excesses no limit pushes, and the optimiser would keep a NaN."""
    ended = EvaluatedPoint(np.zeros(2), Merit(math.inf, {}, {}, {}, ended=1), np.array(gradient), {})
    np.testing.assert_array_equal(Multipliers(1.0).gradient(ended), np.zeros(2))


def test_gaps_stay_where_a_training_flight_ended_early():
    multipliers = Multipliers(1.0)
    multipliers.gaps = {"command_tv": 0.3}
    ended = EvaluatedPoint(np.zeros(2), Merit(math.inf, {}, {}, {}, ended=1), np.zeros(2), {})
    multipliers.update(ended, point([1.0, 1.0], excess=0.2))
    assert multipliers.gaps == {"command_tv": 0.3}
