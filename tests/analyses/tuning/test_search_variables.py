"""Coordinates without bounds, and the certified design behind them."""

import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.analyses.tuning.plan import Plan
from dssc_jax.analyses.tuning.search_variables import SearchCoordinates
from tests.analyses.tuning.cases import CERTIFIED, SMALL

STEP = 1e-6


@pytest.fixture(scope="module", params=[SMALL, CERTIFIED], ids=["plain", "certified"])
def coordinates(request):
    return Plan.of(dj.Study.from_table(request.param)).coordinates


def test_the_start_is_the_start(coordinates):
    found = coordinates.tuned(coordinates.origin)
    assert {name: float(value) for name, value in found.items()} == pytest.approx(coordinates.start, rel=1e-12)


def test_inside_everywhere():
    coordinates = SearchCoordinates({"a": (0.1, 2.0)}, {"a": 1.0})
    z = np.array([[-1e3], [-5.0], [0.0], [5.0], [1e3]])
    values = coordinates.numbers(z)["a"]
    assert np.all((values >= 0.1 * (1 - 1e-15)) & (values <= 2.0 * (1 + 1e-15)))
    assert np.all(np.diff(values) > 0.0)
    assert values[2] == pytest.approx(np.sqrt(0.2), rel=1e-14)


def test_slopes_are_those_of_the_numbers(coordinates):
    z = np.random.default_rng(0).normal(size=(20, len(coordinates.names)))
    slopes = coordinates.slopes(z)
    for i in range(z.shape[1]):
        shift = STEP * np.eye(z.shape[1])[i]
        above, below = coordinates.numbers(z + shift), coordinates.numbers(z - shift)
        for name in above:
            central = (above[name] - below[name]) / (2.0 * STEP)
            scale = np.abs(central) + 1e-4 * np.abs(above[name])
            # where a maximum of Table 1 changes sides the two slopes differ: at few points, or none
            assert np.mean(np.abs(slopes[name][:, i] - central) <= 1e-5 * scale) >= 0.95, name


def test_every_point_is_certified():
    """All over the intervals, ends included: the design and the strict check of what is simulated agree."""
    plan = Plan.of(dj.Study.from_table(CERTIFIED))
    rng = np.random.default_rng(1)
    for z in (*rng.normal(scale=3.0, size=(25, len(plan.coordinates.names))), np.full(6, 40.0), np.full(6, -40.0)):
        numbers = {name: float(value[0]) for name, value in plan.coordinates.numbers(z[None]).items()}
        assert plan.theorem.certificate(numbers).certified
