"""Sums of squares with steps, as limits and samples within a plant make them."""

import numpy as np
import pytest

from dssc_jax.flight_logs.fit.least_squares import NormalEquations
from dssc_jax.flight_logs.fit.minima import Minimum, neighbouring_minimum
from dssc_jax.flight_logs.fit.roughness import roughness, roughness_doubts, widening
from dssc_jax.flight_logs.fit.search_limits import SearchCount

NAMES = ("a", "b")
INFORMATION = np.array([[400.0, 90.0], [90.0, 100.0]])


class Stepped:
    """A parabola around the origin, lowered by a step beyond a line; derivatives know nothing of the step."""

    def __init__(self, step):
        self.names = NAMES
        self.step = step
        self.count = SearchCount()

    def values(self, x):
        return x

    def is_admissible(self, values):
        return True

    def normal_equations(self, x):
        self.count.add()
        lowered = self.step if x[0] > 0.05 else 0.0
        return NormalEquations(float(x @ INFORMATION @ x) - lowered, -INFORMATION @ x, INFORMATION)


def at_origin(problem):
    return Minimum(np.zeros(2), problem.normal_equations(np.zeros(2)), 1)


def test_a_parabola_is_left_alone():
    problem = Stepped(0.0)
    minimum = at_origin(problem)
    assert roughness(problem, minimum) < 1e-12
    assert widening(roughness(problem, minimum)) == 1.0
    assert roughness_doubts(0.0) == ()
    assert neighbouring_minimum(problem, minimum).cost == pytest.approx(0.0, abs=1e-9)


def test_better_points_beyond_a_step_are_found():
    """The origin has the cost 0. The best point is on the line, where the parabola is 0.05^2 (400 - 90^2/100)."""
    problem = Stepped(20.0)
    found = neighbouring_minimum(problem, at_origin(problem))
    assert found.x[0] > 0.05
    assert found.cost < -18.0
    assert found.cost > 0.05**2 * (400.0 - 81.0) - 20.0 - 1e-9


def test_steps_widen_intervals_and_are_told():
    problem = Stepped(20.0)
    rough = roughness(problem, at_origin(problem))
    assert 5.0 < rough < 20.0
    assert widening(rough) == rough
    (doubt,) = roughness_doubts(rough)
    assert "all intervals are widened" in doubt.text
