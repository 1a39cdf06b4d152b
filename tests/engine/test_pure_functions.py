"""The loop as pure functions: the numbers of a run, derivatives, and what they refuse."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import dssc_jax as dj
from dssc_jax.core.errors import ConfigError
from tests.conftest import UNCERTAIN
from tests.tolerances import COMPILER

DRAWS = 4


@pytest.fixture(scope="module")
def study():
    return dj.Study.from_table(UNCERTAIN | {"draws": DRAWS, "sweep": {}})


@pytest.fixture(scope="module")
def result(study):
    return dj.run(study).dataset


def test_a_mapped_lane_gives_the_numbers_of_a_run(study, result):
    lane = dj.lane(study)
    computed = jax.jit(jax.vmap(lane))(*lane.draws())
    for name in ("error_rms", "command_tv", "slack_error_max_after_2", "outcome"):
        stored = result[name].values
        np.testing.assert_allclose(computed[name], stored, rtol=COMPILER, atol=COMPILER)


def test_the_example_is_the_first_draw(study, result):
    lane = dj.lane(study)
    values, index = lane.example
    assert set(values) == set(study.laws)
    computed = jax.jit(lane)(values, index)
    np.testing.assert_allclose(computed["error_rms"], result["error_rms"].values[0], rtol=COMPILER)


@pytest.mark.parametrize("segment", [None, 20])
def test_a_gradient_is_that_of_finite_differences(study, segment):
    lane = dj.lane(study, segment)
    values, index = lane.example
    names = ("plant.k_p", "controller.functions.kappa1")
    start = values | {"controller.functions.kappa1": np.float64(1.0)}

    @jax.jit
    def error(numbers):
        return lane(start | numbers, index)["error_rms"]

    at = {name: start[name] for name in names}
    slopes = jax.jit(jax.grad(error))(at)
    for name in names:
        width = 1e-5
        difference = error(at | {name: at[name] + width}) - error(at | {name: at[name] - width})
        np.testing.assert_allclose(slopes[name], difference / (2.0 * width), rtol=1e-5)  # width^2 and rounding/width


def test_steps_of_ones_own_loop_are_those_of_simulate(study):
    loop = dj.stepper(study)
    trajectory = dj.simulate(study, draw=0)

    @jax.jit
    def simulated(values, key):
        begin = loop.init(values, key)
        return jax.lax.scan(lambda state, _: loop.step(state), begin, length=study.loop.steps)

    end, info = simulated(*loop.example)
    assert int(end.k) == study.loop.steps
    np.testing.assert_allclose(info.instant.channels[0].e, trajectory["e"].values, rtol=COMPILER, atol=COMPILER)
    assert bool(jnp.all(info.finite))


def test_a_step_depends_on_its_state_alone(study):
    loop = dj.stepper(study)
    step = jax.jit(loop.step)
    state = loop.init(*loop.example)
    first = step(state)[0]
    second = step(state)[0]
    assert jax.tree.all(jax.tree.map(jnp.array_equal, first.loop, second.loop))


@pytest.mark.parametrize("make", [lambda study: dj.lane(study), lambda study: dj.stepper(study).init])
def test_values_are_checked_by_name(study, make):
    accepts = make(study)
    values, _ = dj.lane(study).example
    key = dj.stepper(study).key(0) if make(study).__class__.__name__ == "method" else 0
    with pytest.raises(ConfigError, match=r"plant.a_p: is uncertain or swept"):
        accepts({name: value for name, value in values.items() if name != "plant.a_p"}, key)
    with pytest.raises(ConfigError, match=r"did you mean 'plant.k_p'"):
        accepts(values | {"plant.kp": 1.0}, key)


def test_another_precision_than_the_studys_is_refused(study):
    lane = dj.lane(study)
    values, index = lane.example
    with jax.enable_x64(False), pytest.raises(ConfigError, match=r"loop.precision: is 64, and JAX computes in 32 bits"):
        lane(values, index)


@pytest.mark.parametrize("count", [0, DRAWS + 1])
def test_only_draws_of_the_study_are_given(study, count):
    with pytest.raises(ConfigError, match=rf"count: must be in 1 .. {DRAWS}, the draws of the study, got {count}"):
        dj.lane(study).draws(count)


def test_a_segment_has_a_sample(study):
    with pytest.raises(ConfigError, match="segment: must be at least 1 sample, got 0"):
        dj.lane(study, segment=0)
