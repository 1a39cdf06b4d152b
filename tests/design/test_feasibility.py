"""How far certificates reach, and designs for a goal."""

import numpy as np
import pytest

from dssc_jax.core.errors import ConfigError
from dssc_jax.design import Bounds, Free, certified, check, guarantee, small_gain, synthesise
from dssc_jax.design.bounds import DISTURBANCE_FIELDS
from dssc_jax.design.feasibility import (
    RANGES,
    Criterion,
    DesignGoal,
    edges,
    limits,
    optimise,
    scaled_bounds,
)
from dssc_jax.design.practice import practice

BOUNDS = Bounds(0.9, 1.1, 1.0, alpha_d3=0.1, alpha_d=1.0, k_d4=0.05)
FREE = Free(0.5, 0.1, 0.3, 0.5, 2.0, 0.1, 6.0)


def test_limits_are_edges():
    """Just inside the certificate exists, just outside it does not; phi_b's edge is the small gain's."""
    p = synthesise(BOUNDS, FREE)
    found = limits(p, BOUNDS)
    assert found.phi_b == pytest.approx(max(small_gain(p, BOUNDS).derived, p.l0 / p.eps), rel=1e-9)
    inside, outside = 1 - 1e-6, 1 + 1e-6
    assert certified(p, scaled_bounds(BOUNDS, inside * found.disturbance))
    assert not certified(p, scaled_bounds(BOUNDS, outside * found.disturbance))
    assert certified(p, BOUNDS._replace(k_min=outside * found.k_min))
    assert not certified(p, BOUNDS._replace(k_min=inside * found.k_min))
    assert certified(p, BOUNDS._replace(k_max=inside * found.k_max))
    assert not certified(p, BOUNDS._replace(k_max=outside * found.k_max))
    assert certified(p, BOUNDS._replace(a_max=inside * found.a_max))
    assert not certified(p, BOUNDS._replace(a_max=outside * found.a_max))


def test_limits_of_what_does_not_matter_or_is_not_certified():
    p = synthesise(BOUNDS._replace(k_d4=0.0), FREE)
    assert limits(p, BOUNDS._replace(k_d4=0.0)).disturbance == np.inf
    assert np.isnan(limits(p._replace(phi_b=0.1), BOUNDS).phi_b)


def test_scaling_touches_the_disturbance_only():
    changed = {name for name in Bounds._fields if getattr(scaled_bounds(BOUNDS, 2.0), name) != getattr(BOUNDS, name)}
    assert changed <= set(DISTURBANCE_FIELDS)


@pytest.mark.parametrize("criterion", list(Criterion))
def test_the_optimum_beats_random_candidates(criterion):
    """Certified, within the goal's limits, and no worse than the best of 3,000 random candidates that meet them."""
    goal = DesignGoal(criterion, residual=0.5, sample_time=1e-3)
    best = optimise(BOUNDS, FREE, goal)
    p = synthesise(BOUNDS, best)
    assert check(p, BOUNDS).certified
    assert guarantee(p, BOUNDS).e <= goal.residual * (1 + 1e-9)
    assert practice(p, BOUNDS).sample_time_origin >= goal.sample_time * (1 - 1e-9)
    rng = np.random.default_rng(1)
    value = score(p, criterion)
    rivals = []
    for _ in range(3000):
        logs = {name: np.exp(rng.uniform(*np.log(box))) for name, box in RANGES.items()}
        rival = synthesise(BOUNDS, FREE._replace(**logs))
        if (
            guarantee(rival, BOUNDS).e <= goal.residual
            and practice(rival, BOUNDS).sample_time_origin >= goal.sample_time
        ):
            rivals.append(score(rival, criterion))
    assert len(rivals) > 20
    assert value <= min(rivals)


def score(p, criterion):
    promised = guarantee(p, BOUNDS)
    return {
        Criterion.RESIDUAL: promised.e,
        Criterion.DECAY_RATE: -promised.decay_rate,
        Criterion.GAIN: (p.kappa_c**2 + p.kappa_d) * (p.phi_a / p.delta + p.phi_b),
        Criterion.PHI_B: p.phi_b,
    }[criterion]


def test_an_infeasible_goal_says_how_near_it_comes():
    with pytest.raises(ConfigError, match=r"goal: no design in the ranges has residual <= 1e-09 m and sample_time"):
        optimise(BOUNDS, FREE, DesignGoal(Criterion.GAIN, residual=1e-9, sample_time=1e-2))


def test_a_parameter_at_the_end_of_its_range_is_told():
    """The smallest residual wants l0 as large as it may be, whatever that is."""
    ranges = {"l0": (0.1, 2.0), "eps_3": (1.0, 20.0)}
    best = optimise(BOUNDS, FREE, DesignGoal(Criterion.RESIDUAL), ranges)
    assert [text.split(" = ")[0] for text in edges(best, ranges)] == ["l0", "eps_3"]
    assert edges(best._replace(l0=0.5), ranges)[0].startswith("eps_3 = 20 is the upper end")
    assert edges(best._replace(l0=0.1, eps_3=5.0), ranges)[0].startswith("l0 = 0.1 is the lower end")


@pytest.mark.parametrize(
    ("ranges", "message"),
    [({"epsi": (0.1, 1.0)}, "vary.epsi: unknown name; did you mean 'eps'"), ({"l0": (1.0, 0.1)}, "0 < low < high")],
)
def test_bad_ranges(ranges, message):
    with pytest.raises(ConfigError, match=message):
        optimise(BOUNDS, FREE, DesignGoal(), ranges)
