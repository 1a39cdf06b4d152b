"""Disturbances that depend on the state: their bounds against motions, and proofs against flights."""

import json
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm

import dssc_jax as dj
from dssc_jax.core.signals import Measurement
from dssc_jax.models.disturbances.partition import PARTITION
from dssc_jax.proofs.coverage import problem_of
from dssc_jax.proofs.prove import check_certificate, prove
from dssc_jax.proofs.search.fixed_point import motion_between_samples
from dssc_jax.proofs.verifier.state_dependence import disturbance_by_state, motion_bounds
from dssc_jax.proofs.verifier.verdict import ball_precision, verify_certificate
from tests.proofs.cases import LOOP, SINE

GAINS = {"k_d1": 0.1, "k_d2": 0.1, "k_d3": 0.2, "k_d4": 0.2, "k_d5": 0.1, "alpha_d2": 0.05, "alpha_d3": 0.1}
OF_STATE = {"kind": "partition", "value": 0.02, "period": 6.0, **GAINS}
STUDY = LOOP.override({"disturbance": OF_STATE, "loop.sample_time": 0.004})


@pytest.mark.parametrize("moves", [False, True])
def test_value_and_slope_stay_within_their_bounds(moves):
    """The model's own disturbance along random motions whose e, e' and e'' are at most 0.3, 0.5 and 2."""
    study = STUDY.override({"reference": SINE} if moves else {})
    problem, rng = problem_of(study), np.random.default_rng(3)
    params = study.template.disturbance[0]
    v, a, _ = problem.reference
    sizes = np.array([0.3 + problem.reference_size, 0.5 + v, 2.0 + a])
    with jax.enable_x64(True):

        def value(e, y_m, rates, t):  # s = e' + l_0 e
            y, y_dot = e + y_m, rates[0] + rates[1]
            return PARTITION.value(params, (), Measurement(y, y_dot), rates[0] + problem.l0 * e, t)

        def along(e, rates, bends, y_m, t):
            tangents = rates[0], rates[1], bends, 1.0
            return jax.jvp(value, (e, y_m, rates, t), tangents)

        e, e_dot, bend = (size * jnp.asarray(rng.choice([-1.0, 1.0], 20_000)) for size in (0.3, 0.5, 2.0))
        y_m, y_m_dot, y_m_ddot = (
            size * jnp.asarray(rng.choice([-1.0, 1.0], 20_000)) for size in (problem.reference_size, v, a)
        )
        rates, bends = jnp.stack([e_dot, y_m_dot], axis=1), jnp.stack([bend, y_m_ddot], axis=1)
        values, slopes = jax.vmap(along)(e, rates, bends, y_m, jnp.asarray(rng.uniform(0.0, 6.0, 20_000)))
    k = np.array(problem.by_state)
    s, s_dot = 0.5 + problem.l0 * 0.3, 2.0 + problem.l0 * 0.5
    growth = k[0] * sizes[0] + k[1] * sizes[1] + k[2]
    level = problem.level + k[3] * sizes[0] + growth * s
    slope = problem.slope + k[4] * sizes[0] + k[3] * sizes[1] + (k[0] * sizes[1] + k[1] * sizes[2]) * s + growth * s_dot
    assert 0.8 < np.abs(values).max() / level <= 1.0
    assert 0.7 < np.abs(slopes).max() / slope <= 1.0


def test_motion_within_a_sample_stays_within_its_bounds():
    """Of verifier and search, against exact solutions from random states with a held command and a steep d."""
    problem = replace(problem_of(STUDY), level=0.3, slope=0.8)
    content, rng, t = problem.to_dict(), np.random.default_rng(4), problem.sample_time
    sizes = np.array([0.7, 0.2, 0.4, 0.1, 0.05, 0.3, 0.4])[: 1 + 6]  # command, e, e', zeta, v, s
    with ball_precision():
        bounds = [float(bound) for bound in motion_bounds(content, problem.box, list(map(arb, sizes)))]
        level, slope = map(float, disturbance_by_state(content, problem.box, list(map(arb, sizes))))
    searched = motion_between_samples(problem, problem.box, sizes)
    assert np.all(np.array(searched) <= 1.001 * np.array(bounds))
    assert np.all(np.array(searched) > 0.9 * np.array(bounds))
    assert level > 0.0
    assert slope > 0.0
    k_p, a_p, rate = problem.k_p[0], problem.a_p[0], 1.0 / problem.mu[0]
    f = np.zeros((6, 6))  # e, e', x_1, x_2 of 1/(mu s + 1)^2 in the verifier's companion form; U; d_r(t) - d_r(t_k)
    f[0, 1], f[1, 1], f[1, 2], f[1, 5] = 1.0, -a_p, 1.0, k_p
    f[2, 3], f[3, 2], f[3, 3], f[3, 4] = rate, -rate, -2.0 * rate, rate
    largest = np.zeros(3)
    for _ in range(2000):
        state = np.array([*(sizes[1:5] * rng.choice([-1.0, 1.0], 4)), k_p * sizes[0] * rng.choice([-1.0, 1.0]), 0.0])
        sign, extended = rng.choice([-1.0, 1.0]), np.zeros((7, 7))
        extended[:6, :6], extended[5, 6] = f, sign * problem.slope
        z = expm(extended * t * rng.random()) @ [*state, 1.0]
        largest = np.maximum(largest, np.abs([z[0], z[1], (extended @ z)[1]]))
    assert np.all(largest <= bounds)
    assert np.all(largest > 0.8 * np.array(bounds))


@pytest.mark.parametrize("changes", [{}, {"reference": SINE, "plant.initial": [0.1, 0.2]}], ids=["still", "moving"])
def test_flights_stay_within_what_is_proved(changes):
    study = STUDY.override(changes)
    outcome = prove(study, boxes=1)
    assert outcome.complete, outcome.failures
    assert "depends on the state with k_d1 = 0.1" in outcome.statement()
    verdict = check_certificate(json.loads(json.dumps(outcome.certificate())))
    assert verdict.proved, verdict.reason
    waves = study.override({"draws": 64, "disturbance.period": {"uniform": [1.0, 6.0]}, "loop.duration": 40.0})
    flown = dj.run(waves.override({"metrics": {"after": 0.0, "names": ["error_max", "outside_sliding"]}})).dataset
    settled = dj.run(waves.override({"metrics": {"after": 30.0, "names": ["error_max"]}})).dataset
    print(
        f"\nproved {outcome.largest_error:.4g}, {outcome.error:.3g} m; flown {float(settled['error_max'].max()):.3g} m"
    )
    assert float(flown["error_max"].max()) <= outcome.largest_error
    assert np.all(flown["outside_sliding"].values == 0.0)
    assert 0.05 * outcome.error < float(settled["error_max"].max()) <= outcome.error


def test_stages_that_allow_more_than_they_assume_are_rejected():
    content = json.loads(json.dumps(prove(STUDY, boxes=1).certificate()))
    for number in range(len(content["proofs"][0]["stages"])):
        for name in ("level", "slope"):
            wrong = json.loads(json.dumps(content))
            wrong["proofs"][0]["stages"][number][name] *= 0.5
            assert verify_certificate(wrong).reason.startswith("P8")


def test_a_disturbance_that_the_loop_cannot_reject_is_not_proved():
    """k_d4 y with k_p k_d4 far above the stiffness that the gains allow."""
    outcome = prove(STUDY.override({"disturbance.k_d4": 40.0}), boxes=1)
    assert not outcome.complete
    assert outcome.failures[0].reason in ("gain", "sliding")
